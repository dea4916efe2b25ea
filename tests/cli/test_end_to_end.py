# SPDX-License-Identifier: MIT
"""A synthetic recording through all commands, with the real encoder and decoder."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from threedvc.cli.main import main
from threedvc.coding.video.av1 import can_encode_av1
from threedvc.formats.sources import open_sequence


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code in (0, 1), result.output
    return result


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a recording and a stream of it."""
    folder = tmp_path_factory.mktemp("chain")
    assert run("synth", folder / "toys", "--scene", "paper", "--frames", "6", "--size", "72x72").exit_code == 0
    options = ["--segment", "depth:10cm..1.2m", "--voxel-size", "2cm", "--preset", "fast", "--verify"]
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


def test_objects_of_a_real_stream(place: Path) -> None:
    result = run("stats", place / "a.3dvc", "--reference", place / "toys", "--json")
    values = json.loads(result.stdout)
    (toy,) = values["reference_objects"]
    assert (toy["label"], toy["number"], toy["frames"], values["spurious_objects"]) == (1, 1, 6, [])
    assert toy["iou"] > 0.8
    assert toy["pose"]["frames"] == 6
    assert toy["pose"]["rotation_max_deg"] < 3
    assert toy["pose"]["translation_max_mm"] < 5
    (life,) = [item for item in values["objects"] if item["id"] == 1]
    assert (life["spans"], life["birth"], life["death"]) == ([[0, 5]], 0, None)
    assert values["trajectory"]["travel"]["length_m"] == 0


def test_a_stream_that_knows_no_objects(place: Path) -> None:
    flat = place / "flat.3dvc"
    assert run("encode", place / "toys", flat, "--segment", "none", "--preset", "live").exit_code == 0
    values = json.loads(run("stats", flat, "--reference", place / "toys", "--json").stdout)
    (toy,) = values["reference_objects"]
    assert (toy["number"], toy["iou"], toy["pose"]) == (None, 0, None)
    assert (values["object_count"], values["spurious_objects"]) == (0, [])


@pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1")
def test_depth_is_shown_as_filmed_or_of_the_models(tmp_path: Path) -> None:
    stream = tmp_path / "a.3dvc"
    assert run("synth", tmp_path / "room", "--scene", "room", "--frames", "5", "--size", "64x48").exit_code == 0
    options = ["--depth-video", "on", "--preset", "fast", "--voxel-size", "10cm", "--verify"]
    assert run("encode", tmp_path / "room", stream, *options).exit_code == 0
    assert json.loads(run("stats", stream, "--json").stdout)["packets"]["DEPTH_VIDEO"]["count"] == 1
    shares = {}
    for source in ("filmed", "models"):
        folder = tmp_path / source
        assert run("decode", stream, folder, "--depth", source).exit_code == 0
        pairs = list(zip(open_sequence(folder), open_sequence(tmp_path / "room"), strict=True))
        off = [np.abs(shown.depth - given.depth) / given.depth for shown, given in pairs]
        shares[source] = float(np.mean(np.array(off) < 0.01))
    assert shares["filmed"] > shares["models"] + 0.1


def test_live_streams_have_no_depth_video(place: Path) -> None:
    options = ["--depth-video", "on", "--preset", "live"]
    result = CliRunner().invoke(main, ["encode", str(place / "toys"), str(place / "no.3dvc"), *options])
    assert result.exit_code == 2
    assert "--depth-video on and --preset live contradict each other" in result.stderr
    assert not (place / "no.3dvc").exists()


def test_latency_is_of_live_streams(place: Path, tmp_path: Path) -> None:
    refused = CliRunner().invoke(main, ["encode", str(place / "toys"), str(place / "no.3dvc"), "--latency", "500ms"])
    assert refused.exit_code == 2
    assert "--latency is for live streams; add --preset live, or leave it out" in refused.stderr
    options = ["--preset", "live", "--latency", "100ms", "--json"]
    report = json.loads(run("encode", place / "toys", tmp_path / "live.3dvc", *options).stdout)
    assert 0.1 <= report["latency_s"] < report["seconds"] + 0.2
    batches = json.loads(run("stats", tmp_path / "live.3dvc", "--json").stdout)["packets"]["BATCH"]["count"]
    assert batches == -(-report["frames"] // 3)


def test_live_streams_have_a_color_video(place: Path, tmp_path: Path) -> None:
    options = ["--color-video", "on", "--preset", "live", "--verify"]
    result = run("encode", place / "toys", tmp_path / "live.3dvc", *options)
    assert result.exit_code == 0, result.stderr
    assert "COLOR_VIDEO" in run("stats", tmp_path / "live.3dvc").stdout


def test_trajectory_of_a_moving_camera(tmp_path: Path) -> None:
    assert run("synth", tmp_path / "room", "--scene", "room", "--frames", "5", "--size", "64x48").exit_code == 0
    options = ["--motion", "known", "--voxel-size", "8cm", "--preset", "fast"]
    assert run("encode", tmp_path / "room", tmp_path / "a.3dvc", *options).exit_code == 0
    result = run("stats", tmp_path / "a.3dvc", "--reference", tmp_path / "room", "--trajectory", tmp_path / "t.txt")
    assert result.exit_code == 0, result.stderr
    assert "over all 5 frames with a known pose; lost in the stream: 0" in result.stdout
    true, found = (np.loadtxt(path) for path in (tmp_path / "room" / "poses.txt", tmp_path / "t.txt"))
    assert found[:, 0].tolist() == true[:, 0].tolist() == [0, 1, 2, 3, 4]
    # Poses are fitted to pictures of few pixels and coarse cells.
    np.testing.assert_allclose(found, true, atol=0.02)


def test_decoded_folder_is_what_the_stream_is_measured_by(place: Path) -> None:
    assert run("decode", place / "a.3dvc", place / "decoded").exit_code == 0
    quality = json.loads(run("stats", place / "a.3dvc", "--reference", place / "decoded", "--json").stdout)["quality"]
    assert quality["psnr_rgb"] == 99
    assert (quality["depth_max_mm"], quality["depth_lost"], quality["depth_invented"]) == (0, 0, 0)


def test_decoded_folder_is_valid_input(place: Path) -> None:
    assert run("decode", place / "a.3dvc", place / "again").exit_code == 0
    assert run("encode", place / "again", place / "b.3dvc", "--preset", "live").exit_code == 0


def test_cut_stream(place: Path) -> None:
    cut = place / "cut.3dvc"
    cut.write_bytes((place / "a.3dvc").read_bytes()[:-20])
    result = run("decode", cut, place / "cut")
    assert result.exit_code == 1
    assert result.stderr.endswith(f"; 6 frames were decoded into {place / 'cut'}\n")
    assert json.loads(run("stats", cut, "--json").stdout)["complete"] is False


@pytest.fixture(scope="module")
def mounted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make recordings of two sensors and a stream of both."""
    folder = tmp_path_factory.mktemp("mounted")
    options = ("--scene", "room", "--frames", "4", "--size", "64x48")
    assert run("synth", folder / "room", *options, "--sensors", "2").exit_code == 0
    left, right = folder / "room" / "sensor0", folder / "room" / "sensor1"
    options = ("--voxel-size", "8cm", "--preset", "fast", "--verify")
    result = run("encode", "--input", left, "--input", right, folder / "a.3dvc", *options)
    assert result.exit_code == 0, result.stderr
    return folder


def test_several_sensors_come_back(mounted: Path) -> None:
    room = mounted / "room"
    assert run("decode", mounted / "a.3dvc", mounted / "out").exit_code == 0
    for name in ("sensor0", "sensor1"):
        assert len(list((mounted / "out" / name / "color").iterdir())) == 4
        cameras = [json.loads((parent / name / "intrinsics.json").read_text()) for parent in (room, mounted / "out")]
        np.testing.assert_allclose(cameras[1]["T_rig_depth"], cameras[0]["T_rig_depth"], atol=1e-12)
        poses = [np.loadtxt(parent / name / "poses.txt") for parent in (room, mounted / "out")]
        np.testing.assert_allclose(poses[1], poses[0], atol=0.01)
    references = [part for name in ("sensor0", "sensor1") for part in ("--reference", room / name)]
    values = json.loads(run("stats", mounted / "a.3dvc", *references, "--json").stdout)
    assert [(sensor["name"], sensor["frames"]) for sensor in values["sensors"]] == [("sensor0", 4), ("sensor1", 4)]
    assert values["quality"]["depth_within_1pct"] > 0.5
    assert (
        run(
            "encode", mounted / "out" / "sensor0", mounted / "out" / "sensor1", mounted / "b.3dvc", "--preset", "live"
        ).exit_code
        == 0
    )


def test_one_of_several_sensors(mounted: Path) -> None:
    assert run("decode", mounted / "a.3dvc", mounted / "right", "--sensor", "1", "--frames", "1:3").exit_code == 0
    assert sorted(path.name for path in (mounted / "right" / "color").iterdir()) == ["000001.png", "000002.png"]
    assert "sensor1" not in [path.name for path in (mounted / "right").iterdir()]
    result = run("decode", mounted / "a.3dvc", mounted / "none", "--sensor", "2")
    assert result.stderr == f"Error: {mounted / 'a.3dvc'}: has no sensor 2; choose from 0 to 1\n"


def test_extrinsics_in_every_form(mounted: Path, tmp_path: Path) -> None:
    left, right = (mounted / "room" / name for name in ("sensor0", "sensor1"))
    T = np.array(json.loads((right / "intrinsics.json").read_text())["T_rig_depth"])
    (tmp_path / "T.txt").write_text("\n".join(" ".join(map(str, row)) for row in T))
    (tmp_path / "T.json").write_text(json.dumps(T.tolist()))
    for form in (
        tmp_path / "T.txt",
        tmp_path / "T.json",
        right / "intrinsics.json",
        "0.12,0,0,0,0.2955202,0,0.9553365",
    ):
        result = run("encode", left, tmp_path / "a.3dvc", "--input", right, "--extrinsics", form, "--voxel-size", "8cm",
                     "--preset", "live", "--frames", "0:2")  # fmt: skip
        assert result.exit_code == 0, result.stderr
        run("decode", tmp_path / "a.3dvc", tmp_path / "out")
        found = json.loads((tmp_path / "out" / "sensor1" / "intrinsics.json").read_text())["T_rig_depth"]
        np.testing.assert_allclose(found, T, atol=1e-6)


def test_wrong_extrinsics(mounted: Path, place: Path, tmp_path: Path) -> None:
    left, right = (mounted / "room" / name for name in ("sensor0", "sensor1"))
    for folders, options, message in (
        ([left, place / "toys"], [], f"{place / 'toys'}: does not tell how its sensor is mounted; give --"),
        ([left, right], ["--extrinsics", "1,2,3"], "--extrinsics 1,2,3: neither a file nor seven numbers; give a file"),
        ([left, right], ["--extrinsics", "0,0,0,0,0,0,2"], "--extrinsics 0,0,0,0,0,0,2: pose has a quaternion"),
        ([left, right], 2 * ["--extrinsics", "0,0,0,0,0,0,1"], "--extrinsics is given 2 times for 2 sensors"),
        ([left, right], 3 * ["--fps", "30"], "--fps is given 3 times for 2 sensors; give it once or for each of them"),
        ([left, right], ["--segment", "motion"], "--segment motion divides the frames of one sensor; give masks or"),
    ):  # fmt: skip
        result = run("encode", *folders, tmp_path / "a.3dvc", *options)
        assert result.exit_code == 1
        assert result.stderr.startswith(f"Error: {message}"), result.stderr
        assert not (tmp_path / "a.3dvc").exists()


def test_options_of_sensors_that_are_not_there(place: Path, tmp_path: Path) -> None:
    for options in (["--fps", "10", "--fps", "20"], ["--extrinsics", "0,0,0,0,0,0,1"], ["--sensor", "ideal"] * 2):
        result = CliRunner().invoke(main, ["encode", str(place / "toys"), str(tmp_path / "a.3dvc"), *options])
        assert result.exit_code == 2
    result = CliRunner().invoke(main, ["encode", str(tmp_path / "a.3dvc")])
    assert result.exit_code == 2
    assert "no INPUT; name the folder of RGB-D frames, then OUTPUT.3dvc" in result.stderr
