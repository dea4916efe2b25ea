# SPDX-License-Identifier: MIT
"""`3dvc stats`: what it reports, and what it writes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from helpers.commands import run
from helpers.streams import FRAMES, FakeStream, roaming_stream
from threedvc.formats.sources import open_sequence


class TestStats:
    def test_table(self, fake_decoder: list[FakeStream], stream: Path, recording: Path) -> None:
        result = run("stats", stream, "--reference", recording)
        assert result.exit_code == 0, result.stderr
        lines = result.stdout.splitlines()
        values = dict(line.split(maxsplit=1) for line in lines if line)
        assert values["stream"] == "gradient, 4 frames, 0.20 s"
        assert values["size"].startswith(f"{stream.stat().st_size:,} bytes, ")
        assert any(line.split()[:2] == ["POSE", "2"] for line in lines)
        assert any(line.split()[:2] == ["1", "125"] and line.endswith("10 mm") for line in lines)
        assert values["poses"] == "1 known, 2 tracked, 1 lost"
        assert (values["psnr_rgb"], values["depth_rmse_mm"]) == ("99.00 dB", "0.0 mm")
        assert max(map(len, lines)) <= 100
        assert result.stderr == ""

    def test_json_is_all_of_standard_output(self, stream: Path) -> None:
        values = json.loads(run("stats", stream, "--json").stdout)
        assert (values["frames"], values["complete"]) == (FRAMES, True)
        assert "quality" not in values

    def test_standard_input(self, stream: Path) -> None:
        from_file = run("stats", stream, "--json").stdout
        assert run("stats", "-", "--json", input=stream.read_bytes()).stdout == from_file

    def test_cut_stream_is_marked(self, cut_stream: Path) -> None:
        result = run("stats", cut_stream)
        assert result.exit_code == 0
        assert result.stdout.splitlines()[0].endswith("TRUNCATED: the stream ends before its END packet")

    def test_per_frame(self, fake_decoder: list[FakeStream], stream: Path, recording: Path, tmp_path: Path) -> None:
        table = tmp_path / "frames.csv"
        assert run("stats", stream, "--reference", recording, "--per-frame", table).exit_code == 0
        rows = list(csv.DictReader(table.read_text().splitlines()))
        assert [row["frame"] for row in rows] == ["0", "1", "2", "3"]
        assert [row["status"] for row in rows] == ["known", "tracked", "tracked", "lost"]
        assert sum(int(row["bytes"]) for row in rows) == stream.stat().st_size
        assert [float(row["psnr_rgb"]) for row in rows] == [99.0] * 4
        assert {row["timestamp_ns"] for row in rows} == {"0", "50000000", "100000000", "150000000"}
        assert [row["camera_x_m"] for row in rows] == ["0.0"] * 4

    def test_trajectory_is_input_again(self, stream: Path, recording: Path, tmp_path: Path) -> None:
        poses = tmp_path / "poses.txt"
        assert run("stats", stream, "--trajectory", poses).exit_code == 0
        assert poses.read_text().splitlines()[1] == f"0 {' '.join(['0.000000000000'] * 6)} 1.000000000000"
        poses.replace(recording / "poses.txt")
        frames = list(open_sequence(recording))
        assert [np.array_equal(frame.T_world_camera, np.eye(4)) for frame in frames] == [True] * FRAMES

    def test_lives_of_objects(self, tmp_path: Path) -> None:
        path = tmp_path / "a.3dvc"
        path.write_bytes(roaming_stream([5, 0, 0.1, 5, 0, 5]))
        table = tmp_path / "frames.csv"
        rows = [" ".join(line.split()) for line in run("stats", path, "--per-frame", table).stdout.splitlines()]
        assert "0 background 6 - - 0-5" in rows
        assert "1 3 5.000 m 0 deg 1-2, 4" in rows
        assert "number of objects 1, at most 1 at once, the background apart" in rows
        assert {"births frame 1: object 1", "deaths frame 4: object 1", "path the camera is at rest"} <= set(rows)
        counts = [row["visible_objects"] for row in csv.DictReader(table.read_text().splitlines())]
        assert counts == ["0", "1", "1", "0", "1", "0"]

    def test_frames_of_note_and_objects_of_the_reference(
        self, fake_decoder: list[FakeStream], stream: Path, recording: Path
    ) -> None:
        lines = run("stats", stream, "--reference", recording).stdout.splitlines()
        rows = {" ".join(line.split()) for line in lines}
        assert {"lost frames 3", "over all 4 frames with a known pose; lost in the stream: 1"} <= rows
        assert any(row.startswith("object 1 ATE 0.0 mm") for row in rows)
        # There are no masks, so no overlap is known.
        assert "1 1 0 - 0 - 0.00 0.00 0.00 0.0 0.0 0.0" in rows

    def test_long_lists_are_wrapped(self, tmp_path: Path) -> None:
        path = tmp_path / "a.3dvc"
        path.write_bytes(roaming_stream([0, 5] * 30))
        lines = run("stats", path).stdout.splitlines()
        assert max(map(len, lines)) <= 100
        assert any(line.endswith(" 58") and line.startswith(40 * " ") for line in lines)

    @pytest.mark.parametrize(("suffix", "magic"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
    def test_plot(self, stream: Path, tmp_path: Path, suffix: str, magic: bytes) -> None:
        pytest.importorskip("matplotlib")
        picture = tmp_path / f"a.{suffix}"
        result = run("stats", stream, "--plot", picture)
        assert result.exit_code == 0, result.stderr
        assert picture.read_bytes().startswith(magic)

    def test_plot_needs_the_extra(self, stream: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("threedvc.cli.plotting.find_spec", lambda name: None)
        result = run("stats", stream, "--plot", tmp_path / "a.png")
        assert result.exit_code == 1
        assert result.stderr == "Error: --plot needs Matplotlib; install it with: pip install '3dvc[plot]'\n"

    def test_plot_of_another_kind(self, stream: Path, tmp_path: Path) -> None:
        result = run("stats", stream, "--plot", tmp_path / "a.doc")
        assert result.exit_code == 2
        assert "end it in .png, .pdf, .svg" in result.stderr

    def test_unwritable_table(self, stream: Path, tmp_path: Path) -> None:
        table = tmp_path / "missing" / "frames.csv"
        result = run("stats", stream, "--per-frame", table)
        assert result.exit_code == 1
        assert result.stderr == f"Error: {table}: cannot be written (No such file or directory); choose another place\n"

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            (b"", "not a .3dvc stream: begins with nothing (empty)"),
            (b"\x89PNG\r\n\x1a\n and more", "not a .3dvc stream: begins with 89 50 4e 47 0d 0a 1a 0a"),
        ],
    )
    def test_not_a_stream(self, tmp_path: Path, content: bytes, message: str) -> None:
        path = tmp_path / "a.3dvc"
        path.write_bytes(content)
        result = run("stats", path)
        assert result.exit_code == 1
        assert result.stderr.startswith(f"Error: {path}: {message}")
        assert result.stderr.count("\n") == 1
