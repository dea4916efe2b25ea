# SPDX-License-Identifier: MIT
"""The command line: what is handed to the library, what is printed where, and with which exit code."""

from __future__ import annotations

import csv
import errno
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

import threedvc
from helpers.streams import FRAMES, FakeStream, ListSequence, packed_stream, roaming_stream
from threedvc.cli import explore as explore_module
from threedvc.cli.encode import SENSORS
from threedvc.cli.main import main
from threedvc.config import Motion, SegmentationMode, Sensor
from threedvc.errors import OutputError, SequenceError
from threedvc.formats import decoding, encoding
from threedvc.formats.container.layout import SYNC
from threedvc.formats.evaluation import statistics as statistics_module
from threedvc.formats.layout_names import layout_names
from threedvc.formats.sinks import PlainSink
from threedvc.formats.sources import open_sequence
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.registry import LAYOUTS


def run(*arguments: object, **options: Any) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], **options)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Write a recording of four small frames."""
    folder = tmp_path / "recording"
    sequence = ListSequence()
    with PlainSink(folder, sequence.info, threads=1) as sink:
        for frame in sequence:
            sink.write_frame(frame)
    return folder


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    """Write a complete stream."""
    path = tmp_path / "a.3dvc"
    path.write_bytes(packed_stream())
    return path


@pytest.fixture
def cut_stream(tmp_path: Path) -> Path:
    """Write a stream of two whole frames and some more bytes."""
    path = tmp_path / "cut.3dvc"
    path.write_bytes(packed_stream(ended=False)[:-5])
    return path


@pytest.fixture
def fake_decoder(monkeypatch: pytest.MonkeyPatch) -> list[FakeStream]:
    """Replace the decoder; return the streams that get opened."""
    opened: list[FakeStream] = []

    def open_stream(source: Any, **choices: Any) -> FakeStream:
        opened.append(FakeStream(source, **choices))
        return opened[-1]

    monkeypatch.setattr(decoding, "open_stream", open_stream)
    monkeypatch.setattr(statistics_module, "open_stream", open_stream)
    return opened


class FakeEncoder:
    """Remembers what it was asked for, calls back for two frames, and returns a report or raises."""

    def __init__(self, error: BaseException | None = None) -> None:
        self.error = error
        self.calls: list[SimpleNamespace] = []

    def __call__(
        self,
        source: Any,
        output: Any,
        config: Any,
        *,
        verify: bool,
        on_frame: Callable[[Any], None],
        on_notice: Callable[[Notice], None],
        force: bool,
        stop: Callable[[], bool] | None,
    ) -> Any:
        self.calls.append(SimpleNamespace(source=source, output=output, config=config, verify=verify))
        for index in range(2):
            on_frame(SimpleNamespace(index=index, bytes_so_far=1000 * index))
        if self.error is not None:
            raise self.error
        return SimpleNamespace(
            file_bytes=5000,
            frames=FRAMES,
            duration_s=0.2,
            seconds=2.0,
            voxel_size_m=0.016,
            lost_frames=[3],
            digest=bytes.fromhex("00ff"),
            notices=(Notice("odd", warning=True),),
        )


@pytest.fixture
def fake_encoder(monkeypatch: pytest.MonkeyPatch) -> FakeEncoder:
    encoder = FakeEncoder()
    monkeypatch.setattr(encoding, "encode", encoder)
    return encoder


class TestMain:
    def test_help_names_every_command(self) -> None:
        result = run("--help")
        assert result.exit_code == 0
        assert all(f"\n  {name} " in result.stdout for name in ("decode", "encode", "explore", "stats", "synth"))

    @pytest.mark.parametrize("name", ["decode", "encode", "explore", "stats", "synth"])
    def test_help_of_every_command(self, name: str) -> None:
        result = run(name, "--help")
        assert result.exit_code == 0
        assert result.stdout.startswith(f"Usage: main {name} [OPTIONS] ")

    def test_version(self) -> None:
        assert run("--version").stdout == f"3dvc, version {threedvc.__version__}\n"

    def test_help_loads_no_heavy_library(self) -> None:
        code = "import sys, threedvc.cli.main; print(*sys.modules)"
        loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
        assert {"numpy", "numba", "cv2", "msgpack", "zstandard", "matplotlib"} & set(loaded.stdout.split()) == set()

    @pytest.mark.parametrize("arguments", [["frobnicate"], ["encode"], ["encode", "a", "b", "--frames", "x"]])
    def test_wrong_usage_is_exit_code_2(self, arguments: list[str]) -> None:
        assert run(*arguments).exit_code == 2

    @pytest.mark.parametrize(
        ("error", "message"),
        [
            (SequenceError("frame 3 does not fit"), "Error: frame 3 does not fit\n"),
            (OSError(errno.ENOSPC, "No space left on device", "k.3dvc"), "Error: k.3dvc: No space left on device\n"),
            (OSError(errno.EIO, "Input/output error"), "Error: Input/output error\n"),
            (
                MemoryError(),
                "Error: out of memory; try larger cells (--voxel-size) or a smaller picture (--size)\n",
            ),
            (
                ZeroDivisionError("division\nby zero"),
                "Error: internal error, please report it (ZeroDivisionError: division by zero);"
                " THREEDVC_TRACEBACK=1 shows where\n",
            ),
        ],
    )
    def test_errors_are_one_line(
        self, fake_encoder: FakeEncoder, recording: Path, error: BaseException, message: str
    ) -> None:
        fake_encoder.error = error
        result = run("encode", recording, "k.3dvc")
        assert (result.exit_code, result.stdout, result.stderr) == (1, "", message)

    def test_note_on_what_was_kept(self, fake_encoder: FakeEncoder, recording: Path) -> None:
        fake_encoder.error = OutputError("k.3dvc: cannot be written")
        fake_encoder.error.add_note("kept k.3dvc.part: 2 frames can be decoded")
        result = run("encode", recording, "k.3dvc")
        assert result.stderr == "Error: k.3dvc: cannot be written; kept k.3dvc.part: 2 frames can be decoded\n"

    def test_interrupt(self, fake_encoder: FakeEncoder, recording: Path) -> None:
        fake_encoder.error = KeyboardInterrupt()
        result = run("encode", recording, "k.3dvc")
        assert (result.exit_code, result.stdout, result.stderr) == (130, "", "Interrupted\n")

    def test_traceback_on_demand(
        self, fake_encoder: FakeEncoder, recording: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("THREEDVC_TRACEBACK", "1")
        fake_encoder.error = ZeroDivisionError()
        assert isinstance(run("encode", recording, "k.3dvc").exception, ZeroDivisionError)

    def test_reader_of_standard_output_has_gone(self, fake_encoder: FakeEncoder, recording: Path) -> None:
        fake_encoder.error = BrokenPipeError(errno.EPIPE, "Broken pipe")
        result = run("encode", recording, "-")
        assert (result.exit_code, result.stderr) == (1, "")


class TestEncode:
    def test_every_choice_arrives(self, fake_encoder: FakeEncoder, recording: Path) -> None:
        options = (
            "--layout plain --color color --depth depth --intrinsics 20,20,7.5,5.5 --depth-scale 500 --fps 10"
            " --max-depth 3m --frames 1:4:2 --voxel-size 8mm --motion known --segment depth:10cm..1.2m"
            " --sensor kinect1 --causal --verify --threads 3"
        )
        result = run("encode", recording, "k.3dvc", *options.split())
        assert result.exit_code == 0, result.stderr
        (call,) = fake_encoder.calls
        assert (str(call.output), call.verify) == ("k.3dvc", True)
        assert (call.config.voxel_size_m, call.config.max_depth_m, call.config.threads) == (0.008, 3, 3)
        assert (call.config.motion, call.config.sensor, call.config.causal) == (Motion.KNOWN, Sensor.KINECT1, True)
        assert call.config.segmentation.mode is SegmentationMode.DEPTH
        assert (call.config.segmentation.near_m, call.config.segmentation.far_m) == (0.1, 1.2)
        assert len(call.source) == 2
        assert (call.source.info.rig.depth.fx, call.source.info.depth_scale) == (20, 500)

    def test_defaults(self, fake_encoder: FakeEncoder, recording: Path) -> None:
        assert run("encode", recording, "k.3dvc").exit_code == 0
        config = fake_encoder.calls[0].config
        assert (config.voxel_size_m, config.motion, config.sensor) == (None, Motion.AUTO, Sensor.AUTO)
        assert (config.causal, config.segmentation.mode) == (False, SegmentationMode.AUTO)
        assert not fake_encoder.calls[0].verify

    def test_summary_goes_to_standard_error(self, fake_encoder: FakeEncoder, recording: Path) -> None:
        result = run("encode", recording, "k.3dvc")
        assert result.stdout == ""
        assert result.stderr == ("k.3dvc: 4 frames, 5,000 bytes, 200.0 kbit/s, cells of 16 mm, 2.0 frames/s, lost: 1\n")

    def test_json(self, fake_encoder: FakeEncoder, recording: Path) -> None:
        assert json.loads(run("encode", recording, "k.3dvc", "--json").stdout) == {
            "file_bytes": 5000,
            "frames": 4,
            "duration_s": 0.2,
            "kbit_s": 200.0,
            "seconds": 2.0,
            "voxel_size_m": 0.016,
            "lost_frames": [3],
            "digest": "00ff",
            "notices": [{"text": "odd", "warning": True}],
        }

    def test_json_and_stream_do_not_mix(self, fake_encoder: FakeEncoder, recording: Path) -> None:
        result = run("encode", recording, "-", "--json")
        assert result.exit_code == 2
        assert "--json and the output - both write to standard output" in result.stderr
        assert fake_encoder.calls == []

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["missing"], "missing: no such folder; give the folder of an RGB-D recording"),
            (["{recording}", "--voxel-size", "5m"], "voxel size 5.0 m is not within 0.0005..1.0 m; try 16mm"),
            (
                ["{recording}", "--frames", "3:3:1"],
                "{recording}: --frames 3:3:1 selects none of its 4 frames; widen it",
            ),
            (
                ["{recording}", "--segment", "depth:2m..1m"],
                "depth range 2.0 m .. 1.0 m is empty; give it as depth:NEAR..FAR with NEAR < FAR",
            ),
        ],
    )
    def test_bad_values(self, recording: Path, arguments: list[str], message: str) -> None:
        result = run("encode", *(part.format(recording=recording) for part in arguments), "k.3dvc")
        assert result.exit_code == 1
        assert result.stderr == f"Error: {message.format(recording=recording)}\n"

    def test_choices_are_those_of_the_library(self) -> None:
        assert {layout.name for layout in LAYOUTS} == set(layout_names()) - {"auto"}
        assert set(SENSORS) == {member.value for member in Sensor}


class TestDecode:
    def test_writes_a_recording(self, fake_decoder: list[FakeStream], stream: Path, tmp_path: Path) -> None:
        out = tmp_path / "out"
        result = run("decode", stream, out)
        assert result.exit_code == 0, result.stderr
        assert result.stdout == ""
        assert result.stderr.startswith(f"{out}: 4 frames, ")
        assert sorted(path.name for path in (out / "color").iterdir()) == [f"{index:06d}.png" for index in range(4)]
        assert json.loads((out / "intrinsics.json").read_text())["complete"] is True
        depth = cv2.imread(str(out / "depth" / "000002.png"), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(depth, np.rint(ListSequence()[2].depth * 1000))

    def test_every_choice_arrives(self, fake_decoder: list[FakeStream], stream: Path, tmp_path: Path) -> None:
        path = tmp_path / "path.txt"
        path.write_text("# frame tx ty tz qx qy qz qw\n0 1 2 3 0 0 0 1\n1 1 2 4 0 0 0 1\n")
        options = f"--frames 1:3 --what depth --size 32x24 --objects 1,0 --camera-path {path} --threads 2"
        result = run("decode", stream, tmp_path / "out", *options.split())
        assert result.exit_code == 0, result.stderr
        choices = fake_decoder[0].choices
        assert (choices["frames"], choices["what"], choices["size"]) == ((1, 3), {"depth"}, (32, 24))
        assert (choices["objects"], choices["render"].threads) == ((0, 1), 2)
        assert [pose[2, 3] for pose in choices["camera_path"]] == [3, 4]
        assert not (tmp_path / "out" / "color").exists()

    def test_cut_stream_is_decoded_as_far_as_it_goes(
        self, fake_decoder: list[FakeStream], cut_stream: Path, tmp_path: Path
    ) -> None:
        out = tmp_path / "out"
        result = run("decode", cut_stream, out)
        assert (result.exit_code, result.stdout) == (1, "")
        assert result.stderr.startswith(f"Error: {cut_stream}: ends at byte ")
        assert result.stderr.endswith(f"; 2 frames were decoded into {out}\n")
        assert len(list((out / "depth").iterdir())) == 2
        assert json.loads((out / "intrinsics.json").read_text())["complete"] is False

    def test_bad_camera_path(self, fake_decoder: list[FakeStream], stream: Path, tmp_path: Path) -> None:
        path = tmp_path / "path.txt"
        path.write_text("0 1 2 3\n")
        result = run("decode", stream, tmp_path / "out", "--camera-path", path)
        assert result.exit_code == 1
        assert result.stderr == (
            f"Error: {path}:1: 4 fields, expected 8 (key tx ty tz qx qy qz qw); correct the line\n"
        )


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


class TestExplore:
    def test_table(self, stream: Path) -> None:
        result = run("explore", stream, "--candidates", "30", "--best", "3")
        assert result.exit_code == 0, result.stderr
        lines = result.stdout.splitlines()
        assert lines[0] == "gradient, 4 frames, 30 candidates"
        assert lines[3].split()[0] == "1"
        assert [line.split()[:2] for line in lines[6:]] == [["1", "1"], ["2", "1"], ["3", "1"]]
        assert max(map(len, lines)) <= 100
        assert result.stderr == ""

    def test_json_is_all_of_standard_output(self, stream: Path) -> None:
        values = json.loads(run("explore", stream, "--candidates", "30", "--best", "2", "--json").stdout)
        assert (values["frames"], values["complete"], values["candidates"]) == (FRAMES, True, 30)
        assert [item["rank"] for item in values["proposals"]] == [1, 2]
        first = values["proposals"][0]
        assert set(first) == {
            "rank", "object", "gain_bits", "share", "move_m", "turn_deg", "T_world_camera", "T_camera_object"
        }  # fmt: skip
        assert np.shape(first["T_world_camera"]) == (4, 4)
        assert 0 < first["gain_bits"] < values["objects"][0]["in_sight_bits"] < values["objects"][0]["entropy_bits"]

    def test_standard_input(self, stream: Path) -> None:
        from_file = run("explore", stream, "--candidates", "9", "--json").stdout
        assert run("explore", "-", "--candidates", "9", "--json", input=stream.read_bytes()).stdout == from_file

    def test_cut_stream_is_explored_as_far_as_it_goes(self, cut_stream: Path) -> None:
        result = run("explore", cut_stream, "--candidates", "9")
        assert result.exit_code == 0, result.stderr
        assert result.stdout.startswith("gradient, 2 frames, 9 candidates  TRUNCATED: the stream ends before its END")

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["--candidates", "0"], "number of candidates 0 must be within 1..100000"),
            (["--best", "0"], "number of proposals 0 must be at least 1"),
            (["--objects", "5"], "object 5 is not there to be explored, or rests as part of 0; choose of 0, 1"),
        ],
    )
    def test_bad_values(self, stream: Path, arguments: list[str], message: str) -> None:
        result = run("explore", stream, *arguments)
        assert (result.exit_code, result.stdout, result.stderr) == (1, "", f"Error: {message}\n")

    def test_stream_without_surfaces(self, tmp_path: Path) -> None:
        path = tmp_path / "bare.3dvc"
        data = packed_stream()
        path.write_bytes(data[: data.index(SYNC, data.index(SYNC) + 1)])
        result = run("explore", path)
        assert result.exit_code == 1
        assert result.stderr == (
            f"Error: {path}: no frame shows a surface, so there is nothing to explore; record something first\n"
        )

    def test_missing_file(self, tmp_path: Path) -> None:
        result = run("explore", tmp_path / "no.3dvc")
        assert result.exit_code == 1
        assert result.stderr.startswith(f"Error: {tmp_path / 'no.3dvc'}: ")
        assert result.stderr.count("\n") == 1

    def test_choices_are_those_of_the_library(self) -> None:
        assert set(explore_module.SENSORS) == {member.value for member in Sensor} - {"auto"}
