# SPDX-License-Identifier: MIT
"""Outputs of commands: nothing of others is replaced, two runs do not mix, and signals leave what can be used."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from threedvc.cli.main import main
from threedvc.formats.decoding import decode

PROGRAM = [sys.executable, "-c", "from threedvc.cli.main import main; main()"]
PATIENCE_S = 120
FIRST_BATCH_BYTES = 400
"""More than the head of a stream."""


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a small recording that synth made."""
    folder = tmp_path_factory.mktemp("outputs") / "room"
    assert run("synth", folder, "--scene", "room", "--frames", 150, "--size", "48x36").exit_code == 0
    return folder


@pytest.fixture(scope="module")
def stream(room: Path) -> Path:
    path = room.parent / "room.3dvc"
    assert run("encode", room, path, "--preset", "live", "--frames", "0:6").exit_code == 0
    return path


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_an_input_is_not_written_over(room: Path) -> None:
    before = contents(room)
    result = run("encode", room, room / "poses.txt")
    assert result.exit_code == 1
    assert result.stderr == (
        f"Error: {room / 'poses.txt'}: is a file, but no stream that 3dvc wrote; choose another name, or give --force\n"
    )
    assert contents(room) == before


@pytest.mark.parametrize("option", ["--trajectory", "--per-frame", "--plot"])
def test_reports_keep_other_files(room: Path, stream: Path, tmp_path: Path, option: str) -> None:
    if option == "--plot":
        pytest.importorskip("matplotlib")
    target = tmp_path / "a.png"
    target.write_text("mine")
    result = run("stats", stream, option, target)
    assert result.exit_code == 1
    assert " that 3dvc wrote; choose another name, or give --force\n" in result.stderr
    assert target.read_text() == "mine"
    assert run("stats", stream, option, target, "--force").exit_code == 0
    assert run("stats", stream, option, target).exit_code == 0, "its own earlier output is replaced"
    result = run("stats", stream, option, "-")
    assert result.exit_code == 2
    assert option == "--plot" or "both write to standard output; name a file" in result.stderr


def test_reports_go_into_different_files(stream: Path, tmp_path: Path) -> None:
    target = tmp_path / "a.csv"
    result = run("stats", stream, "--per-frame", target, "--trajectory", target)
    assert result.exit_code == 2
    assert "is named twice; give every file a name of its own" in result.stderr
    assert not target.exists()


def test_reports_go_into_pipes(stream: Path) -> None:
    command = [*PROGRAM, "stats", str(stream), "--trajectory", "/dev/stderr"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    assert result.stderr.startswith("# trajectory by 3dvc stats: frame ")
    assert Path("/dev/stderr").exists()


def test_decode_keeps_what_synth_made(room: Path, stream: Path) -> None:
    before = contents(room)
    result = run("decode", stream, room)
    assert result.exit_code == 1
    assert result.stderr == (
        f"Error: {room}: holds a recording that 3dvc synth wrote; choose another folder, or give --force\n"
    )
    assert contents(room) == before


def test_decode_keeps_an_earlier_output_until_a_frame_comes(stream: Path, tmp_path: Path) -> None:
    folder, cut = tmp_path / "out", tmp_path / "cut.3dvc"
    assert run("decode", stream, folder, "--frames", "0:2").exit_code == 0
    before = contents(folder)
    cut.write_bytes(stream.read_bytes()[:150])
    assert run("decode", cut, folder).exit_code == 1
    assert contents(folder) == before
    assert run("decode", cut, tmp_path / "none").exit_code == 1
    assert not (tmp_path / "none").exists()
    assert run("decode", stream, folder, "--frames", "0:1").exit_code == 0
    assert sorted(path.name for path in (folder / "color").iterdir()) == ["000000.png"]


def started(room: Path, target: Path, *options: str) -> subprocess.Popen[str]:
    """Return an encode that has begun to write."""
    command = [*PROGRAM, "encode", str(room), str(target), *options]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    begun = time.monotonic()
    while not list(target.parent.glob(f"{target.name}*part")):
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() - begun < PATIENCE_S
        time.sleep(0.01)
    return process


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_signals_leave_nothing_of_a_file_that_has_no_frames_yet(room: Path, tmp_path: Path, number: int) -> None:
    process = started(room, tmp_path / "k.3dvc")
    process.send_signal(number)
    _, told = process.communicate(timeout=PATIENCE_S)
    words = {signal.SIGTERM: "Terminated", signal.SIGHUP: "Hung up", signal.SIGINT: "Interrupted"}
    assert told.splitlines()[-1] == words[signal.Signals(number)]
    assert process.returncode == 128 + number
    assert list(tmp_path.iterdir()) == []


def test_a_live_encode_that_is_terminated_is_complete(room: Path, tmp_path: Path) -> None:
    target = tmp_path / "k.3dvc"
    process = started(room, target, "--preset", "live")
    while next(tmp_path.iterdir()).stat().st_size < FIRST_BATCH_BYTES:
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    _, told = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 128 + signal.SIGTERM
    last = told.splitlines()[-1]
    assert last.startswith(f"Terminated; {target} holds the ")
    assert [path.name for path in tmp_path.iterdir()] == ["k.3dvc"]
    frames = sum(1 for _ in decode(target, what=frozenset({"depth"})))
    assert last == f"Terminated; {target} holds the {frames} frames so far"


def test_two_encodes_to_one_name(room: Path, tmp_path: Path) -> None:
    target = tmp_path / "k.3dvc"
    process = started(room, target)
    result = run("encode", room, target, "--preset", "live", "--frames", "0:2")
    assert result.exit_code == 1
    assert f"{target}: is being written by another 3dvc, in {target}.part; wait for it" in result.stderr
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=PATIENCE_S)
    assert run("encode", room, target, "--preset", "live", "--frames", "0:2").exit_code == 0
