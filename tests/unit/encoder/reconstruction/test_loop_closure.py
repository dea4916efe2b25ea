# SPDX-License-Identifier: MIT
"""Drift taken out of a camera's path that comes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from threedvc.config import EncoderConfig, Motion
from threedvc.encoder.reconstruction.loop_closure import MAX_KEYFRAMES, close_loops, corrected, key_numbers
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import Pose, identity, inverse, make_pose, rotation_from_vector
from threedvc.stream.pose_status import PoseStatus
from threedvc.synthesis import SyntheticSequence, make_scene

ROOM = SyntheticSequence(make_scene("room", frames=40, size=(128, 96)), threads=1)
DRIFT = make_pose(rotation_from_vector(np.array([0, 0.0012, 0.0004])), np.array([0.0015, 0, 0.001]))


def there_and_back() -> list[Frame]:
    there = [ROOM[number] for number in range(24)]
    return [replace(frame, index=k) for k, frame in enumerate([*there, *there[-2::-1]])]


def drifted(true: list[Pose]) -> list[Pose]:
    poses = [true[0]]
    for k in range(1, len(true)):
        poses.append(poses[-1] @ inverse(true[k - 1]) @ true[k] @ DRIFT)
    return poses


def scene_at(frames: list[Frame], poses: list[Pose]) -> Scene:
    script = [TrackedPose(T_camera_object=inverse(pose), status=PoseStatus.TRACKED) for pose in poses]
    info = replace(ROOM.info, has_camera_poses=False)
    scene = Scene(info, EncoderConfig(motion=Motion.TRACK), {0: script})
    for frame in frames:
        scene.add(frame)
    return scene


def errors(found: list[TrackedPose | None], true: list[Pose]) -> np.ndarray:
    return np.array([np.linalg.norm((at.T_camera_object @ T)[:3, 3]) for at, T in zip(found, true, strict=True) if at])


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return there_and_back()


def true_poses(frames: list[Frame]) -> list[Pose]:
    return [frame.T_world_camera for frame in frames if frame.T_world_camera is not None]


def test_a_path_that_returns_meets_its_start(frames: list[Frame]) -> None:
    true = true_poses(frames)
    scene = scene_at(frames, drifted(true))
    before = errors(scene.objects[0].found, true)
    closed = close_loops(scene, frames)
    assert closed is not None
    after = errors(closed, true)
    assert before[-1] > 0.08
    assert after[-1] < 0.1 * before[-1]
    assert after.max() < 0.4 * before.max()


def test_exact_poses_stay(frames: list[Frame]) -> None:
    true = true_poses(frames)
    closed = close_loops(scene_at(frames, true), frames)
    assert closed is None or errors(closed, true).max() < 1e-4


def test_a_short_path_has_no_loop(frames: list[Frame]) -> None:
    assert close_loops(scene_at(frames[:4], true_poses(frames)[:4]), frames[:4]) is None


def test_frames_between_are_corrected_by_shares() -> None:
    found: list[TrackedPose | None] = [
        TrackedPose(T_camera_object=identity(), status=PoseStatus.TRACKED) for _ in range(7)
    ]
    found[2], found[3] = None, TrackedPose(T_camera_object=identity(), status=PoseStatus.WEAK, submap=2)
    shift = make_pose(np.eye(3), np.array([0.0, 0.4, 0.0]))
    result = corrected(found, {1: identity(), 5: shift})
    assert result[2] is None
    assert result[3] is not None
    assert (result[3].status, result[3].submap) == (PoseStatus.WEAK, 2)
    heights = [None if at is None else inverse(at.T_camera_object)[1, 3] for at in result]
    assert heights == [0.0, 0.0, None, pytest.approx(0.2), pytest.approx(0.3), pytest.approx(0.4), pytest.approx(0.4)]


def test_keyframes_are_spread_over_the_path_and_few() -> None:
    still: list[Pose | None] = [identity()] * 50
    assert key_numbers(still, 1.0) == [0]
    far: list[Pose | None] = [make_pose(np.eye(3), np.array([k * 1.0, 0, 0])) for k in range(3 * MAX_KEYFRAMES)]
    far[0] = None
    chosen = key_numbers(far, 1.0)
    assert chosen[0] == 1
    assert MAX_KEYFRAMES / 4 < len(chosen) <= MAX_KEYFRAMES
