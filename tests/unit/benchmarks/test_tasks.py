# SPDX-License-Identifier: MIT
"""Tasks on decoded frames: what is coded to which size, what is kept, what the report says. No codec is needed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import task_inputs
import tasks
from rd_points import AV1_CRF, Point, Recording, Store
from sequences import Run
from task_inputs import RAW, Version, best_pair, best_setting, check_recording, raw_bytes, versions
from tasks import FRAMES, MATCHES, MEASURES, OPEN3D, QUALITY, Outcome, Subject, Tasks, report
from threedvc.cli.main import main as command
from threedvc.errors import SequenceError

TASK_NAMES = [QUALITY, OPEN3D, tasks.OPENCV, MATCHES]


def coded(kind: str, scale: int, crf: int) -> Point:
    """Files grow by some bytes for each step of quality, for color by twice as many; small pictures lose by size."""
    size = (200 if kind == "color" else 100) * (71 - crf) // scale**2
    measure = {"color": "psnr_rgb", "depth": "depth_within_1pct"}[kind]
    return Point(setting="", size=size, quality={measure: 100 - crf - 5 * scale})


def recorded(tmp_path: Path, scene: str) -> Recording:
    place = tmp_path / scene
    command.main(["synth", str(place), "--scene", scene, "--frames", "3", "--size", "40x30"], standalone_mode=False)
    return Recording(place, Run(sequence=scene, options=tasks.OPTIONS))


@pytest.fixture
def room(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Recording:
    recording = recorded(tmp_path, "room")
    capsys.readouterr()
    return recording


class TestInputs:
    def test_raw_size_is_color_and_sixteen_bits_of_depth(self, room: Recording) -> None:
        assert raw_bytes(room.info, 3) == 3 * 40 * 30 * 5

    def test_recording_without_poses_is_refused(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        with pytest.raises(SequenceError, match="has no poses of the camera"):
            check_recording(recorded(tmp_path, "objects"))

    def test_setting_is_the_best_within_the_bytes_to_a_step(self) -> None:
        setting = best_setting(lambda scale, crf: coded("depth", scale, crf), "depth_within_1pct", 1010)
        assert setting == (2, 31)
        assert coded("depth", *setting).size <= 1010 < coded("depth", 2, 30).size

    def test_no_setting_within_the_bytes_takes_the_smallest(self) -> None:
        assert best_setting(lambda scale, crf: coded("depth", scale, crf), "depth_within_1pct", 0) == (8, AV1_CRF[0])

    def test_pair_is_within_the_bytes_and_color_takes_what_depth_leaves(self) -> None:
        color, depth = best_pair(coded, 2000)
        assert coded("depth", *depth).size <= 1000
        assert 1900 < coded("color", *color).size + coded("depth", *depth).size <= 2000

    def test_folders_of_coded_frames_are_made_once_for_each_codec(
        self, room: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        made = []

        def code() -> task_inputs.Coded:
            made.append(1)
            return 77, "setting", room.info, iter(room.frames)

        for codec in ("a", "a", "b"):
            version = task_inputs._version("3dvc 1:9", tmp_path / "made" / "coded", codec, room, code)
            assert (version.size, version.setting, len(version.frames)) == (77, "setting", 3)
        assert len(made) == 2

    def test_each_ratio_has_a_file_and_a_pair_of_its_size(
        self, room: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def version(name: str, size: int) -> Version:
            return Version(name=name, codec="", size=size, frames=room.frames)

        monkeypatch.setattr(task_inputs, "_threedvc", lambda _, ratio, budget, __: version("3dvc", int(budget) - 1))
        monkeypatch.setattr(task_inputs, "_av1", lambda _, ratio, budget, __: version("AV1", budget))
        found = list(versions(room, (1000, 100), Store(tmp_path)))
        assert [(each.name, each.size) for each in found] == [
            (RAW, 18000), ("3dvc", 17), ("AV1", 17), ("3dvc", 179), ("AV1", 179),
        ]  # fmt: skip


class TestTasks:
    def test_scores_are_measured_once_for_each_version(
        self, room: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        done = []
        monkeypatch.setattr(tasks, "tools", lambda: "tools")
        for name in ("quality", "open3d_odometry", "opencv_odometry", "matches"):
            monkeypatch.setattr(Tasks, name, lambda *_, name=name: done.append(name) or {"score": 1.0})
        version = Version(name=RAW, codec=RAW, size=7, frames=room.frames)
        for codec in (RAW, RAW, "other"):
            scores = Tasks(Subject(recording=room), Store(tmp_path)).scores(replace(version, codec=codec))
            assert list(scores) == TASK_NAMES
        assert len(done) == 2 * len(TASK_NAMES)
        assert "room, raw, ORB matches: score 1" in capsys.readouterr().err

    def test_surfaces_are_for_scenes_whose_depth_is_known(self, room: Recording, tmp_path: Path) -> None:
        exact = Subject(recording=room, exact=lambda number: room.frames[number].depth)
        assert Tasks(exact, Store(tmp_path)).names() == [*TASK_NAMES, tasks.SURFACE]
        assert len(exact.depths) == 3

    def test_frames_as_recorded_are_equal_to_themselves(self, room: Recording, tmp_path: Path) -> None:
        quality = Tasks(Subject(recording=room), Store(tmp_path)).quality(list(room.frames))
        assert quality["psnr_rgb"] == 99
        assert quality["depth_within_1pct"] == 1


class TestReport:
    @staticmethod
    def scores(ate: float, matches: float, size: int) -> dict[str, Point]:
        odometry = {"ate_mm": ate, "rpe_mm": 1.0, "rpe_deg": 0.1}
        quality = {"psnr_rgb": 30.0, "depth_within_1pct": 0.9, "depth_lost": 0.0}
        found = {OPEN3D: odometry, MATCHES: {"matches": matches}, QUALITY: quality}
        return {task: Point(setting="24 kbit/s", size=size, quality=each) for task, each in found.items()}

    def test_rows_verdict_and_sizes(self) -> None:
        outcome = Outcome(
            sequence="room",
            frames=60,
            seconds=2.0,
            scores={
                RAW: self.scores(10.0, 50.2, 6_000_000),
                "3dvc 1:1000": self.scores(12.0, 50.4, 6000),
                "AV1 1:1000": self.scores(9.0, 40.0, 5900),
            },
        )
        text = report([outcome], "Heading.", ["desk: has no poses"])
        lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
        assert ["room", OPEN3D, "ATE mm", "10.0", "12.0 ✗", "9.0"] in lines
        assert ["room", MATCHES, "a pair", "50", "50", "40 ✗"] in lines
        assert "Scores that are, with a ✗: 3dvc 1:1000: 1 of 4; AV1 1:1000: 1 of 4." in text
        assert ["room", "3dvc 1:1000", "24 kbit/s", "6,000", "24.0", "1000", "30.00", "0.9000", "0.0000"] in lines
        assert "Failed: desk: has no poses." in text

    def test_what_the_table_does_not_show_is_not_worse(self) -> None:
        ate = next(measure for measure in MEASURES if measure.name == "ate_mm")
        f_score = next(measure for measure in MEASURES if measure.name == "f_score")
        assert not ate.worse(10.04, 10.0)
        assert ate.worse(10.1, 10.0)
        assert f_score.worse(0.9, 0.91)
        assert not f_score.worse(0.92, 0.91)


class TestCommand:
    def test_missing_program_is_one_line(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        def missing() -> None:
            raise tasks.MissingTool("tasks need Open3D; install the extra [bench]")

        monkeypatch.setattr(tasks, "library", lambda: None)
        monkeypatch.setattr(tasks, "open3d", missing)
        with pytest.raises(SystemExit, match=r"install the extra \[bench\]"):
            tasks.main([str(tmp_path), "--out", str(tmp_path / "table.md")])

    def test_ratios_go_from_coarse_to_fine(self) -> None:
        options = tasks.parsed(["--ratios", "100,1000"])
        assert (options.ratios, options.frames) == ((1000, 100), FRAMES)

    @pytest.mark.parametrize("options", [["--ratios", "0"], ["--ratios", "x"], ["--frames", "0"]])
    def test_impossible_numbers_are_refused(self, options: list[str]) -> None:
        with pytest.raises(SystemExit, match="2"):
            tasks.main(options)
