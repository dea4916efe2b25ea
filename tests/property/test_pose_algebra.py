# SPDX-License-Identifier: MIT
"""Rigid transforms obey their algebra, whatever the motion."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from threedvc.geometry.pose import (
    Pose,
    compose,
    identity,
    inverse,
    is_rigid,
    make_pose,
    orthonormalized,
    quaternion,
    rotation_angle,
    rotation_from_quaternion,
    rotation_from_vector,
    rotation_vector,
)

meters = st.floats(-100, 100)


@st.composite
def turns(draw: st.DrawFn, largest: float = np.pi) -> NDArray[np.float64]:
    """Return rotation vectors; tiny angles and half turns are not rare."""
    axis = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 3)))
    length = np.linalg.norm(axis)
    axis = axis / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])
    angle = draw(
        st.one_of(st.floats(0, largest), st.floats(-10, 0).map(lambda power: largest * 10**power), st.just(largest))
    )
    return axis * angle


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    return make_pose(rotation_from_vector(draw(turns())), np.array(draw(st.tuples(meters, meters, meters))))


@given(poses(), poses(), poses())
def test_compose_is_the_associative_product(a: Pose, b: Pose, c: Pose) -> None:
    np.testing.assert_allclose(compose(a, b), a @ b, atol=1e-12)
    np.testing.assert_allclose(compose(compose(a, b), c), compose(a, compose(b, c)), atol=1e-11)
    np.testing.assert_array_equal(compose(identity(), a), a)
    np.testing.assert_array_equal(compose(a, identity()), a)


@given(poses())
def test_inverse_undoes(pose: Pose) -> None:
    np.testing.assert_allclose(compose(pose, inverse(pose)), identity(), atol=1e-12)
    np.testing.assert_allclose(compose(inverse(pose), pose), identity(), atol=1e-12)
    np.testing.assert_allclose(inverse(inverse(pose)), pose, atol=1e-12)


@given(turns())
def test_rotation_vectors_round_trip(vector: NDArray[np.float64]) -> None:
    rotation = rotation_from_vector(vector)
    assert is_rigid(make_pose(rotation, np.zeros(3)), tolerance=1e-9)
    again = rotation_vector(rotation)
    # Half a turn about an axis is half a turn about its opposite.
    opposite = np.linalg.norm(vector) > np.pi - 1e-6 and again @ vector < 0
    np.testing.assert_allclose(-again if opposite else again, vector, atol=1e-7)


@given(turns())
def test_small_turns_keep_their_relative_precision(vector: NDArray[np.float64]) -> None:
    np.testing.assert_allclose(
        rotation_vector(rotation_from_vector(vector * 1e-4)), vector * 1e-4, rtol=1e-9, atol=1e-18
    )


@given(turns(), st.floats(1e-3, 1e3), st.sampled_from([1.0, -1.0]))
def test_quaternions_round_trip_at_any_length_and_sign(vector: NDArray[np.float64], length: float, sign: float) -> None:
    rotation = rotation_from_vector(vector)
    xyzw = quaternion(rotation)
    assert xyzw[3] >= 0
    np.testing.assert_allclose(np.linalg.norm(xyzw), 1, atol=1e-12)
    np.testing.assert_allclose(rotation_from_quaternion(sign * length * xyzw), rotation, atol=1e-9)


@given(poses(), turns(largest=3.0))
def test_the_angle_is_that_of_the_turn_alone(pose: Pose, vector: NDArray[np.float64]) -> None:
    turned = compose(pose, make_pose(rotation_from_vector(vector), np.zeros(3)))
    np.testing.assert_allclose(rotation_angle(compose(inverse(pose), turned)), np.linalg.norm(vector), atol=1e-6)


@given(poses(), st.integers(0, 2**32 - 1))
def test_orthonormalized_repairs_rounding(pose: Pose, seed: int) -> None:
    rough = pose.copy()
    rough[:3, :3] += np.random.default_rng(seed).uniform(-1e-3, 1e-3, (3, 3))
    mended = orthonormalized(rough)
    assert is_rigid(mended, tolerance=1e-9)
    assert rotation_angle(compose(inverse(pose), mended)) < 4e-3
    np.testing.assert_array_equal(mended[:3, 3], pose[:3, 3])
    np.testing.assert_allclose(orthonormalized(pose), pose, atol=1e-9)
