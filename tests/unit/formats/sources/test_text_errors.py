# SPDX-License-Identifier: MIT
"""Bad cameras, scales, poses, times and lists: one line that names the file, the value and the remedy."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from helpers.damaged_recording import FRAMES, INTRINSICS, POSE_LINES, edit_intrinsics, message, write_sound_recording
from helpers.recorded_room import write_lines, write_picture
from threedvc.formats.sources import open_sequence


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a sound recording in the plain layout, for a test to damage."""
    return write_sound_recording(tmp_path / "recording")


def test_no_intrinsics(recording: Path) -> None:
    (recording / "intrinsics.json").unlink()
    assert message(recording) == f"{recording}: no camera intrinsics; give --intrinsics FILE or fx,fy,cx,cy"
    assert message(recording, layout="plain") == (
        f"{recording / 'intrinsics.json'}: no camera intrinsics; add the file, or give --intrinsics FILE or fx,fy,cx,cy"
    )


@pytest.mark.parametrize("given", ["missing.json", "500,500,320", "a,b,c,d"])
def test_intrinsics_option_is_neither_file_nor_numbers(recording: Path, given: str) -> None:
    assert message(recording, intrinsics=given) == (
        f"--intrinsics {given}: neither a file nor four numbers fx,fy,cx,cy; give --intrinsics FILE or fx,fy,cx,cy"
    )


def test_intrinsics_option_with_pictures_of_two_sizes(recording: Path) -> None:
    for k in range(FRAMES):
        write_picture(recording / "depth" / f"{k:06d}.png", np.full((24, 32), 900, np.uint16))
    assert message(recording, intrinsics="60,60,32,24") == (
        "--intrinsics 60,60,32,24: one camera cannot have pictures of 64x48 (color) and 32x24 (depth); "
        "give a file with color, depth and T_color_depth"
    )
    (recording / "K.txt").write_text("60 0 32\n0 60 24\n0 0 1\n")
    assert message(recording, intrinsics="K.txt") == (
        f"{recording / 'K.txt'}: holds one camera, but color is 64x48 and depth 32x24; "
        "give a JSON file with color, depth and T_color_depth"
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"fy": None}, "fy is missing; add it, or give --intrinsics FILE or fx,fy,cx,cy"),
        ({"fx": "wide"}, "fx is 'wide', expected a number; correct the file"),
        ({"cx": float("nan")}, "cx is nan, expected a number; correct the file"),
        (
            {"distortion": [0.1] * 8},
            "distortion has 8 coefficients, expected k1 k2 p1 p2 k3; undistort the pictures or fit that model",
        ),
        ({"distortion": "none"}, "distortion is not a list of numbers; correct the file"),
        ({"color": 5}, "color is not an object with fx, fy, cx, cy; correct the file"),
        (
            {"intrinsic_matrix": [1.0, 2.0]},
            "intrinsic_matrix: 2 numbers, expected the 9 of a 3x3 matrix; correct the file",
        ),
        ({"depth_scale": "mm"}, "depth_scale is 'mm', expected a number; correct the file"),
    ],
)
def test_bad_intrinsics_file(recording: Path, changes: dict[str, object], expected: str) -> None:
    edit_intrinsics(recording, **changes)
    assert message(recording) == f"{recording / 'intrinsics.json'}: {expected}"


def test_impossible_focal_length(recording: Path) -> None:
    edit_intrinsics(recording, fx=-5.0)
    told = message(recording)
    assert told.startswith(f"{recording / 'intrinsics.json'}: intrinsics fx=-5.0 fy=61.0 cx=31.0 cy=24.5 must be")
    assert told.endswith("; give --intrinsics FILE or fx,fy,cx,cy")


def test_two_cameras_need_all_entries(recording: Path) -> None:
    camera = {key: INTRINSICS[key] for key in ("width", "height", "fx", "fy", "cx", "cy")}
    path = recording / "intrinsics.json"
    path.write_text(json.dumps({"color": camera, "depth": {"width": 64}}))
    assert message(recording) == (f"{path}: depth.height is missing; add it, or give --intrinsics FILE or fx,fy,cx,cy")
    path.write_text(json.dumps({"color": camera, "depth": camera, "T_color_depth": [[1, 0], [0, 1]]}))
    assert message(recording) == f"{path}: T_color_depth is not a 4x4 matrix of numbers; correct the file"
    path.write_text(json.dumps({"color": camera, "depth": camera, "T_color_depth": np.diag([2, 1, 1, 1]).tolist()}))
    assert message(recording) == (
        f"{path}: T_color_depth: pose is not a rotation and a translation; "
        "correct it, or remove the poses and let the camera be tracked"
    )


def test_broken_json(recording: Path) -> None:
    path = recording / "intrinsics.json"
    path.write_text('{\n"width": 64,\n}')
    assert message(recording).startswith(f"{path}:3: is not valid JSON (")
    path.write_text("[1]")
    assert message(recording) == f"{path}: holds a JSON list, expected an object with named values"
    path.write_bytes(b"\xff\xfe\x00")
    assert message(recording) == f"{path}: is not a text file; check that the file is what its name says"


def test_matrix_file_is_no_matrix(recording: Path) -> None:
    (recording / "K.txt").write_text("1 2 3\n")
    assert message(recording, intrinsics="K.txt") == (
        f"{recording / 'K.txt'}: is neither JSON nor a 3x3 matrix; give --intrinsics FILE or fx,fy,cx,cy"
    )


def test_depth_all_zero(recording: Path) -> None:
    for k in range(FRAMES):
        write_picture(recording / "depth" / f"{k:06d}.png", np.zeros((48, 64), np.uint16))
    assert message(recording) == (
        f"{recording / 'depth' / '000000.png'}: depth is zero everywhere, and in 3 more pictures looked at; "
        "give the folder of the real depth pictures"
    )


def test_first_depth_zero_is_accepted(recording: Path) -> None:
    write_picture(recording / "depth" / "000000.png", np.zeros((48, 64), np.uint16))
    assert not open_sequence(recording)[0].depth.any()


@pytest.mark.parametrize(("scale", "text"), [(1.0, "1500..3000 m (median 2250 m)"), (1e6, "0.0015..0.003 m")])
def test_implausible_depth_scale(recording: Path, scale: float, text: str) -> None:
    for k in range(FRAMES):
        write_picture(recording / "depth" / f"{k:06d}.png", np.tile(np.array([1500, 3000], np.uint16), (48, 32)))
    told = message(recording, depth_scale=scale)
    assert told.startswith(f"{recording / 'depth' / '000000.png'}: depth of {text}")
    assert told.endswith(f"is implausible at {scale:g} units per meter; give --depth-scale (1000 for millimeters)")


def test_max_depth_that_leaves_nothing(recording: Path) -> None:
    for k in range(FRAMES):
        write_picture(recording / "depth" / f"{k:06d}.png", np.tile(np.array([1500, 3000], np.uint16), (48, 32)))
    assert message(recording, max_depth_m=0.5) == (
        f"--max-depth 0.5 m leaves no depth: {recording / 'depth' / '000000.png'} has 1.5..3 m; give a larger value"
    )
    assert set(np.unique(open_sequence(recording, max_depth_m=2.0)[0].depth)) == {0.0, 1.5}


@pytest.mark.parametrize("option", ["depth_scale", "fps", "max_depth_m"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_numbers(recording: Path, option: str, value: float) -> None:
    name = {"depth_scale": "--depth-scale", "fps": "--fps", "max_depth_m": "--max-depth"}[option]
    assert message(recording, **{option: value}) == (
        f"{name} {value:g}: must be a positive number; correct it or leave it out"
    )


def test_bad_scale_in_the_file(recording: Path) -> None:
    edit_intrinsics(recording, depth_scale=-1000)
    assert message(recording) == (
        f"{recording / 'intrinsics.json'}: depth_scale is -1000, expected a positive number; correct the file"
    )


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("2 nan 0 0 0 0 0 1", "'nan' is not a finite number; correct the line or remove the file"),
        ("2 inf 0 0 0 0 0 1", "'inf' is not a finite number; correct the line or remove the file"),
        ("2 x 0 0 0 0 0 1", "'x' is not a number; correct the line"),
        ("two 0 0 0 0 0 0 1", "'two' is not an integer; correct column 1"),
        ("2 0 0 0 0 0 1", "7 fields, expected 8 (key tx ty tz qx qy qz qw); correct the line"),
        (
            "2 0 0 0 0 0 0 0.5",
            "pose has a quaternion of length 0.5 instead of 1; correct it, or remove the poses and let the camera "
            "be tracked",
        ),
        ("1 0 0 0 0 0 0 1", "frame 1 was given on line 2; keep one line"),
        (
            "9 0 0 0 0 0 0 1",
            "pose of frame 9, which has no pictures (4 poses for 4 frames); remove the line or add the pictures",
        ),
    ],
)
def test_bad_pose_line(recording: Path, line: str, expected: str) -> None:
    path = recording / "poses.txt"
    write_lines(path, [*POSE_LINES[:2], line, POSE_LINES[3]])
    assert message(recording) == f"{path}:3: {expected}"


def test_poses_of_some_frames_are_kept(recording: Path) -> None:
    write_lines(recording / "poses.txt", POSE_LINES[:3])
    assert [frame.T_world_camera is not None for frame in open_sequence(recording)] == [True, True, True, False]


def test_poses_of_other_frames(recording: Path) -> None:
    path = recording / "poses.txt"
    write_lines(path, [f"{k + 100} 0 0 0 0 0 0 1" for k in range(FRAMES)])
    assert message(recording) == (
        f"{path}: no pose for frame 0 or any other (4 for 4 frames); number the lines as the pictures are, or remove "
        "the file"
    )


def test_pose_count_mismatch(recording: Path) -> None:
    path = recording / "poses.txt"
    write_lines(path, [*POSE_LINES, "4 0 0 0 0 0 0 1"])
    assert message(recording) == (
        f"{path}:5: pose of frame 4, which has no pictures (5 poses for 4 frames); remove the line or add the pictures"
    )


def test_unknown_pose_is_a_frame_number_alone(recording: Path) -> None:
    write_lines(recording / "poses.txt", [*POSE_LINES[:3], "3"])
    sequence = open_sequence(recording)
    assert sequence[3].T_world_camera is None
    assert sequence[2].T_world_camera is not None
    assert not sequence.info.has_camera_poses


EYE = np.eye(4).tolist()
SKEW = np.diag([1.0, 1.0, -1.0, 1.0]).tolist()
HOLE = np.full((4, 4), np.nan).tolist()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"1": [EYE] * 3}, "object 1 has 3 poses for 4 frames; write null where not known"),
        ({"1": 7}, "object 1 has no list of poses for 4 frames; write null where not known"),
        ({"cup": [EYE] * 4}, "'cup' is not a label in 0..255; use the labels of the masks"),
        ({"1": [EYE, EYE, [1, 2], EYE]}, "object 1 has an entry that is not a 4x4 matrix; correct the file"),
        (
            {"2": [EYE, EYE, SKEW, EYE]},
            "object 2, frame 2: pose is not a rotation and a translation; "
            "correct it, or remove the poses and let the camera be tracked",
        ),
        (
            {"2": [EYE, None, None, HOLE]},
            "object 2, frame 3: pose holds NaN or infinity; "
            "correct it, or remove the poses and let the camera be tracked",
        ),
    ],
)
def test_bad_object_poses(recording: Path, content: dict[str, object], expected: str) -> None:
    path = recording / "object_poses.json"
    path.write_text(json.dumps(content))
    assert message(recording) == f"{path}: {expected}"


def test_object_poses_may_be_null(recording: Path) -> None:
    (recording / "object_poses.json").write_text(json.dumps({"1": [EYE, None, EYE, EYE], "7": [None] * 4}))
    sequence = open_sequence(recording)
    assert sequence.info.has_object_poses
    assert [sorted(frame.T_camera_object) for frame in sequence] == [[1], [], [1], [1]]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("2 0.5", "'0.5' is not a time in integer nanoseconds; write whole nanoseconds"),
        ("2", "expected frame, timestamp_ns and at most color_timestamp_ns; correct it"),
        ("2 99999999999999999999", "'99999999999999999999' does not fit 64-bit nanoseconds; write whole nanoseconds"),
        ("2 5", "time 5 ns runs backwards; correct the line"),
    ],
)
def test_bad_timestamps(recording: Path, line: str, expected: str) -> None:
    path = recording / "timestamps.txt"
    write_lines(path, ["0 10", "1 20", line, "3 40"])
    assert message(recording) == f"{path}:3: {expected}"


def test_timestamps_are_exact(recording: Path) -> None:
    start, step = 1_700_000_000_123_456_789, 33_333_333
    write_lines(recording / "timestamps.txt", [f"{k} {start + k * step} {start + 5 - k}" for k in range(FRAMES)])
    sequence = open_sequence(recording)
    assert [frame.timestamp_ns - start for frame in sequence] == [0, step, 2 * step, 3 * step]
    assert [frame.color_timestamp_ns for frame in sequence] == [start + 5, start + 4, start + 3, start + 2]


@pytest.mark.parametrize(
    ("frames", "asked", "what"),
    [
        ((2, 2, None), "2:2:", "selects none of its 4 frames; widen it"),
        ((3, 1, 1), "3:1:1", "selects none of its 4 frames; widen it"),
        ((None, 5, None), ":5:", "reaches beyond its 4 frames; shorten it"),
        ((7, None, None), "7::", "reaches beyond its 4 frames; shorten it"),
        ((-5, None, None), "-5::", "reaches beyond its 4 frames; shorten it"),
    ],
)
def test_bad_frame_range(recording: Path, frames: tuple[int | None, ...], asked: str, what: str) -> None:
    assert message(recording, frames=frames) == f"{recording}: --frames {asked} {what}"


def test_frame_step_must_be_positive(recording: Path) -> None:
    assert message(recording, frames=(None, None, -1)) == (
        "--frames ::-1: the step must be 1 or more; correct the range"
    )


def test_frame_range(recording: Path) -> None:
    whole = open_sequence(recording)
    part = open_sequence(recording, frames=(1, None, 2))
    assert [frame.index for frame in part] == [0, 1]
    assert [frame.timestamp_ns for frame in part] == [whole[1].timestamp_ns, whole[3].timestamp_ns]
    assert np.array_equal(part[1].color, whole[3].color)
    assert (part.info.fps, part.info.frame_count) == (15, 2)
    assert [frame.index for frame in open_sequence(recording, frames=(-1, None, None))] == [0]


def test_damage_outside_the_frame_range_is_ignored(recording: Path) -> None:
    (recording / "color" / "000003.png").write_bytes(b"")
    assert len(open_sequence(recording, frames=(0, 3, None))) == 3


def test_seven_scenes_with_a_pose_missing(tmp_path: Path) -> None:
    for k in range(3):
        write_picture(tmp_path / f"frame-{k:06d}.color.png", np.zeros((480, 640), np.uint8))
        write_picture(tmp_path / f"frame-{k:06d}.depth.png", np.full((480, 640), 900, np.uint16))
    write_lines(tmp_path / "frame-000000.pose.txt", ["1 0 0 0", "0 1 0 0", "0 0 1 0", "0 0 0 1"])
    write_lines(tmp_path / "frame-000001.pose.txt", ["-inf -inf -inf -inf"] * 4)
    assert [frame.T_world_camera is not None for frame in open_sequence(tmp_path)] == [True, False, False]
    write_lines(tmp_path / "frame-000002.pose.txt", ["1 0 0 0", "0 1 0 0", "0 0 1 x", "0 0 0 1"])
    assert message(tmp_path) == f"{tmp_path / 'frame-000002.pose.txt'}:3: 'x' is not a number; correct the line"
    (tmp_path / "frame-000001.depth.png").unlink()
    assert message(tmp_path) == f"{tmp_path / 'frame-000001.depth.png'}: missing; add it or remove frame 1"


def test_seven_scenes_in_the_wrong_folder(tmp_path: Path) -> None:
    assert message(tmp_path, layout="7scenes") == (
        f"{tmp_path}: holds no frame-NNNNNN.color.png; give the folder of one sequence (seq-01)"
    )


def test_redwood_trajectories(recording: Path) -> None:
    (recording / "intrinsics.json").unlink()
    lines = ["0 0 1", "1 0 0 0", "0 1 0 0", "0 0 1 0", "0 0 0 1"]
    write_lines(recording / "a.log", lines)
    assert message(recording, intrinsics="60,61,31,24.5") == (
        f"{recording / 'a.log'}: 1 poses for 4 frames; remove it to track the camera instead"
    )
    write_lines(recording / "b.log", lines)
    assert message(recording, intrinsics="60,61,31,24.5") == (
        f"{recording}: several trajectories (a.log, b.log); name the right one trajectory.log"
    )
    write_lines(recording / "trajectory.log", lines[:3])
    assert message(recording, intrinsics="60,61,31,24.5") == (
        f"{recording / 'trajectory.log'}:2: expected a 4x4 matrix; correct the file or remove it"
    )


def test_redwood_names_too_far_apart(tmp_path: Path) -> None:
    write_picture(tmp_path / "rgb" / "0000001-000000000000.png", np.zeros((48, 64), np.uint8))
    write_picture(tmp_path / "depth" / "0000001-000000900000.png", np.full((48, 64), 900, np.uint16))
    assert message(tmp_path) == (
        f"{tmp_path / 'rgb'}: no picture within 20 ms of one in {tmp_path / 'depth'}; check the file names"
    )


def test_icl_nuim_with_two_trajectories(recording: Path) -> None:
    (recording / "color").rename(recording / "rgb")
    for name in ("a.gt.freiburg", "b.gt.freiburg"):
        write_lines(recording / name, POSE_LINES)
    assert message(recording, intrinsics="60,61,31,24.5") == (
        f"{recording}: several trajectories (a.gt.freiburg, b.gt.freiburg); keep the right one"
    )


@pytest.mark.parametrize(
    ("rgb", "expected"),
    [
        ("1305x rgb/a.png", "{path}:1: '1305x' is not a time in seconds within 292 years; correct the line"),
        ("1305", "{path}:1: expected a stamp and a path; correct the line"),
        ("10 rgb/a b.png", "{folder}/rgb/a b.png: no such picture; add it or remove the frame from the recording"),
        ("10,'rgb\\c.png'", "{folder}/rgb/c.png: no such picture; add it or remove the frame from the recording"),
        ("1e400 rgb/a.png", "{path}:1: '1e400' is not a time in seconds within 292 years; correct the line"),
        (
            "99 rgb/a.png",
            "{folder}: no color picture within 20 ms of a depth picture; check rgb.txt and depth.txt",
        ),
        ("10 rgb/a.png", "{folder}/rgb/a.png: no such picture; add it or remove the frame from the recording"),
    ],
)
def test_bad_tum_lists(tmp_path: Path, rgb: str, expected: str) -> None:
    write_lines(tmp_path / "rgb.txt", [rgb])
    write_lines(tmp_path / "depth.txt", ["10.001 depth/a.png"])
    assert message(tmp_path) == expected.format(path=tmp_path / "rgb.txt", folder=tmp_path)


def test_bad_tum_associations(tmp_path: Path) -> None:
    path = tmp_path / "associations.txt"
    write_lines(path, ["10 rgb/a.png 10 rgb/b.png"])
    assert message(tmp_path) == f"{path}:1: expected stamp, color path, stamp, depth path; correct the line"


def test_unreadable_text_file(recording: Path) -> None:
    path = recording / "poses.txt"
    path.mkdir()
    assert message(recording) == f"{path}: is no regular file; put the file itself there"
    path.rmdir()
    os.mkfifo(path)
    assert message(recording) == f"{path}: is no regular file; put the file itself there"
    path.unlink()
    path.write_bytes(b"\xff\x00")
    assert message(recording) == f"{path}: is not a text file; check that the file is what its name says"


def test_doubts_about_numbers_end_where_times_are_given(recording: Path) -> None:
    for kind in ("color", "depth"):
        for k in reversed(range(FRAMES)):
            (recording / kind / f"{k:06d}.png").rename(recording / kind / f"{k * 100:06d}.png")
    assert "step by 100 (000000.png, 000100.png)" in open_sequence(recording).notices[0].text
    write_lines(recording / "timestamps.txt", [f"{k * 100} {k * 100_000_000}" for k in range(FRAMES)])
    assert not any("step by 100" in notice.text for notice in open_sequence(recording).notices)
