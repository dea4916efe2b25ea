# SPDX-License-Identifier: MIT
"""Transforms of which the numbers are known by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.geometry.pose import (
    adjoint,
    compose,
    exp_motion,
    identity,
    inverse,
    is_rigid,
    log_motion,
    make_pose,
    nearest_rotation,
    quaternion,
    rigid_fit,
    rotation_angle,
    rotation_from_quaternion,
    rotation_from_vector,
    rotation_vector,
)

QUARTER_Z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
ROOT = np.sqrt(0.5)


def test_names_read_as_products() -> None:
    T_world_camera = make_pose(QUARTER_Z, np.array([1.0, 2.0, 3.0]))
    T_camera_object = make_pose(np.eye(3), np.array([0.5, 0.0, 0.0]))
    T_world_object = compose(T_world_camera, T_camera_object)
    np.testing.assert_array_equal(T_world_object @ [0, 0, 0, 1], [1.0, 2.5, 3.0, 1.0])
    np.testing.assert_array_equal(inverse(T_world_camera) @ [1, 2, 3, 1], [0, 0, 0, 1])


@pytest.mark.parametrize(
    ("vector", "xyzw"),
    [
        ((0, 0, 0), (0, 0, 0, 1)),
        ((0, 0, np.pi / 2), (0, 0, ROOT, ROOT)),
        ((-np.pi / 2, 0, 0), (-ROOT, 0, 0, ROOT)),
        ((np.pi, 0, 0), (1, 0, 0, 0)),
        ((0, np.pi, 0), (0, 1, 0, 0)),
        ((0, 0, np.pi), (0, 0, 1, 0)),
    ],
)
def test_known_turns(vector: tuple[float, ...], xyzw: tuple[float, ...]) -> None:
    rotation = rotation_from_vector(np.array(vector, dtype=np.float64))
    np.testing.assert_allclose(rotation_from_quaternion(np.array(xyzw, dtype=np.float64)), rotation, atol=1e-12)
    np.testing.assert_allclose(np.abs(quaternion(rotation)), np.abs(xyzw), atol=1e-12)
    np.testing.assert_allclose(np.abs(rotation_vector(rotation)), np.abs(vector), atol=1e-12)
    np.testing.assert_allclose(rotation_angle(make_pose(rotation, np.ones(3))), np.linalg.norm(vector), atol=1e-12)


def test_a_quarter_turn_is_counter_clockwise() -> None:
    np.testing.assert_allclose(rotation_from_vector(np.array([0, 0, np.pi / 2])), QUARTER_Z, atol=1e-15)


@pytest.mark.parametrize("pose", [identity(), make_pose(QUARTER_Z, np.array([1e6, 0, 0])), np.eye(4) + 1e-4])
def test_rigid(pose: NDArray[np.float64]) -> None:
    assert is_rigid(pose)


@pytest.mark.parametrize(
    "pose",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.diag([2.0, 2.0, 2.0, 1.0]),
        np.diag([1.0, 1.0, 1.0, 2.0]),
        np.zeros((4, 4)),
        np.eye(3),
        np.full((4, 4), np.nan),
        make_pose(np.eye(3), np.array([0, np.inf, 0])),
        np.eye(4) + 0.01,
    ],
    ids=["mirrored", "scaled", "last row", "zero", "3x3", "nan", "infinite", "skewed"],
)
def test_not_rigid(pose: NDArray[np.float64]) -> None:
    assert not is_rigid(pose)


def test_twist_of_a_motion() -> None:
    twist = np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0])
    motion = exp_motion(twist)
    np.testing.assert_array_equal(motion[:3, 3], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(log_motion(motion), twist, atol=1e-12)


def test_adjoint_takes_a_small_motion_to_another_frame() -> None:
    T_a_b, twist = make_pose(QUARTER_Z, np.array([1.0, 2.0, 3.0])), 1e-6 * np.array([1.0, -2.0, 3.0, 0.5, 1.0, -1.0])
    in_b, in_a = compose(T_a_b, exp_motion(twist)), compose(exp_motion(adjoint(T_a_b) @ twist), T_a_b)
    np.testing.assert_allclose(in_a, in_b, atol=1e-10)


def test_nearest_rotation_is_no_mirror() -> None:
    np.testing.assert_allclose(nearest_rotation(3.0 * QUARTER_Z), QUARTER_Z, atol=1e-12)
    assert np.linalg.det(nearest_rotation(np.diag([3.0, 2.0, -1.0]))) == pytest.approx(1)


def test_a_fit_finds_the_transform_and_never_mirrors() -> None:
    rng = np.random.default_rng(0)
    wanted = make_pose(QUARTER_Z, np.array([1.0, -2.0, 0.5]))
    points = rng.normal(0, 1, (10, 3)) * [1, 1, 1e-4]
    np.testing.assert_allclose(rigid_fit(points, points @ wanted[:3, :3].T + wanted[:3, 3]), wanted, atol=1e-6)
    assert np.linalg.det(rigid_fit(points, points * [1, 1, -1])[:3, :3]) == pytest.approx(1)
