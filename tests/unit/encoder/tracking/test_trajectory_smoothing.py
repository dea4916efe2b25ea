# SPDX-License-Identifier: MIT
"""Poses of the depth without its noise from frame to frame."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.encoder.tracking.trajectory_smoothing import DAMPING, damp_acceleration, smooth_to_depth, smoothed
from threedvc.geometry.pose import Pose, compose, identity, inverse, make_pose, rotation_angle, rotation_from_vector
from threedvc.stream.pose_status import PoseStatus


def located(poses: list[Pose], status: PoseStatus = PoseStatus.TRACKED) -> list[TrackedPose | None]:
    return [TrackedPose(T_camera_object=pose, status=status) for pose in poses]


def poses_of(found: list[TrackedPose | None]) -> list[Pose]:
    return [at.T_camera_object for at in found if at is not None]


def turning(count: int) -> list[Pose]:
    """Return a camera that turns and goes steadily."""
    step = make_pose(rotation_from_vector(np.array([0, 0.04, 0])), np.array([0.01, 0, 0]))
    return [np.linalg.matrix_power(step, k) for k in range(count)]


def moved(poses: list[Pose], motions: list[Pose]) -> list[Pose]:
    return [compose(motion, pose) for motion, pose in zip(motions, poses, strict=True)]


def jitter(poses: list[Pose], true: list[Pose]) -> float:
    """Return the largest error of the turn from one frame to the next."""
    steps = [[compose(b, inverse(a)) for a, b in pairwise(each)] for each in (poses, true)]
    return max(rotation_angle(compose(a, inverse(b))) for a, b in zip(*steps, strict=True))


def test_smoothed_is_the_least_squares_solution(rng: np.random.Generator) -> None:
    values, weights, stiffness = rng.normal(size=(9, 2)), rng.uniform(0, 2, 9), rng.uniform(0, 5, 8)
    changes = np.diff(np.eye(9), axis=0)
    matrix = np.diag(weights) + changes.T @ np.diag(stiffness) @ changes
    assert smoothed(values, weights, stiffness) == pytest.approx(np.linalg.solve(matrix, weights[:, None] * values))


def test_smoothed_takes_any_number_of_values() -> None:
    assert smoothed(np.zeros((0, 3)), np.zeros(0), np.zeros(0)).shape == (0, 3)
    assert smoothed(np.ones((1, 3)), np.ones(1), np.zeros(0)) == pytest.approx(np.ones((1, 3)))


def test_noise_goes_and_a_lasting_difference_stays(rng: np.random.Generator) -> None:
    synchronized = turning(40)
    lasting = make_pose(rotation_from_vector(np.array([0.01, -0.02, 0])), np.array([0.02, 0, 0.01]))
    noise = [make_pose(rotation_from_vector(rng.normal(scale=0.005, size=3)), np.zeros(3)) for _ in synchronized]
    wanted = moved(synchronized, [lasting] * 40)
    noisy = moved(wanted, noise)
    result = poses_of(smooth_to_depth(located(noisy), located(synchronized), [False] * 40))
    assert jitter(result, wanted) < 0.2 * jitter(noisy, wanted)
    errors = [rotation_angle(compose(a, inverse(b))) for a, b in zip(result, wanted, strict=True)]
    assert max(errors) < 0.006


def test_a_camera_at_rest_rests() -> None:
    synchronized = turning(5) + [turning(5)[-1]] * 10 + turning(5)[::-1]
    shift = make_pose(np.eye(3), np.array([0.01, 0, 0]))
    found = moved(synchronized, [identity()] * 3 + [shift] * 17)
    result = poses_of(smooth_to_depth(located(found), located(synchronized), [False] * 20))
    assert all(np.array_equal(pose, result[4]) for pose in result[4:15])


def test_given_lost_and_missing_poses_stay() -> None:
    synchronized = located(turning(6))
    found = located(moved(turning(6), [make_pose(np.eye(3), np.array([0.01 * k * k, 0, 0])) for k in range(6)]))
    found[1] = TrackedPose(T_camera_object=identity(), status=PoseStatus.LOST)
    found[2] = None
    found[3] = TrackedPose(T_camera_object=identity(), status=PoseStatus.KNOWN)
    result = smooth_to_depth(found, synchronized, [False] * 6)
    assert [result[k] for k in (1, 2, 3)] == [found[k] for k in (1, 2, 3)]
    assert not np.array_equal(poses_of(result)[4], poses_of(found)[4])


def test_parts_of_a_model_are_settled_apart() -> None:
    shift = make_pose(np.eye(3), np.array([0.05, 0, 0]))
    synchronized = located(turning(8))
    found = located(moved(turning(8), [identity()] * 4 + [shift] * 4))
    for k in range(4, 8):
        at = found[k]
        assert at is not None
        found[k] = TrackedPose(T_camera_object=at.T_camera_object, status=at.status, submap=1)
    before, after = poses_of(found), poses_of(smooth_to_depth(found, synchronized, [False] * 8))
    assert all(np.allclose(a, b) for a, b in zip(before, after, strict=True))


def test_frames_without_depth_go_with_those_about_them() -> None:
    synchronized, shift = turning(7), make_pose(np.eye(3), np.array([0.02, 0, 0]))
    found = located(moved(synchronized, [shift] * 3 + [identity()] + [shift] * 3))
    result = poses_of(smooth_to_depth(found, located(synchronized), [k == 3 for k in range(7)]))
    assert all(np.allclose(a, b) for a, b in zip(result, moved(synchronized, [shift] * 7), strict=True))


def test_easing_is_the_least_squares_solution_of_shifts(rng: np.random.Generator) -> None:
    places = np.cumsum(rng.normal(size=(12, 3)), axis=0)
    bends = np.diff(np.eye(12), n=2, axis=0)
    wanted = np.linalg.solve(np.eye(12) + DAMPING * bends.T @ bends, places)
    result = damp_acceleration([make_pose(np.eye(3), -place) for place in places])
    assert [-pose[:3, 3] for pose in result] == pytest.approx(wanted, abs=1e-6)


def test_steady_motion_is_not_eased() -> None:
    for count in (0, 1, 2, 3, 20):
        poses = turning(count)
        assert all(np.allclose(a, b, atol=1e-9) for a, b in zip(damp_acceleration(poses), poses, strict=True))


def test_easing_takes_noise_out_of_turns(rng: np.random.Generator) -> None:
    true = turning(40)
    noise = [make_pose(rotation_from_vector(rng.normal(scale=0.005, size=3)), np.zeros(3)) for _ in true]
    noisy = moved(true, noise)
    assert jitter(damp_acceleration(noisy), true) < 0.85 * jitter(noisy, true)
