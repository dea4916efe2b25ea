# SPDX-License-Identifier: MIT
"""Coding of poses: accuracy, prediction, stillness, damage."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.coding import quaternion_matrix
from threedvc.coding.poses import PoseCoder
from threedvc.errors import CorruptStream
from threedvc.geometry.pose import is_rigid, make_pose, rotation_angle, rotation_from_vector
from threedvc.kernels.coding.pose_coding import multiply, predict_pose, rotate

STEPS = 0.0005, 0.00025


def walk(rng: np.random.Generator, count: int, jitter: float) -> NDArray[np.float64]:
    """Return poses of a smooth motion far from the origin, with jitter in meters and radians."""
    poses = []
    for k in range(count):
        turn = np.array([0.3, 2.0, -0.4]) + np.array([0.002, -0.01, 0.003]) * k + rng.normal(0, jitter, 3)
        place = np.array([4.0, -2.0, 7.0]) + np.array([0.004, 0.001, -0.006]) * k + rng.normal(0, jitter, 3)
        poses.append(make_pose(rotation_from_vector(turn), place))
    return np.array(poses)


def coders() -> tuple[PoseCoder, PoseCoder]:
    """Return an encoder's and a decoder's coder."""
    return PoseCoder(*STEPS), PoseCoder(*STEPS)


def angle_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the angle between two poses in radians."""
    return rotation_angle(a @ np.linalg.inv(b))


def random_quaternion(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a unit quaternion."""
    q = rng.normal(size=4)
    return np.asarray(q / np.linalg.norm(q))


def test_quaternion_kernels_match_matrices(rng: np.random.Generator) -> None:
    for _ in range(20):
        a, b, v = random_quaternion(rng), random_quaternion(rng), rng.normal(size=3)
        product, turned = np.empty(4), np.empty(3)
        multiply(a, b, product)
        assert product == pytest.approx(quaternion_matrix(a) @ b)
        rotate(a, v, turned)
        matrix = quaternion_matrix(a)
        conjugate = a * np.array([1, -1, -1, -1])
        assert turned == pytest.approx((quaternion_matrix(matrix @ np.array([0, *v])) @ conjugate)[1:])


def test_prediction_continues_the_motion() -> None:
    poses = walk(np.random.default_rng(0), 3, 0.0)
    step = poses[1] @ np.linalg.inv(poses[0])
    flat = np.array([[*quaternion_of(pose), *pose[:3, 3]] for pose in poses])
    predicted = np.empty(7)
    predict_pose(flat[1], flat[0], predicted)
    expected = step @ poses[1]
    assert predicted[4:] == pytest.approx(expected[:3, 3])
    assert abs(predicted[:4] @ quaternion_of(expected)) == pytest.approx(1)


def quaternion_of(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternion w, x, y, z of a pose, from the eigenvector of its rotation's symmetric matrix."""
    r = pose[:3, :3]
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    vector = np.linalg.eigh(k)[1][:, -1]
    return np.asarray(vector * (1 if vector[0] >= 0 else -1))


@pytest.mark.parametrize("group", [1, 7, 60])
def test_decoded_poses_are_within_half_a_step(rng: np.random.Generator, group: int) -> None:
    poses = walk(rng, 60, 0.003)
    encoder, decoder = coders()
    for start in range(0, 60, group):
        part = poses[start : start + group]
        payload = encoder.encode(part)
        decoded = decoder.decode(payload, len(part))
        assert np.array_equal(decoded, encoder.decoded)
        for given, seen in zip(part, decoded, strict=True):
            assert is_rigid(seen, 1e-12)
            assert np.abs(given - seen)[:3, 3].max() <= STEPS[0] / 2 + 1e-12
            assert angle_between(given, seen) <= STEPS[1] * np.sqrt(3) / 2 + 1e-7


def test_jitter_costs_bits_and_smooth_motion_does_not(rng: np.random.Generator) -> None:
    sizes = [len(PoseCoder(*STEPS).encode(walk(rng, 300, jitter))) / 300 for jitter in (0.0, 0.001)]
    assert sizes[0] < 2.2
    assert sizes[0] < sizes[1] < 4.5


@pytest.mark.parametrize("angle", [0.0, 1.5, 3.1415926, np.pi, 4.0])
def test_first_pose_may_be_anywhere(angle: float) -> None:
    pose = make_pose(rotation_from_vector(np.array([0.6, -0.8, 0.0]) * angle), np.array([900.0, -3000.0, 0.001]))
    encoder, decoder = coders()
    decoded = decoder.decode(encoder.encode([pose]), 1)[0]
    assert np.abs(decoded - pose)[:3, 3].max() <= STEPS[0]
    assert angle_between(decoded, pose) <= STEPS[1]


def test_repeated_pose_is_exactly_the_last_one(rng: np.random.Generator) -> None:
    poses = walk(rng, 5, 0.001)
    encoder, decoder = coders()
    decoder.decode(encoder.encode(poses), 5)
    last = encoder.decoded[-1]
    assert encoder.repeats(poses[-1])
    assert encoder.repeats(last)
    payload = encoder.encode([poses[-1], last, poses[-1]])
    decoded = decoder.decode(payload, 3)
    assert all(np.array_equal(pose, last) for pose in decoded)


def test_pose_beyond_the_step_does_not_repeat(rng: np.random.Generator) -> None:
    encoder = PoseCoder(*STEPS)
    pose = walk(rng, 1, 0.0)[0]
    encoder.encode([pose])
    moved = pose.copy()
    moved[0, 3] += 2 * STEPS[0]
    assert not encoder.repeats(moved)


def test_hold_forgets_the_velocity() -> None:
    poses = walk(np.random.default_rng(0), 30, 0.0)
    nudge = make_pose(np.eye(3), np.array([0.002, 0.0, 0.0]))
    sizes = []
    for hold in (False, True):
        encoder, decoder = coders()
        decoder.decode(encoder.encode(poses), 30)
        if hold:
            encoder.reset_velocity()
            decoder.reset_velocity()
        payload = encoder.encode([nudge @ poses[-1]])
        assert np.array_equal(decoder.decode(payload, 1), encoder.decoded)
        sizes.append(len(payload))
    assert sizes[1] < sizes[0]


def test_no_poses_cost_nothing() -> None:
    encoder, decoder = coders()
    assert encoder.encode([]) == b""
    assert decoder.decode(b"", 0).shape == (0, 4, 4)


def test_wrong_count_and_damage_are_noticed(rng: np.random.Generator) -> None:
    payload = PoseCoder(*STEPS).encode(walk(rng, 30, 0.003))
    with pytest.raises(CorruptStream, match=r"ends within 300 poses|too early"):
        PoseCoder(*STEPS).decode(payload, 300)
    with pytest.raises(CorruptStream, match="goes on after its end"):
        PoseCoder(*STEPS).decode(payload, 3)
    with pytest.raises(CorruptStream, match="m away"):
        PoseCoder(1e9, 0.1).decode(payload, 30)
