# SPDX-License-Identifier: MIT
"""A synthetic recording through all commands, with the real encoder and decoder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from threedvc.cli.main import main


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code in (0, 1), result.output
    return result


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a recording and a stream of it."""
    folder = tmp_path_factory.mktemp("chain")
    assert run("synth", folder / "toys", "--scene", "paper", "--frames", "6").exit_code == 0
    options = ["--segment", "depth:10cm..1.2m", "--voxel-size", "2cm", "--verify"]
    result = run("encode", folder / "toys", folder / "a.3dvc", *options)
    assert result.exit_code == 0, result.stderr
    return folder


def test_statistics_of_a_real_stream(place: Path) -> None:
    result = run("stats", place / "a.3dvc", "--reference", place / "toys", "--json")
    values = json.loads(result.stdout)
    assert (values["complete"], values["frames"]) == (True, 6)
    assert sum(values["bytes_per_frame"]) == values["file_bytes"] == (place / "a.3dvc").stat().st_size
    assert len(values["entropy_bits"]) == 6
    assert {item["id"] for item in values["objects"]} == {0, 1}
    assert values["paper"]["M"] == next(item["cells"] for item in values["objects"] if item["id"] == 1)
    assert values["quality"]["psnr_rgb"] > 15
    assert values["quality"]["depth_lost"] < 0.1
    assert values["trajectory"]["objects"]["1"]["ate_rmse_mm"] < 5


def test_decoded_folder_is_what_the_stream_is_measured_by(place: Path) -> None:
    assert run("decode", place / "a.3dvc", place / "decoded").exit_code == 0
    quality = json.loads(run("stats", place / "a.3dvc", "--reference", place / "decoded", "--json").stdout)["quality"]
    assert quality["psnr_rgb"] == 99
    assert (quality["depth_max_mm"], quality["depth_lost"], quality["depth_invented"]) == (0, 0, 0)


def test_decoded_folder_is_valid_input(place: Path) -> None:
    assert run("decode", place / "a.3dvc", place / "again").exit_code == 0
    assert run("encode", place / "again", place / "b.3dvc", "--voxel-size", "2cm").exit_code == 0


def test_cut_stream(place: Path) -> None:
    cut = place / "cut.3dvc"
    cut.write_bytes((place / "a.3dvc").read_bytes()[:-20])
    result = run("decode", cut, place / "cut")
    assert result.exit_code == 1
    assert result.stderr.endswith(f"; 6 frames were decoded into {place / 'cut'}\n")
    assert json.loads(run("stats", cut, "--json").stdout)["complete"] is False
