# SPDX-License-Identifier: MIT
"""What README.md tells a new user to type works."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from threedvc.cli.main import main

README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
SHELL = "".join(text for language, text in BLOCKS if not language)
PYTHON = "".join(text for language, text in BLOCKS if language == "python")
SYNTHESIS, *OTHERS = [line.split("#")[0].strip() for line in re.findall(r"^3dvc .*", SHELL, re.MULTILINE)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the sequence of README.md: fewer and smaller pictures, of a room a fifth as large."""
    place = tmp_path_factory.mktemp("readme")
    arguments = ["synth", str(place / "room"), "--scene", "room", "--frames", "2", "--size", "48x36"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    intrinsics, poses = place / "room" / "intrinsics.json", place / "room" / "poses.txt"
    content = json.loads(intrinsics.read_text())
    intrinsics.write_text(json.dumps({**content, "depth_scale": 5 * content["depth_scale"]}))
    rows = np.loadtxt(poses)
    rows[:, 1:4] /= 5
    np.savetxt(poses, rows, fmt=["%d", *["%.9f"] * 7])
    return place


def test_command_that_makes_the_sequence_is_understood() -> None:
    name, *arguments = shlex.split(SYNTHESIS)[1:]
    context = main.commands[name].make_context(name, arguments)
    assert (context.params["scene"], context.params["size"]) == ("room", (320, 240))


def test_commands_run_in_their_order(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    for line in OTHERS:
        result = CliRunner().invoke(main, shlex.split(line)[1:])
        assert result.exit_code == 0, f"{line}: {result.output}"
    assert len(list((folder / "decoded" / "color").iterdir())) == 2


def test_example_in_python_runs(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    exec(compile(PYTHON, "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert "2 frames" in lines[0]
    assert lines[1].startswith("0 (480, 640, 3)")
    assert 5 < float(lines[-1].split()[0]) < 100


def test_options_named_in_tables_exist() -> None:
    known = {name for command in main.commands.values() for option in command.params for name in option.opts}
    rows = re.findall(r"^\| `(--[a-z-]+)", README, re.MULTILINE)
    assert rows
    assert set(rows) <= known
