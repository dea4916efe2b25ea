# SPDX-License-Identifier: MIT
"""Rigid transforms as (4, 4) float64 arrays.

Names read as products: ``p_camera = T_camera_object @ p_object``. Quaternions are ``(x, y, z, w)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles

__all__ = [
    "Pose",
    "adjoint",
    "compose",
    "exp_motion",
    "identity",
    "interpolated",
    "inverse",
    "is_rigid",
    "log_motion",
    "make_pose",
    "nearest_rotation",
    "orthonormalized",
    "quaternion",
    "rigid_fit",
    "rotation_angle",
    "rotation_from_quaternion",
    "rotation_from_vector",
    "rotation_vector",
]

Pose = NDArray[np.float64]


def identity() -> Pose:
    """Return the transform that moves nothing."""
    return np.eye(4)


def make_pose(rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> Pose:
    """Build a transform from a (3, 3) rotation and a (3,) translation in meters."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = translation
    return pose


def compose(first: Pose, second: Pose) -> Pose:
    """Multiply transforms, ``T_a_c = compose(T_a_b, T_b_c)``, to the same bits on every machine.

    A matrix product of a linear algebra library may contract multiplications and additions; this one
    does not.
    """
    a, b = first, second
    product: Pose = a[:, 0:1] * b[0] + a[:, 1:2] * b[1] + a[:, 2:3] * b[2] + a[:, 3:4] * b[3]
    return product


def inverse(pose: Pose) -> Pose:
    """Invert a rigid transform: ``inverse(T_a_b)`` is ``T_b_a``; to the same bits on every machine."""
    rotation, t = pose[:3, :3].T, pose[:3, 3]
    return make_pose(rotation, -(rotation[:, 0] * t[0] + rotation[:, 1] * t[1] + rotation[:, 2] * t[2]))


def is_rigid(pose: Pose, tolerance: float = 1e-3) -> bool:
    """Tell whether a (4, 4) array is finite, orthonormal and right-handed within `tolerance`."""
    if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
        return False
    rotation = pose[:3, :3]
    orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), atol=tolerance)
    return bool(orthonormal and np.linalg.det(rotation) > 0 and np.allclose(pose[3], [0, 0, 0, 1], atol=tolerance))


def nearest_rotation(matrix: Doubles) -> Doubles:
    """Return the rotation with the largest inner product with a (3, 3) matrix (Umeyama 1991)."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def rigid_fit(points: Doubles, targets: Doubles) -> Pose:
    """Return the rigid transform that brings points (n, 3) nearest to their targets (n, 3).

    Least squares without scale (Horn 1987, Umeyama 1991). Points on a line or in one place leave
    the rotation free; one that fits is returned.
    """
    a, b = points.mean(axis=0), targets.mean(axis=0)
    rotation = nearest_rotation((targets - b).T @ (points - a))
    return make_pose(rotation, b - rotation @ a)


def orthonormalized(pose: Pose) -> Pose:
    """Return the rigid transform nearest to a nearly rigid one."""
    return make_pose(nearest_rotation(pose[:3, :3]), pose[:3, 3])


def rotation_from_quaternion(xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn a quaternion (4,) of any non-zero length into a (3, 3) rotation."""
    x, y, z, w = np.asarray(xyzw, dtype=np.float64) / np.linalg.norm(xyzw)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn a (3, 3) rotation into a unit quaternion (4,) with w >= 0."""
    m = rotation
    squares = np.array(
        [
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
            1 + m[0, 0] + m[1, 1] + m[2, 2],
        ]
    )
    largest = int(np.argmax(squares))
    products = [
        [squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
        [m[0, 1] + m[1, 0], squares[1], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
        [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[2], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]],
    ]
    xyzw: NDArray[np.float64] = np.array(products[largest]) / np.linalg.norm(products[largest])
    return xyzw if xyzw[3] >= 0 else -xyzw


def rotation_from_vector(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn a rotation vector (3,), axis times angle in radians, into a (3, 3) rotation (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    k = np.array([[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]])
    sine, versine = (1.0, 0.5) if angle < 1e-8 else (np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2)
    rotation: NDArray[np.float64] = np.eye(3) + sine * k + versine * k @ k
    return rotation


def rotation_vector(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn a (3, 3) rotation into its rotation vector (3,) in radians; inverse of `rotation_from_vector`."""
    xyzw = quaternion(rotation)
    sine = float(np.linalg.norm(xyzw[:3]))
    scale = 2.0 if sine < 1e-12 else 2 * float(np.arctan2(sine, xyzw[3])) / sine
    return xyzw[:3] * scale


def rotation_angle(pose: Pose) -> float:
    """Return the angle by which a transform turns, in radians."""
    return float(np.linalg.norm(rotation_vector(pose[:3, :3])))


def interpolated(first: Pose, second: Pose, share: float) -> Pose:
    """Return the pose at a share 0..1 of the way from one pose to another, turning evenly about one axis."""
    turn = rotation_vector(second[:3, :3] @ first[:3, :3].T)
    return make_pose(
        rotation_from_vector(share * turn) @ first[:3, :3], first[:3, 3] + share * (second[:3, 3] - first[:3, 3])
    )


def exp_motion(twist: Doubles) -> Pose:
    """Return the motion of a twist (6,): the rotation vector in radians, then the shift in meters.

    Turn and shift are taken apart, as the exponential on SO(3) x R^3: for the small motions of an optimizer that is
    SE(3)'s to first order.
    """
    return make_pose(rotation_from_vector(twist[:3]), twist[3:])


def log_motion(motion: Pose) -> Doubles:
    """Return the twist (6,) of a motion, turn and shift; inverse of `exp_motion`."""
    return np.concatenate([rotation_vector(motion[:3, :3]), motion[:3, 3]])


def adjoint(T: Pose) -> Doubles:
    """Return the (6, 6) matrix that turns a small motion (turn, shift) in one frame into the same one in another.

    To first order, ``exp_motion(adjoint(T_a_b) @ twist)`` moves in a as ``exp_motion(twist)`` does in b.
    """
    x, y, z = T[:3, 3]
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = T[:3, :3]
    result[3:, :3] = across @ T[:3, :3]
    return result
