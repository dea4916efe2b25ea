# SPDX-License-Identifier: MIT
"""The command line: what is handed to the library, what is printed where, and with which exit code."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import threedvc
from helpers.commands import FakeEncoder, run
from helpers.streams import FRAMES, FakeStream, ListSequence, packed_stream
from threedvc.cli import explore as explore_module
from threedvc.cli.encode import SENSORS
from threedvc.config import Motion, SegmentationMode, Sensor
from threedvc.errors import OutputError, SequenceError
from threedvc.formats.container.layout import SYNC
from threedvc.formats.layout_names import layout_names
from threedvc.formats.sources.registry import LAYOUTS


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
            "latency_s": None,
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
            (
                ["{recording}", "--preset", "live", "--latency", "20s"],
                "a latency of 20 s must be within 0.1..10 s; try 1s",
            ),
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
