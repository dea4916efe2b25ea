# SPDX-License-Identifier: MIT
"""Where a camera or an object went, and how far an estimate of it is from the truth.

Angles between two rotations are those of the rotation that leads from one to the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.pose import Pose, make_pose, nearest_rotation, rigid_fit
from threedvc.units import MILLIMETERS

__all__ = [
    "ObjectPoseError",
    "TrajectoryError",
    "Travel",
    "angles_between",
    "mean_pose",
    "object_pose_error",
    "trajectory_error",
    "travel",
]


@dataclass(frozen=True, kw_only=True)
class Travel:
    """How far something went and turned.

    Attributes
    ----------
    length_m, turn_deg
        Sums over the steps from one pose to the next.
    largest_distance_m, largest_turn_deg
        Largest distance and angle of a pose from the first one.
    largest_step_m, largest_step_deg
        Largest steps.
    """

    length_m: float
    turn_deg: float
    largest_distance_m: float
    largest_turn_deg: float
    largest_step_m: float
    largest_step_deg: float


@dataclass(frozen=True, kw_only=True)
class TrajectoryError:
    """How far an estimated trajectory is from the true one.

    Attributes
    ----------
    frames
        Number of poses compared.
    ate_rmse_mm, ate_max_mm
        Absolute trajectory error: distance of positions after a rigid alignment without scale.
    rpe_translation_mm, rpe_rotation_deg
        Relative pose error from one frame to the next, root mean square; 0 without two consecutive frames.
    rpe_translation_median_mm, rpe_rotation_median_deg
        Its median.
    """

    frames: int
    ate_rmse_mm: float
    ate_max_mm: float
    rpe_translation_mm: float
    rpe_rotation_deg: float
    rpe_translation_median_mm: float
    rpe_rotation_median_deg: float


@dataclass(frozen=True, kw_only=True)
class ObjectPoseError:
    """How far the estimated poses of an object are from the true ones, whatever frame the estimate gives the object.

    Attributes
    ----------
    frames
        Number of poses compared.
    rotation_median_deg, rotation_rmse_deg, rotation_max_deg
        Angle between the rotations.
    translation_median_mm, translation_rmse_mm, translation_max_mm
        Distance between the places of the origin of the object's true frame.
    """

    frames: int
    rotation_median_deg: float
    rotation_rmse_deg: float
    rotation_max_deg: float
    translation_median_mm: float
    translation_rmse_mm: float
    translation_max_mm: float


def angles_between(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles in radians (n,) between rotations (n, 3, 3): ``|A - B| = sqrt(8) sin(angle / 2)``."""
    chords = np.linalg.norm(first - second, axis=(1, 2)) / np.sqrt(8.0)
    return np.asarray(2 * np.arcsin(np.minimum(chords, 1.0)))


def travel(poses: Sequence[Pose], point: NDArray[np.float64] | None = None) -> Travel:
    """Measure how far a point of something went, and how far that turned.

    Parameters
    ----------
    poses
        T_world_thing of consecutive frames, at least one.
    point
        (3,) meters in the frame of the thing; None: its origin.
    """
    T = np.array(poses)
    rotations, places = T[:, :3, :3], T[:, :3, 3] if point is None else T[:, :3, :3] @ point + T[:, :3, 3]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    turns = np.degrees(angles_between(rotations[:-1], rotations[1:]))
    return Travel(
        length_m=float(steps.sum()),
        turn_deg=float(turns.sum()),
        largest_distance_m=float(np.linalg.norm(places - places[0], axis=1).max()),
        largest_turn_deg=float(np.degrees(angles_between(rotations, rotations[:1]).max())),
        largest_step_m=float(steps.max(initial=0.0)),
        largest_step_deg=float(turns.max(initial=0.0)),
    )


def trajectory_error(
    reference: Sequence[Pose], estimate: Sequence[Pose], frames: Sequence[int] | None = None
) -> TrajectoryError:
    """Compare two trajectories of T_world_camera whose worlds may differ by a rigid transform.

    Both errors are those of Sturm et al. 2012, sec. IV; the relative one is taken over one frame.

    Parameters
    ----------
    reference, estimate
        Poses of the same frames, at least one.
    frames
        Rising numbers of these frames; None: they are consecutive. Relative errors are taken from a frame to the
        one after it, not across a gap.
    """
    true, found = np.array(reference), np.array(estimate)
    align = rigid_fit(found[:, :3, 3], true[:, :3, 3])
    distances = np.linalg.norm(found[:, :3, 3] @ align[:3, :3].T + align[:3, 3] - true[:, :3, 3], axis=1)
    numbers = np.arange(len(true)) if frames is None else np.array(frames)
    starts = np.flatnonzero(np.diff(numbers) == 1)
    translations, rotations = _step_errors(_steps(true, starts), _steps(found, starts))
    return TrajectoryError(
        frames=len(true),
        ate_rmse_mm=MILLIMETERS * _rms(distances),
        ate_max_mm=MILLIMETERS * float(distances.max()),
        rpe_translation_mm=MILLIMETERS * _rms(translations),
        rpe_rotation_deg=float(np.degrees(_rms(rotations))),
        rpe_translation_median_mm=MILLIMETERS * _median(translations),
        rpe_rotation_median_deg=float(np.degrees(_median(rotations))),
    )


def mean_pose(poses: NDArray[np.float64]) -> Pose:
    """Return the rigid transform with the least sum of squares to several (n, 4, 4).

    Rotations are compared as matrices (the chordal mean of Hartley et al. 2013, sec. 5.3), translations as points.
    """
    return make_pose(nearest_rotation(poses[:, :3, :3].sum(axis=0)), poses[:, :3, 3].mean(axis=0))


def object_pose_error(reference: Sequence[Pose], estimate: Sequence[Pose]) -> ObjectPoseError:
    """Compare T_camera_object of an object whose frame the estimate has chosen for itself.

    The estimate's poses are first brought to the reference's object frame by one transform for all frames, the
    T_estimate_reference with the least sum of squared differences of ``T_camera_estimate @ T_estimate_reference``
    from the truth, in rotation matrices and in places of the origin.

    Parameters
    ----------
    reference, estimate
        Poses in the same frames, at least one.
    """
    true, found = np.array(reference), np.array(estimate)
    aligned = found @ mean_pose(_inverses(found) @ true)
    angles = np.degrees(angles_between(aligned[:, :3, :3], true[:, :3, :3]))
    distances = MILLIMETERS * np.linalg.norm(aligned[:, :3, 3] - true[:, :3, 3], axis=1)
    return ObjectPoseError(
        frames=len(true),
        rotation_median_deg=_median(angles),
        rotation_rmse_deg=_rms(angles),
        rotation_max_deg=float(angles.max()),
        translation_median_mm=_median(distances),
        translation_rmse_mm=_rms(distances),
        translation_max_mm=float(distances.max()),
    )


def _inverses(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    inverses = np.zeros_like(poses)
    inverses[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1)
    inverses[:, :3, 3] = -np.einsum("nij,nj->ni", inverses[:, :3, :3], poses[:, :3, 3])
    inverses[:, 3, 3] = 1
    return inverses


def _steps(poses: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return ``T_this_next`` (k, 4, 4) of the poses at the given places."""
    return np.asarray(_inverses(poses[starts]) @ poses[starts + 1])


def _step_errors(
    true: NDArray[np.float64], found: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return distances in meters and angles in radians of the transforms that lead from one to the other."""
    return np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=1), angles_between(true[:, :3, :3], found[:, :3, :3])


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else 0.0
