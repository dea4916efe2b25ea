# SPDX-License-Identifier: MIT
"""Cameras, depths and times that cannot be, or probably are not, what they are taken for."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.recorded_room import SMALL, color_picture, depth_picture, poses, write_lines, write_picture
from threedvc.errors import SequenceError
from threedvc.formats.sources import open_sequence

FRAMES = 6
INTRINSICS = {"width": 64, "height": 48, "fx": 60.0, "fy": 61.0, "cx": 31.0, "cy": 24.5, "depth_scale": 1000}
CAMERA = {key: value for key, value in INTRINSICS.items() if key != "depth_scale"}


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a sound recording in the plain layout without a frame rate."""
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(tmp_path / "color" / f"{k:06d}.png", color_picture(SMALL, pose))
        write_picture(tmp_path / "depth" / f"{k:06d}.png", depth_picture(SMALL, pose, 1000))
    (tmp_path / "intrinsics.json").write_text(json.dumps(INTRINSICS))
    return tmp_path


def with_camera(recording: Path, **changes: object) -> Path:
    (recording / "intrinsics.json").write_text(json.dumps({**INTRINSICS, **changes}))
    return recording


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"cx": 0.0, "cy": 0.0}, "principal point 0,0 is not inside pictures of 64x48"),
        ({"cx": 63.5, "cy": 47.5}, "principal point 63.5,47.5 is not inside pictures of 64x48"),
        ({"fx": 0.94, "fy": 1.27, "cx": 31.0}, "fx 0.94 sees 177 degrees in 64 pixels"),
        ({"fx": 4000.0, "fy": 4000.0}, "fx 4000 sees 0.917 degrees in 64 pixels"),
        ({"fx": 60.0, "fy": 140.0}, "fx 60 and fy 140 differ 2.3 times"),
    ],
)
def test_cameras_that_cannot_be(recording: Path, changes: dict[str, object], expected: str) -> None:
    with pytest.raises(SequenceError) as caught:
        open_sequence(with_camera(recording, **changes))
    assert str(caught.value).startswith(f"{recording / 'intrinsics.json'}: {expected}; ")


@pytest.mark.parametrize(("shift_m", "turn"), [(-32.0, 1.0), (3.2, 1.0), (0.03, -1.0)])
def test_mountings_that_cannot_be(recording: Path, shift_m: float, turn: float) -> None:
    mount = np.diag([1.0, turn, turn, 1.0])
    mount[0, 3] = shift_m
    content = {"color": CAMERA, "depth": CAMERA, "T_color_depth": mount.tolist(), "depth_scale": 1000}
    (recording / "intrinsics.json").write_text(json.dumps(content))
    with pytest.raises(SequenceError, match=r"intrinsics\.json: T_color_depth (puts|turns) the color camera "):
        open_sequence(recording)


def test_camera_of_larger_pictures_is_doubted(recording: Path) -> None:
    (notice,) = open_sequence(with_camera(recording, cx=44.8, cy=33.7)).notices
    assert notice.warning
    assert "lies at 71% of width and height; this looks like a camera of 91x68 pictures" in notice.text


@pytest.mark.parametrize(
    "matrix",
    [
        [60.0, 0.0, 0.0, 0.0, 61.0, 0.0, 31.0, 24.5, 1.0],
        [60.0, 0.0, 31.0, 0.0, 61.0, 24.5, 0.0, 0.0, 1.0],
        [[60.0, 0.0, 31.0], [0.0, 61.0, 24.5], [0.0, 0.0, 1.0]],
    ],
)
def test_matrices_by_rows_and_by_columns(recording: Path, matrix: object) -> None:
    (recording / "k.json").write_text(json.dumps({"width": 64, "height": 48, "intrinsic_matrix": matrix}))
    assert open_sequence(recording, intrinsics="k.json").info.rig.color == SMALL


def change_depth(recording: Path, value: int, share: float) -> None:
    chosen = np.random.default_rng(1).random((48, 64)) < share
    for k, pose in enumerate(poses(FRAMES)):
        depth = depth_picture(SMALL, pose, 1000)
        depth[chosen] = value
        write_picture(recording / "depth" / f"{k:06d}.png", depth)


def test_the_largest_value_is_no_measurement(recording: Path) -> None:
    change_depth(recording, 65535, 0.1)
    sequence = open_sequence(recording)
    assert sequence.notices == ()
    assert all(0 < frame.depth.max() < 10 for frame in sequence)


@pytest.mark.parametrize(("value", "share", "doubted"), [(32767, 0.1, True), (10000, 0.03, True), (32767, 0.01, False)])
def test_one_value_far_beyond_all_others(recording: Path, value: int, share: float, doubted: bool) -> None:
    change_depth(recording, value, share)
    notices = open_sequence(recording).notices
    assert bool(notices) is doubted
    assert not doubted or f"depth {value} ({value / 1000:.4g} m) is on " in notices[0].text
    assert open_sequence(recording, max_depth_m=6.0).notices == ()


def test_scattered_depth_is_refused(recording: Path) -> None:
    change_depth(recording, 0, 0.93)
    with pytest.raises(SequenceError, match="have 3 neighbors with depth: too sparse to make surfaces of"):
        open_sequence(recording)


@pytest.mark.parametrize(
    ("step", "unit", "told"),
    [(100_000_000, 1, ""), (100_000, 1000, "microseconds"), (100, 1_000_000, "milliseconds")],
)
def test_times_of_a_file(recording: Path, step: int, unit: int, told: str) -> None:
    write_lines(recording / "timestamps.txt", [f"{k} {k * step}" for k in range(FRAMES)])
    sequence = open_sequence(recording)
    assert [frame.timestamp_ns for frame in sequence] == [k * 100_000_000 for k in range(FRAMES)]
    assert sequence.info.fps == 10
    assert [notice.text for notice in sequence.notices] == (
        [f"{recording / 'timestamps.txt'}: its stamps are taken for {told}"] if told else []
    )


def test_stamps_that_count_frames(recording: Path) -> None:
    write_lines(recording / "timestamps.txt", [f"{k} {k}" for k in range(FRAMES)])
    sequence = open_sequence(recording, fps=20)
    assert [frame.timestamp_ns for frame in sequence] == [k * 50_000_000 for k in range(FRAMES)]
    assert "its stamps count frames; they are taken to be 20 per second" in sequence.notices[0].text


def test_stamps_against_a_rate_that_is_told(recording: Path) -> None:
    write_lines(recording / "timestamps.txt", [f"{k} {k * 100_000_000}" for k in range(FRAMES)])
    sequence = open_sequence(with_camera(recording, fps=30))
    assert sequence.info.fps == 10
    assert "its stamps are those of 10 frames per second, not 30; the stamps are used" in sequence.notices[0].text
    assert open_sequence(with_camera(recording, fps=10.2)).notices == ()


def test_frames_far_apart_are_doubted(recording: Path) -> None:
    write_lines(recording / "timestamps.txt", [f"{k} {k * 33_000_000_000}" for k in range(FRAMES)])
    assert any("33 s between frames" in notice.text and notice.warning for notice in open_sequence(recording).notices)
