# SPDX-License-Identifier: MIT
"""Every layout: the same recorded room goes in, and depth warped between frames must agree."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from helpers.recorded_room import (
    SMALL,
    VGA,
    color_picture,
    depth_picture,
    pose_row,
    poses,
    wall_colors,
    write_lines,
    write_picture,
)
from reference.warp import colors_at, depth_differences, world_points
from threedvc.errors import SequenceError
from threedvc.formats.sources import FolderSequence, open_sequence
from threedvc.formats.sources.layouts.seven_scenes import RIG
from threedvc.formats.sources.layouts.tum import CAMERAS
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, identity, make_pose, rotation_from_vector

FRAMES = 3
INTRINSIC_KEYS = ("width", "height", "fx", "fy", "cx", "cy")
TUM_STAMPS = ["1305031102.175304", "1305031102.211214", "1305031102.243211"]
TUM_DEPTH_STAMPS = ["1305031102.160407", "1305031102.226738", "1305031102.262886"]
TUM_DEPTH_STAMPS_NS = [1305031102160407000, 1305031102226738000, 1305031102262886000]


def matrix_lines(pose: Pose) -> list[str]:
    return ["\t ".join(f"{value:.9e}" for value in line) for line in pose]


def camera_entries(camera: Camera) -> dict[str, object]:
    entries = {key: getattr(camera, key) for key in INTRINSIC_KEYS}
    return {**entries, "distortion": list(camera.distortion)}


def check_geometry(sequence: FolderSequence, tolerance_m: float) -> None:
    """Depth warped from each frame to the next must agree, and the colors must be those of the walls."""
    frames = list(sequence)
    rig = sequence.info.rig
    for source, target in pairwise(frames):
        difference = np.abs(depth_differences(source, target, rig, stride=2))
        assert len(difference) > 0.5 * target.depth.size / 4
        assert np.median(difference) < tolerance_m
        assert np.mean(difference < 5 * tolerance_m) > 0.95
        not_moved = replace(source, T_world_camera=target.T_world_camera)
        assert np.median(np.abs(depth_differences(not_moved, target, rig, stride=2))) > 3 * np.median(difference)
        points = world_points(source, rig, stride=4)
        shown, inside = colors_at(target, rig, points)
        off = np.abs(shown.astype(int) - wall_colors(points[inside]))
        assert np.mean(inside) > 0.5
        assert np.mean(off) < 4


def write_plain(folder: Path, rig: CameraRig, units: float = 1000.0, suffix: str = ".png") -> None:
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(folder / "color" / f"{k:06d}{suffix}", color_picture(rig.color, pose))
        write_picture(folder / "depth" / f"{k:06d}.png", depth_picture(rig.depth, pose, units))
    write_lines(
        folder / "poses.txt", ["# frame tx ty tz", *(pose_row(k, pose) for k, pose in enumerate(poses(FRAMES)))]
    )


def test_plain_registered(tmp_path: Path) -> None:
    write_plain(tmp_path, CameraRig.registered_to(SMALL), units=5000)
    content = {**camera_entries(SMALL), "depth_scale": 5000, "fps": 25, "depth_true_scale": 1, "intrinsics_known": True}
    (tmp_path / "intrinsics.json").write_text(json.dumps(content))
    sequence = open_sequence(tmp_path)
    info = sequence.info
    assert (info.rig.registered, info.rig.color, info.depth_scale, info.fps) == (True, SMALL, 5000, 25)
    assert (info.frame_count, info.gray, info.name) == (FRAMES, False, tmp_path.name)
    assert (info.has_camera_poses, info.has_object_poses, info.has_masks) == (True, False, False)
    assert [frame.timestamp_ns for frame in sequence] == [0, 40_000_000, 80_000_000]
    assert all(frame.color_timestamp_ns is None for frame in sequence)
    check_geometry(sequence, 0.003)


def test_plain_with_distorted_lens_and_jpeg(tmp_path: Path) -> None:
    lens = replace(SMALL, distortion=(0.2, -0.3, 0.01, -0.008, 0.1))
    write_plain(tmp_path, CameraRig.registered_to(lens), suffix=".jpg")
    (tmp_path / "intrinsics.json").write_text(json.dumps(camera_entries(lens)))
    sequence = open_sequence(tmp_path)
    assert sequence.info.rig.depth.distortion == lens.distortion
    assert (sequence.info.depth_scale, sequence.info.fps) == (1000, 30)
    check_geometry(sequence, 0.003)


def test_plain_with_two_cameras(tmp_path: Path) -> None:
    rig = CameraRig(
        color=Camera(width=80, height=60, fx=70.0, fy=70.0, cx=40.0, cy=29.0),
        depth=SMALL,
        T_color_depth=make_pose(rotation_from_vector(np.array([0.02, -0.05, 0.03])), np.array([0.1, -0.02, 0.03])),
    )
    for k, pose in enumerate(poses(FRAMES)):
        color_pose = pose @ np.linalg.inv(rig.T_color_depth)
        write_picture(tmp_path / "color" / f"{k:06d}.png", color_picture(rig.color, color_pose))
        write_picture(tmp_path / "depth" / f"{k:06d}.png", depth_picture(rig.depth, pose, 1000))
    write_lines(tmp_path / "poses.txt", [pose_row(k, pose) for k, pose in enumerate(poses(FRAMES))])
    content = {"color": camera_entries(rig.color), "depth": camera_entries(rig.depth)}
    (tmp_path / "intrinsics.json").write_text(json.dumps({**content, "T_color_depth": rig.T_color_depth.tolist()}))
    sequence = open_sequence(tmp_path)
    assert not sequence.info.rig.registered
    assert np.allclose(sequence.info.rig.T_color_depth, rig.T_color_depth, atol=1e-12)
    check_geometry(sequence, 0.003)


def write_tum_pictures(folder: Path, camera: Camera, names: list[tuple[str, str]]) -> None:
    for pose, (color_name, depth_name) in zip(poses(FRAMES), names, strict=True):
        write_picture(folder / "rgb" / f"{color_name}.png", color_picture(camera, pose))
        write_picture(folder / "depth" / f"{depth_name}.png", depth_picture(camera, pose, 5000))


def write_tum(folder: Path, camera: Camera, header: str = "# file: 'rgbd_dataset_freiburg1_xyz.bag'") -> None:
    """Write lists with one unpaired depth picture, and a ground truth with the true pose at each depth picture."""
    write_tum_pictures(folder, camera, list(zip(TUM_STAMPS, TUM_DEPTH_STAMPS, strict=True)))
    comments = ["# color images", header, "# timestamp filename"]
    write_lines(folder / "rgb.txt", [*comments, *(f"{stamp} rgb/{stamp}.png" for stamp in TUM_STAMPS)])
    unpaired = "1305031102.999999 depth/absent.png"
    depth_lines = [f"{stamp} depth/{stamp}.png" for stamp in TUM_DEPTH_STAMPS]
    write_lines(folder / "depth.txt", [*comments, *depth_lines, unpaired])
    truth = [pose_row(stamp, pose) for stamp, pose in zip(TUM_DEPTH_STAMPS, poses(FRAMES), strict=True)]
    # No newline after the header, as some writers leave it.
    (folder / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw" + "\n".join(truth) + "\n")


def test_tum(tmp_path: Path) -> None:
    write_tum(tmp_path, CAMERAS["1"])
    sequence = open_sequence(tmp_path)
    assert sequence.info.rig.registered
    assert sequence.info.rig.color == CAMERAS["1"]
    assert sequence.info.depth_scale == 5000
    assert sequence.info.has_camera_poses
    assert [frame.timestamp_ns for frame in sequence] == TUM_DEPTH_STAMPS_NS
    assert sequence[0].color_timestamp_ns == 1305031102175304000
    check_geometry(sequence, 0.003)


def test_tum_interpolates_the_ground_truth_at_the_depth_picture(tmp_path: Path) -> None:
    write_tum(tmp_path, VGA)
    early, late = poses(2)
    truth = [pose_row("1305031102.130407", early), pose_row("1305031102.190407", late), pose_row("1305031103", late)]
    write_lines(tmp_path / "groundtruth.txt", truth)
    sequence = open_sequence(tmp_path, intrinsics="525,525,319.5,239.5")
    middle = sequence[0].T_world_camera
    assert middle is not None
    assert np.allclose(middle[:3, 3], (early[:3, 3] + late[:3, 3]) / 2, atol=1e-6)
    assert np.allclose(middle[:3, :3] @ early[:3, :3].T, late[:3, :3] @ middle[:3, :3].T, atol=1e-6)
    assert sequence[1].T_world_camera is None
    assert not sequence.info.has_camera_poses


@pytest.mark.parametrize("depth_first", [False, True])
def test_tum_accepts_associations_in_either_order(tmp_path: Path, depth_first: bool) -> None:
    write_tum_pictures(tmp_path, SMALL, [("a", "d"), ("b", "e"), ("c", "f")])
    lines = []
    for stamp, color, depth_stamp, depth in zip(TUM_STAMPS, "abc", TUM_DEPTH_STAMPS, "def", strict=True):
        halves = [f"{stamp} rgb/{color}.png", f"{depth_stamp} depth/{depth}.png"]
        lines.append(" ".join(reversed(halves) if depth_first else halves))
    write_lines(tmp_path / "associations.txt", lines)
    sequence = open_sequence(tmp_path, intrinsics="60,61,31,24.5")
    assert [frame.timestamp_ns for frame in sequence] == TUM_DEPTH_STAMPS_NS
    assert np.array_equal(sequence[0].color, color_picture(SMALL, poses(1)[0]))


def test_tum_needs_intrinsics_for_an_unknown_sequence(tmp_path: Path) -> None:
    write_tum(tmp_path, VGA, header="# file: 'office.bag'")
    with pytest.raises(SequenceError) as caught:
        open_sequence(tmp_path)
    assert str(caught.value) == f"{tmp_path}: no camera intrinsics; give --intrinsics FILE or fx,fy,cx,cy"


def test_icl_nuim(tmp_path: Path) -> None:
    camera = Camera(width=640, height=480, fx=481.2, fy=480.0, cx=319.5, cy=239.5)
    write_tum_pictures(tmp_path, camera, [("0", "0"), ("1", "1"), ("2", "2")])
    write_lines(tmp_path / "associations.txt", [f"{k} depth/{k}.png {k} rgb/{k}.png" for k in range(FRAMES)])
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    truth = [pose_row(k, mirror @ pose @ mirror) for k, pose in enumerate(poses(FRAMES))]
    write_lines(tmp_path / "livingRoom0.gt.freiburg", truth)
    sequence = open_sequence(tmp_path)
    assert sequence.info.rig.color == camera
    assert [frame.timestamp_ns for frame in sequence] == [0, 33_333_333, 66_666_667]
    for frame, pose in zip(sequence, poses(FRAMES), strict=True):
        assert frame.T_world_camera is not None
        assert np.allclose(frame.T_world_camera, pose, atol=1e-8)
    check_geometry(sequence, 0.003)


def write_seven_scenes(folder: Path) -> None:
    for k, pose in enumerate(poses(FRAMES)):
        depth = depth_picture(RIG.depth, pose, 1000)
        depth[:10, :10] = 65535
        depth[10:20, :10] = 0
        write_picture(folder / f"frame-{k:06d}.color.png", color_picture(RIG.color, pose))
        write_picture(folder / f"frame-{k:06d}.depth.png", depth)
        write_lines(folder / f"frame-{k:06d}.pose.txt", matrix_lines(pose))


def test_seven_scenes(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path)
    sequence = open_sequence(tmp_path)
    assert not sequence.info.rig.registered
    assert (sequence.info.rig.depth.fx, sequence.info.rig.color.fx) == (585, 525)
    assert np.array_equal(sequence.info.rig.T_color_depth, identity())
    assert not sequence[1].depth[:20, :10].any()
    assert sequence[1].depth[20:].all()
    saturated = sequence[1].saturated
    assert saturated is not None
    assert saturated[:10, :10].all()
    assert np.count_nonzero(saturated) == 100
    check_geometry(sequence, 0.003)


def test_redwood_with_open3d_files(tmp_path: Path) -> None:
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(tmp_path / "image" / f"{k:05d}.jpg", color_picture(SMALL, pose))
        write_picture(tmp_path / "depth" / f"{k:05d}.png", depth_picture(SMALL, pose, 1000))
    matrix = [SMALL.fx, 0, 0, 0, SMALL.fy, 0, SMALL.cx, SMALL.cy, 1]
    content = {"width": SMALL.width, "height": SMALL.height, "intrinsic_matrix": matrix}
    (tmp_path / "camera_intrinsic.json").write_text(json.dumps(content))
    log = [line for k, pose in enumerate(poses(FRAMES)) for line in (f"{k} {k} {k + 1}", *matrix_lines(pose))]
    write_lines(tmp_path / "trajectory.log", log)
    sequence = open_sequence(tmp_path)
    assert sequence.info.rig.color == SMALL
    assert [frame.timestamp_ns for frame in sequence] == [0, 33_333_333, 66_666_667]
    check_geometry(sequence, 0.003)


def test_redwood_with_stamped_names(tmp_path: Path) -> None:
    color_us, depth_us = [0, 33369, 66738, 100107], [5000, 66740, 33380]
    for k, stamp in enumerate(color_us):
        write_picture(tmp_path / "rgb" / f"{k:07d}-{stamp:012d}.jpg", color_picture(VGA, poses(1)[0]))
    for k, stamp in enumerate(sorted(depth_us)):
        write_picture(tmp_path / "depth" / f"{k:07d}-{stamp:012d}.png", depth_picture(VGA, poses(1)[0], 1000))
    sequence = open_sequence(tmp_path)
    assert sequence.info.rig.color == VGA
    assert [frame.timestamp_ns for frame in sequence] == [5_000_000, 33_380_000, 66_740_000]
    assert [frame.color_timestamp_ns for frame in sequence] == [0, 33_369_000, 66_738_000]
    assert not sequence.info.has_camera_poses


def test_bare_folders_are_paired_by_number(tmp_path: Path) -> None:
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(tmp_path / "left" / f"shot{8 + k}.png", color_picture(SMALL, pose))
        write_picture(tmp_path / "range" / f"z{8 + k:04d}.png", depth_picture(SMALL, pose, 2000))
    sequence = open_sequence(
        tmp_path, color="left", depth=tmp_path / "range", intrinsics="60,61,31,24.5", depth_scale=2000, fps=10
    )
    assert [frame.timestamp_ns for frame in sequence] == [0, 100_000_000, 200_000_000]
    for frame, pose in zip(sequence, poses(FRAMES), strict=True):
        assert np.array_equal(frame.color, color_picture(SMALL, pose))
        assert np.array_equal(np.rint(frame.depth * 2000), depth_picture(SMALL, pose, 2000))
    assert sequence.info.rig.registered
    assert sequence.info.rig.color == SMALL


def test_bare_with_open3d_parameters(tmp_path: Path) -> None:
    write_picture(tmp_path / "rgb" / "0.png", color_picture(SMALL, poses(1)[0]))
    write_picture(tmp_path / "depth" / "0.png", depth_picture(SMALL, poses(1)[0], 1000))
    intrinsic = {"intrinsic_matrix": [60, 0, 0, 0, 61, 0, 31, 24.5, 1], "width": 64, "height": 48}
    (tmp_path / "view.json").write_text(json.dumps({"class_name": "PinholeCameraParameters", "intrinsic": intrinsic}))
    assert open_sequence(tmp_path, intrinsics="view.json").info.rig.color == SMALL


@pytest.mark.parametrize("text", ["60 0 31\n0 61 24.5\n0 0 1\n", "60,0,31,0\n0,61,24.5,0\n0,0,1,0\n0,0,0,1\n"])
def test_bare_with_a_matrix_file(tmp_path: Path, text: str) -> None:
    write_picture(tmp_path / "rgb" / "0.png", color_picture(SMALL, poses(1)[0]))
    write_picture(tmp_path / "depth" / "0.png", depth_picture(SMALL, poses(1)[0], 1000))
    (tmp_path / "K.txt").write_text(text)
    assert open_sequence(tmp_path, intrinsics="K.txt").info.rig.color == SMALL


def test_given_intrinsics_replace_those_of_the_recording(tmp_path: Path) -> None:
    write_plain(tmp_path, CameraRig.registered_to(SMALL), units=5000)
    content = {**camera_entries(SMALL), "depth_scale": 5000, "fps": 12}
    (tmp_path / "intrinsics.json").write_text(json.dumps(content))
    info = open_sequence(tmp_path, intrinsics="50,51,30,20", fps=15).info
    assert (info.rig.color.fx, info.depth_scale, info.fps) == (50, 5000, 15)


@pytest.mark.parametrize(
    ("name", "source", "target", "median_m"),
    [
        ("kitchen300", 0, 20, 0.008),
        ("room_orbit", 0, 5, 0.008),
        ("room_orbit", 0, 286, 0.008),
        ("iphone_door", 0, 15, 0.004),
        ("fr1_rpy", 0, 4, 0.012),
    ],
)
def test_recorded_sequences(
    sequence_dir: Callable[[str], Path], name: str, source: int, target: int, median_m: float
) -> None:
    sequence = open_sequence(sequence_dir(name))
    first, second = sequence[source], sequence[target]
    warped = np.median(np.abs(depth_differences(first, second, sequence.info.rig, stride=2)))
    not_moved = replace(first, T_world_camera=second.T_world_camera)
    unwarped = np.median(np.abs(depth_differences(not_moved, second, sequence.info.rig, stride=2)))
    assert warped < median_m
    assert unwarped > 1.5 * warped
