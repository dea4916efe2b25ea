# SPDX-License-Identifier: MIT
"""Folders as other programs leave them: read where that is sure, else named with what to do."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.recorded_room import SMALL, color_picture, depth_picture, poses, write_lines, write_picture
from threedvc.errors import SequenceError
from threedvc.formats.sources import FolderSequence, open_sequence

FRAMES = 3
GIVEN = "60,61,31,24.5"
MATRIX = [60.0, 0.0, 31.0, 0.0, 61.0, 24.5, 0.0, 0.0, 1.0]
NERF = {"fl_x": 60.0, "fl_y": 61.0, "cx": 31.0, "cy": 24.5, "w": 64, "h": 48}


def write(folder: Path, color: Callable[[int], str], depth: Callable[[int], str], units: float = 1000.0) -> None:
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(folder / color(k), color_picture(SMALL, pose))
        write_picture(folder / depth(k), depth_picture(SMALL, pose, units))


def check(sequence: FolderSequence, units: float = 1000.0) -> None:
    """Frames must be in order and in meters."""
    assert len(sequence) == FRAMES
    assert sequence.info.rig.depth == SMALL
    for frame, pose in zip(sequence, poses(FRAMES), strict=True):
        assert np.array_equal(frame.color, color_picture(SMALL, pose))
        assert np.array_equal(np.rint(frame.depth * units), depth_picture(SMALL, pose, units))


def message(folder: Path, **options: str) -> str:
    with pytest.raises(SequenceError) as caught:
        open_sequence(folder, **options)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("color", "depth"),
    [
        ("{:05d}-color.png", "{:05d}-depth.png"),
        ("color_{:04d}.png", "depth_{:04d}.png"),
        ("RGB{}.png", "Depth{}.png"),
        ("img_{:03d}.png", "img_{:03d}_depth.png"),
        ("s2_{:03d}_color.png", "s2_{:03d}_aligned_depth_to_color.png"),
    ],
)
def test_one_folder_of_both_pictures(tmp_path: Path, color: str, depth: str) -> None:
    write(tmp_path, color.format, depth.format)
    assert message(tmp_path) == f"{tmp_path}: no camera intrinsics; give --intrinsics FILE or fx,fy,cx,cy"
    sequence = open_sequence(tmp_path, intrinsics=GIVEN)
    check(sequence)
    assert not sequence.notices
    (tmp_path / "intrinsics.json").write_text(json.dumps({"intrinsic_matrix": MATRIX, "width": 64, "height": 48}))
    check(open_sequence(tmp_path))


def test_one_folder_with_times_and_other_pictures(tmp_path: Path) -> None:
    def stamp(k: int) -> float:
        return 1700000000.1 + k / 30

    write(tmp_path, lambda k: f"take_Color_{stamp(k):.11f}.png", lambda k: f"take_Depth_{stamp(k) + 0.004:.11f}.png")
    write_picture(tmp_path / "take_Infrared_1.png", np.zeros((48, 64), np.uint8))
    sequence = open_sequence(tmp_path, intrinsics=GIVEN)
    check(sequence)
    assert sequence[1].timestamp_ns - sequence[0].timestamp_ns == pytest.approx(1e9 / 30, abs=1000)
    assert sequence.info.fps == pytest.approx(30, abs=0.01)
    assert str(sequence.notices[0]) == (
        f"Note: {tmp_path}: 1 pictures of neither kind are not read (take_Infrared_1.png)"
    )


def test_one_folder_that_lost_a_picture(tmp_path: Path) -> None:
    write(tmp_path, "{}-color.png".format, "{}-depth.png".format)
    (tmp_path / "1-depth.png").unlink()
    assert f"{tmp_path / '1-color.png'}: has no depth picture" in message(tmp_path)


def write_bop(folder: Path, **changes: object) -> Path:
    write(folder, "rgb/{:06d}.png".format, "depth/{:06d}.png".format, units=10_000)
    entries = {str(k): {"cam_K": MATRIX, "depth_scale": 0.1} for k in range(FRAMES)}
    entries["2"] |= changes  # type: ignore[operator]
    path = folder / "scene_camera.json"
    path.write_text(json.dumps(entries))
    return path


def test_cameras_and_depth_scale_of_bop(tmp_path: Path) -> None:
    path = write_bop(tmp_path)
    for k in range(FRAMES):
        write_picture(tmp_path / "mask_visib" / f"{k:06d}_000000.png", np.full((48, 64), 255, np.uint8))
    sequence = open_sequence(tmp_path)
    check(sequence, units=10_000)
    assert np.unique(sequence[0].mask).tolist() == [1]
    assert str(sequence.notices[1]) == (
        f"Note: {path}: the camera (fx 60) and the depth scale (10000 units per meter) is taken from this file"
    )
    given = open_sequence(tmp_path, intrinsics="50,50,31,24.5").info
    assert (given.rig.depth.fx, given.depth_scale) == (50, 10_000)
    assert open_sequence(tmp_path, depth_scale=5000).info.depth_scale == 5000


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"depth_scale": 1.0}, "frame 2 has another cam_K or depth_scale than frame 0; one camera and one scale must"),
        ({"cam_K": [9.0] * 9}, "frame 2 has another cam_K or depth_scale than frame 0; one camera and one scale must"),
        ({"cam_K": [1.0]}, "cam_K of frame 2 is not a list of 9 numbers; correct the file, or give --intrinsics"),
        ({"depth_scale": "mm"}, "depth_scale of frame 2 is 'mm', expected a positive number; correct it"),
        ({"depth_scale": 0}, "depth_scale of frame 2 is 0, expected a positive number; correct it"),
    ],
)
def test_bad_cameras_of_bop(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    path = write_bop(tmp_path, **changes)
    assert message(tmp_path).startswith(f"{path}: {said}")


def test_cameras_of_nerfstudio(tmp_path: Path) -> None:
    write(tmp_path, lambda k: f"images/frame_{k + 1:05d}.png", lambda k: f"depths/frame_{k + 1:05d}.png")
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({**NERF, "frames": [{"file_path": "images/frame_00001.png"}]}))
    sequence = open_sequence(tmp_path)
    check(sequence)
    assert str(sequence.notices[0]) == (
        f"Note: {path}: the camera (fx 60) is taken from this file; its poses are not read, and the camera is tracked"
    )
    assert open_sequence(tmp_path, intrinsics="50,50,31,24.5").info.rig.depth.fx == 50


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"camera_model": "OPENCV_FISHEYE"},
            "camera_model OPENCV_FISHEYE is not read; undistort the pictures, and give",
        ),
        ({"w": 1920, "h": 1440}, "its camera is of 1920x1440 pictures, but these are 64x48; give --intrinsics FILE"),
        ({"fl_x": None}, "fl_x of all frames is missing or no number; give --intrinsics FILE"),
        ({"k1": "none"}, "k1 of all frames is missing or no number; give --intrinsics FILE"),
        ({"fl_x": -3.0}, ""),
    ],
)
def test_bad_cameras_of_nerfstudio(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    write(tmp_path, "images/{}.png".format, "depths/{}.png".format)
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({**NERF, **changes}))
    assert message(tmp_path).startswith(f"{path}: {said}")


def test_nerfstudio_with_small_depth(tmp_path: Path) -> None:
    write(tmp_path, "images/{}.png".format, "depths/{}.png".format)
    for k in range(FRAMES):
        write_picture(tmp_path / "depths" / f"{k}.png", np.full((24, 32), 900, np.uint16))
    (tmp_path / "transforms.json").write_text(json.dumps(NERF))
    assert "has one camera, but color is 64x48 and depth 32x24; give --intrinsics" in message(tmp_path)


def test_rtabmap(tmp_path: Path) -> None:
    write(tmp_path, lambda k: f"rgb/{1459.5 + k / 30:.6f}.png", lambda k: f"depth/{1459.5 + k / 30:.6f}.png")
    (tmp_path / "calib").mkdir()
    write_lines(tmp_path / "poses.txt", ["#timestamp x y z qx qy qz qw id"])
    assert message(tmp_path) == (
        f"{tmp_path}: holds an export of RTAB-Map; give --layout bare and --intrinsics FILE or fx,fy,cx,cy, as calib/ "
        "has them (its poses.txt is not read)"
    )
    check(open_sequence(tmp_path, layout="bare", intrinsics=GIVEN))


@pytest.mark.parametrize(
    ("files", "said"),
    [
        (
            ["rgb.mp4", "odometry.csv", "depth/000000.png"],
            "holds a recording of Stray Scanner, whose color is a video",
        ),
        (["rgbd/0.jpg", "rgbd/0.depth", "metadata"], "holds an export of Record3D, whose depth is compressed; let it"),
        (["walk.bag"], "holds a rosbag; take its pictures out as color/NNNNNN.png and depth/NNNNNN.png first"),
    ],
)
def test_recordings_of_other_programs(tmp_path: Path, files: list[str], said: str) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"\0")
    assert message(tmp_path).startswith(f"{tmp_path}: {said}")


@pytest.mark.parametrize("kind", ["tiff", "npy", "npz", "exr", "webp", "bmp", "pgm", "pfm", "BMP"])
@pytest.mark.parametrize("place", ["color", "depth"])
def test_other_kinds_of_pictures(tmp_path: Path, kind: str, place: str) -> None:
    write(tmp_path, "color/{}.png".format, "depth/{}.png".format)
    for path in (tmp_path / place).iterdir():
        path.rename(path.with_suffix(f".{kind}"))
    said = message(tmp_path, intrinsics=GIVEN)
    assert said.startswith(f"{tmp_path / place}: holds no .png or .jpg picture but {FRAMES} .{kind.lower()} files (")
    assert said.endswith(
        "convert color to 8-bit PNG or JPEG, depth to 16-bit PNG, such as whole millimeters, 0 where there is none"
    )


def test_masks_that_a_layout_does_not_read_are_told(tmp_path: Path) -> None:
    write(tmp_path, "{}-color.png".format, "{}-depth.png".format)
    write_picture(tmp_path / "masks" / "0.png", np.zeros((48, 64), np.uint8))
    (notice,) = open_sequence(tmp_path, intrinsics=GIVEN).notices
    assert str(notice) == (
        f"Note: {tmp_path / 'masks'}: masks are not read in this layout; --layout bare or plain reads them"
    )
