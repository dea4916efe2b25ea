# SPDX-License-Identifier: MIT
"""Camera and object poses from text files: quaternion rows, 4x4 matrices, Open3D trajectories.

Every pose is checked to be rigid where it is read, so that a message can name the file and the line, and is
made exactly orthonormal.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import SequenceError
from threedvc.formats.sources.files.text import Row, read_rows
from threedvc.geometry.pose import Pose, make_pose, rotation_from_quaternion, rotation_from_vector, rotation_vector
from threedvc.units import NANOSECONDS

__all__ = [
    "PoseArray",
    "interpolate_pose",
    "pose_from_numbers",
    "pose_from_row",
    "read_known_matrix",
    "read_matrix",
    "read_trajectory_log",
    "rigid_poses",
]

PoseArray = NDArray[np.float64]

RIGID_TOLERANCE = 1e-3
"""By which rows of a rotation may differ from orthonormal ones: files with four digits pass, scaled matrices do not."""
UNIT_TOLERANCE = 1e-2
"""By which a quaternion's length may differ from 1: files with three digits pass."""
LOST = frozenset({"inf", "infinity", "nan"})
MAX_GAP_NS = NANOSECONDS // 10
"""Between poses that are interpolated, a tenth of a second: a hand may turn back within a longer one."""


def rigid_poses(matrices: PoseArray, places: Sequence[str]) -> PoseArray:
    """Check that (n, 4, 4) transforms are rigid and make their rotations exactly orthonormal.

    Parameters
    ----------
    matrices
        Transforms as read.
    places
        Where each stands, for the message.

    Raises
    ------
    SequenceError
        If one holds NaN or infinity, or is not a rotation and a translation within 0.001.
    """
    finite = np.isfinite(matrices).all(axis=(1, 2))
    if not finite.all():
        raise _bad_pose(places[int(np.argmin(finite))], "holds NaN or infinity")
    rotations = matrices[:, :3, :3]
    skew = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0)
    bottom = np.abs(matrices[:, 3] - [0, 0, 0, 1]).max(axis=1, initial=0)
    rigid = (skew < RIGID_TOLERANCE) & (bottom < RIGID_TOLERANCE) & (np.linalg.det(rotations) > 0)
    if not rigid.all():
        raise _bad_pose(places[int(np.argmin(rigid))], "is not a rotation and a translation")
    u, _, vt = np.linalg.svd(rotations)
    poses: PoseArray = np.tile(np.eye(4), (len(matrices), 1, 1))
    poses[:, :3, :3] = u @ vt
    poses[:, :3, 3] = matrices[:, :3, 3]
    return poses


def pose_from_row(row: Row) -> Pose:
    """Turn a row ``key tx ty tz qx qy qz qw`` (meters) into a pose; raises SequenceError."""
    if len(row.fields) != 8:
        raise SequenceError(
            f"{row.place}: {len(row.fields)} fields, expected 8 (key tx ty tz qx qy qz qw); correct the line"
        )
    return pose_from_numbers(row.floats(start=1), row.place)


def pose_from_numbers(numbers: Sequence[float], place: str) -> Pose:
    """Turn ``tx ty tz qx qy qz qw`` (meters) into a pose; raises SequenceError that names the place."""
    values = np.array(numbers)
    length = float(np.linalg.norm(values[3:]))
    if not abs(length - 1) <= UNIT_TOLERANCE or not np.all(np.isfinite(values)):
        raise _bad_pose(place, f"has a quaternion of length {length:.4g} instead of 1")
    return make_pose(rotation_from_quaternion(values[3:]), values[:3])


def read_matrix(path: Path) -> Pose:
    """Read one 4x4 transform from a text file; raises SequenceError."""
    pose: Pose = rigid_poses(_matrix(path, read_rows(path))[None], [str(path)])[0]
    return pose


def read_known_matrix(path: Path) -> Pose | None:
    """Read one 4x4 transform from a text file, None if its numbers are not finite: the camera was lost there."""
    rows = read_rows(path)
    fields = [field.lower().lstrip("+-") for row in rows for field in row.fields]
    return None if any(field in LOST for field in fields) else read_matrix(path)


def read_trajectory_log(path: Path) -> list[Pose]:
    """Read an Open3D trajectory: per frame one line of three integers, then a 4x4 camera-to-world matrix."""
    rows = read_rows(path)
    blocks = [rows[start : start + 5] for start in range(0, len(rows), 5)]
    matrices = [_matrix(path, block[1:]) for block in blocks]
    places = [block[0].place for block in blocks]
    return list(rigid_poses(np.array(matrices).reshape(-1, 4, 4), places))


def interpolate_pose(stamps: Sequence[int], poses: Sequence[Pose], stamp: int) -> Pose | None:
    """Interpolate a trajectory at one time, linearly in translation and in rotation angle.

    Parameters
    ----------
    stamps
        Increasing times in nanoseconds.
    poses
        The pose at each.
    stamp
        The time asked for.

    Returns
    -------
    Pose or None
        None before the first pose, after the last, and inside a gap of more than 0.1 s.
    """
    after = bisect_left(stamps, stamp)
    if after < len(stamps) and stamps[after] == stamp:
        return poses[after]
    if after in (0, len(stamps)) or stamps[after] - stamps[after - 1] > MAX_GAP_NS:
        return None
    part = (stamp - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
    before, later = poses[after - 1], poses[after]
    turn = rotation_vector(before[:3, :3].T @ later[:3, :3])
    rotation = before[:3, :3] @ rotation_from_vector(part * turn)
    return make_pose(rotation, before[:3, 3] + part * (later[:3, 3] - before[:3, 3]))


def _matrix(path: Path, rows: Sequence[Row]) -> PoseArray:
    if len(rows) != 4 or any(len(row.fields) != 4 for row in rows):
        place = rows[0].place if rows else str(path)
        raise SequenceError(f"{place}: expected a 4x4 matrix; correct the file or remove it")
    return np.array([row.floats() for row in rows])


def _bad_pose(place: str, why: str) -> SequenceError:
    return SequenceError(f"{place}: pose {why}; correct it, or remove the poses and let the camera be tracked")
