# SPDX-License-Identifier: MIT
"""Comparison with AV1: settings, points that are kept, what tables say. No codec is needed."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rd
import rd_points
from rd_points import COLOR, DEPTH, Point, Recording, Score, Store, config_of, ladder
from rd_report import Result, report
from sequences import RUNS
from threedvc.cli.main import main as command
from threedvc.config import Motion, SegmentationMode

MEASURES = ("psnr_y", "ssim_y", "depth_within_10mm", "depth_rmse_mm", "depth_lost")


def point(size: int, psnr: float = 0.0, within: float = 0.0, setting: str = "8 kbit/s") -> Point:
    return Point(setting=setting, size=size, quality={COLOR: psnr, DEPTH: within, **dict.fromkeys(MEASURES, 0.0)})


def result(ours: list[Point]) -> Result:
    """AV1 takes 100 bytes for 20 dB and twice as many for each 5 dB more; as many for 0.5, 0.7, 0.9."""
    return Result(
        sequence="room",
        options="--motion track",
        frames=30,
        seconds=1.0,
        ours=ours,
        color=[point(100 * 2**k, psnr=20 + 5 * k - 0.01 * k * k) for k in range(4)],
        depth=[point(100, within=0.5), point(200, within=0.7), point(400, within=0.9)],
    )


@pytest.fixture
def folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    place = tmp_path / "tiny"
    options = ["--scene", "objects", "--frames", "3", "--size", "40x30"]
    command.main(["synth", str(place), *options], standalone_mode=False)
    capsys.readouterr()
    return place


class TestSettings:
    @pytest.mark.parametrize("run", [*RUNS, *rd_points.RUNS], ids=lambda run: f"{run.sequence} {run.options}")
    def test_options_of_every_run_are_understood(self, run: rd_points.Run) -> None:
        config = config_of(run.options)
        assert config.motion == (run.options.partition("--motion ")[2] or Motion.AUTO)

    def test_options_are_taken(self) -> None:
        config = config_of("--segment depth:0.1m..1.2m --voxel-size 16mm --max-depth 4m")
        assert config.segmentation.mode is SegmentationMode.DEPTH
        assert (config.segmentation.near_m, config.segmentation.far_m) == (0.1, 1.2)
        assert (config.voxel_size_m, config.max_depth_m) == (0.016, 4.0)

    def test_named_folder_takes_its_first_run(self, tmp_path: Path) -> None:
        assert Recording.of(tmp_path / "paper_cow").run.options.startswith("--segment depth:0.1m..1.2m")
        assert Recording.of(tmp_path / "mine").run == rd_points.Run(sequence="mine", rates=rd_points.RATES)

    def test_ladder_has_the_rates(self) -> None:
        config = config_of("--max-depth 4m")
        assert [rung.bitrate_bps for rung in ladder(config, (8.78, 16))] == [8780, 16000]
        assert ladder(config, (8,))[0] == replace(config, bitrate_bps=8000)

    def test_av1_goes_from_coarse_to_fine_until_it_is_good_enough(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, folder: Path
    ) -> None:
        def measured(recording: Recording, codec: rd_points.VideoCodec) -> Point:
            return point(1, psnr=100 - codec.crf / codec.scale, setting=f"{codec.scale}/{codec.crf}")

        versions = {"libavcodec": (1,)}
        monkeypatch.setattr(
            rd_points, "library", lambda: type("PyAV", (), {"__version__": "0", "library_versions": versions})
        )
        monkeypatch.setattr(rd_points, "_av1_color", measured)
        found = rd_points.av1_points(
            Recording.of(folder), Store(tmp_path), "color", lambda each: each.quality[COLOR] > 49
        )
        assert [each.setting for each in found] == ["1/70", "1/64", "1/58", "1/50", "2/70", "4/70", "8/70"]


class TestRecording:
    def test_frames_cell_and_depth_range(self, folder: Path) -> None:
        recording = Recording.of(folder, 2)
        assert len(list(recording.colors())) == len(list(recording.depths())) == 2
        assert recording.config.voxel_size_m is None
        depth = np.stack(list(recording.depths()))
        assert recording.depth_range == (depth[depth > 0].min(), depth.max())

    def test_limit_beyond_the_end_is_the_end(self, folder: Path) -> None:
        assert len(Recording.of(folder, 99).frames) == 3


class TestScore:
    def test_pixels_are_pooled_and_lost_ones_count(self) -> None:
        score = Score(depth_scale=1000)
        picture = np.full((12, 12, 3), 100, dtype=np.uint8)
        given = np.full((12, 12), 2, dtype=np.float32)
        for error in (0.0, 0.03):
            score.add_color(picture, picture)
            seen = given + np.float32(error)
            seen[0, :6] = 0
            score.add_depth(given, seen)
        quality = score.quality()
        assert quality["psnr_rgb"] == 99
        assert quality["depth_within_1pct"] == pytest.approx(138 / 288)
        assert quality["depth_lost"] == pytest.approx(12 / 288)
        assert quality["depth_rmse_mm"] == pytest.approx(np.sqrt(0.5) * 30)

    def test_one_kind_alone(self) -> None:
        score = Score(depth_scale=1000)
        assert score.quality() == {}
        score.add_color(np.zeros((12, 12, 3), dtype=np.uint8), np.zeros((12, 12, 3), dtype=np.uint8))
        assert set(score.quality()) == {"psnr_rgb", "psnr_y", "ssim_y"}


class TestStore:
    def test_point_is_measured_once_for_each_version(self, tmp_path: Path) -> None:
        points = iter([point(1), point(2), point(3)])
        place = tmp_path / "point.json"
        store = Store(tmp_path)
        assert store.point(place, "a", lambda: next(points)) == point(1)
        assert store.point(place, "a", lambda: next(points)) == point(1)
        assert store.point(place, "b", lambda: next(points)) == point(2)
        assert Store(tmp_path, reuse=True).point(place, "c", lambda: next(points)) == point(2)

    def test_frames_and_setting_are_in_the_name(self, tmp_path: Path, folder: Path) -> None:
        place = Store(tmp_path / "store").place(Recording.of(folder, 2), "av1-color-crf30")
        assert place == tmp_path / "store" / "tiny-2" / "av1-color-crf30.json"
        assert place.parent.is_dir()


class TestResult:
    def test_bytes_at_equal_quality(self) -> None:
        ours = point(50, psnr=24.99, within=0.7)
        assert result([ours]).equal(ours, COLOR) == pytest.approx(200)
        assert result([ours]).equal(ours, DEPTH) == pytest.approx(200)
        assert result([ours]).equal(ours, COLOR, DEPTH) == pytest.approx(400)
        assert result([ours]).ratios() == pytest.approx([4, 4, 8])

    def test_quality_that_av1_does_not_reach(self) -> None:
        ours = point(50, psnr=24.99, within=0.95)
        assert result([ours]).equal(ours, COLOR, DEPTH) is None
        assert result([ours]).ratios() == [pytest.approx(4), None, None]

    def test_quality_below_all_of_av1_has_a_bound_and_does_not_count(self) -> None:
        ours = point(50, psnr=15, within=0.7)
        assert result([ours]).equal(ours, COLOR) == pytest.approx(100)
        assert result([ours]).at_most(ours, COLOR)
        assert result([ours]).ratios() == [None, pytest.approx(4), None]
        assert result([ours]).pair_difference() is None

    def test_points_that_smaller_ones_equal_are_left_out_of_means(self) -> None:
        good, beaten = point(50, psnr=24.99, within=0.7), point(500, psnr=24, within=0.7)
        better_in_depth = point(500, psnr=24, within=0.71)
        assert result([good, beaten]).worthwhile == [good]
        assert result([good, beaten]).ratios() == pytest.approx([4, 4, 8])
        assert result([good, better_in_depth]).worthwhile == [good, better_in_depth]

    def test_differences_of_rates(self) -> None:
        ours = [point(80, psnr=20, within=0.5), point(160, psnr=24.99, within=0.7), point(320, psnr=29.96, within=0.9)]
        assert result(ours).difference(COLOR) == pytest.approx(-20, abs=0.5)
        assert result(ours).difference(DEPTH) == pytest.approx(-20)
        assert result(ours).pair_difference() == pytest.approx(-60)


class TestReport:
    def test_cells(self) -> None:
        ours = [
            point(100, psnr=15, within=0.6, setting="8 kbit/s"),
            point(4000, psnr=24.99, within=0.7, setting="16 kbit/s"),
            point(8000, psnr=40, within=0.9, setting="1000 kbit/s"),
        ]
        text = report([result(ours), result(ours[1:])], "Heading.", Path("plots"), ["door: no depth"])
        lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
        cheap, middle, best = [line for line in lines if line and line[0].endswith(" kbit/s") and len(line) == 14][:3]
        assert cheap[-4] == "≤ 100"
        assert cheap[-2].startswith("≤ ")
        assert middle[-4:] == ["200", "200", "400", "0.10"]
        assert best[-4:] == ["-", "400", "-", "-"]
        mean, by_rate = [line for line in lines if line and line[0] == "geometric mean"]
        assert mean[-1] != "-"
        assert by_rate == ["geometric mean", "", "", "", "0.10"]
        header, first, second = [line for line in lines if len(line) == 5 and line[0] in ("sequence", "room")]
        assert header == ["sequence", "8 kbit/s", "16 kbit/s", "1000 kbit/s", "20 to 150 kbit/s"]
        assert first[1:] == ["≤ 2.41", "0.10", "-", "0.10"]
        assert second[1:] == ["", "0.10", "-", "0.10"]
        assert "![room](plots/room.png)" in text
        assert "30 frames with `--motion track`." in text
        assert "Failed: door: no depth." in text

    def test_plot(self, tmp_path: Path) -> None:
        pytest.importorskip("matplotlib", reason="plots need matplotlib, of the extra [bench]")
        from rd_plot import plot

        ours = [point(80, psnr=20, within=0.5), point(160, psnr=24.99, within=0.95)]
        plot(result(ours), tmp_path / "room.png")
        assert (tmp_path / "room.png").read_bytes().startswith(b"\x89PNG")


class TestCommand:
    def test_without_recordings_it_says_so_and_writes_nothing(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr(rd, "DATA", tmp_path)
        rd.main(["--out", str(tmp_path / "table.md")])
        assert "no recorded sequences in" in capsys.readouterr().err
        assert not (tmp_path / "table.md").exists()

    def test_missing_codec_is_one_line(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        monkeypatch.setitem(sys.modules, "av", None)
        with pytest.raises(SystemExit, match=r"install the extra \[bench\]"):
            rd.main([str(tmp_path), "--out", str(tmp_path / "table.md")])

    @pytest.mark.parametrize(
        "options", [["--rates", "8"], ["--rates", "0,8"], ["--rates", "8,x"], ["--frames", "0"], ["--parts", "all"]]
    )
    def test_impossible_numbers_are_refused(self, options: list[str]) -> None:
        with pytest.raises(SystemExit, match="2"):
            rd.main(options)

    def test_sequence_that_cannot_be_read_is_named_and_the_others_stand(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, folder: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        def points(recording: Recording, store: Store, kind: str, enough: object) -> Iterator[Point]:
            yield from (result([]).color if kind == "color" else result([]).depth)

        monkeypatch.setattr(rd, "av1_points", points)
        monkeypatch.setattr(rd, "library", lambda: type("PyAV", (), {"__version__": "0"}))
        monkeypatch.setattr(rd, "plot", lambda *_: None)
        table = tmp_path / "out" / "table.md"
        chosen = [
            "--parts",
            "rates",
            "--rates",
            "64,256",
            "--frames",
            "2",
            "--cache",
            str(tmp_path / "cache"),
            "--out",
            str(table),
        ]
        with pytest.raises(SystemExit, match="1 of the sequences failed"):
            rd.main([str(tmp_path / "nothing"), str(folder), *chosen])
        assert "Failed: nothing: " in table.read_text(encoding="utf-8")
        assert "## tiny" in table.read_text(encoding="utf-8")
        assert "tiny: 3dvc, " in capsys.readouterr().err
