# SPDX-License-Identifier: MIT
"""Poses reconciled with measured motions between them."""

from __future__ import annotations

import numpy as np
import pytest

from threedvc.encoder.reconstruction.pose_graph import Link, optimized
from threedvc.geometry.pose import Pose, compose, inverse, log_motion, make_pose, rotation_angle, rotation_from_vector

SURE = np.diag([1e6] * 3 + [1e6] * 3)


def circle(count: int) -> list[Pose]:
    """Return cameras on a circle of 1 m that look outwards, in the frame of the first."""
    poses = []
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        turn = rotation_from_vector(np.array([0, angle, 0]))
        poses.append(make_pose(turn, turn @ np.array([0, 0, 1.0])))
    return [inverse(poses[0]) @ pose for pose in poses]


def motion(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> Pose:
    return make_pose(rotation_from_vector(np.array(turn)), np.array(shift))


def link(poses: list[Pose], first: int, second: int, error: Pose | None = None) -> Link:
    T = inverse(poses[first]) @ poses[second]
    return Link(first=first, second=second, T_first_second=T if error is None else T @ error, information=SURE)


def drifting(true: list[Pose], error: Pose) -> list[Pose]:
    """Chain motions that are all off by the same error."""
    poses = [true[0]]
    for k in range(1, len(true)):
        poses.append(compose(poses[-1], inverse(true[k - 1]) @ true[k] @ error))
    return poses


def distance(a: list[Pose], b: list[Pose]) -> float:
    return max(
        float(np.linalg.norm(p[:3, 3] - q[:3, 3])) + rotation_angle(inverse(p) @ q) for p, q in zip(a, b, strict=True)
    )


def test_exact_links_bring_drifted_poses_back() -> None:
    true = circle(12)
    start = drifting(true, motion((0.0, 0.01, 0.002), (0.01, 0.0, 0.003)))
    links = [link(true, k, k + 1) for k in range(11)]
    assert distance(start, true) > 0.1
    assert distance(optimized(start, links), true) < 1e-6


def test_closing_a_loop_spreads_the_error_over_it() -> None:
    true = circle(16)
    error = motion((0.0, 0.004, 0.0), (0.003, 0.0, 0.0))
    chained = drifting(true, error)
    links = [link(true, k, k + 1, error) for k in range(15)]
    closed = optimized(chained, [*links, link(true, 0, 15)])
    assert distance(closed, true) < 0.35 * distance(chained, true)


def test_a_wrong_link_does_no_harm() -> None:
    true = circle(10)
    links = [link(true, k, (k + j) % 10) for k in range(10) for j in (1, 2) if k + j < 10]
    wrong = link(true, 2, 7, motion((0.3, 0.0, 0.0), (0.0, 0.5, 0.0)))
    assert distance(optimized(true, [*links, wrong]), true) < 1e-3


def test_directions_without_information_stay() -> None:
    true = [motion((0, 0, 0), (0, 0, 0)), motion((0, 0, 0), (0, 0, 1))]
    along_z = np.diag([1e6, 1e6, 1e6, 0, 0, 1e6])
    measured = Link(first=0, second=1, T_first_second=motion((0, 0, 0), (9, 9, 1.5)), information=along_z)
    moved = optimized(true, [measured])[1]
    np.testing.assert_allclose(moved[:3, 3], [0, 0, 1.5], atol=1e-5)


@pytest.mark.parametrize("count", [1, 3])
def test_without_links_nothing_moves(count: int) -> None:
    true = circle(count)
    assert distance(optimized(true, []), true) == 0


def test_twist_of_a_small_motion() -> None:
    twist = log_motion(motion((0.01, -0.02, 0.03), (1, 2, 3)))
    np.testing.assert_allclose(twist, [0.01, -0.02, 0.03, 1, 2, 3], atol=1e-9)
