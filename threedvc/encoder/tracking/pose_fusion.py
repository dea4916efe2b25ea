# SPDX-License-Identifier: MIT
"""One pose from several sensors that see the same object at the same moment.

Each sensor's registration says where the object is, and by its information how surely in which directions: one that
looks along a plain wall leaves to others what it cannot tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from threedvc.arrays import Doubles
from threedvc.geometry.pose import Pose, adjoint, compose, exp_motion, inverse, log_motion, orthonormalized

__all__ = ["PoseEstimate", "fused_pose"]

MIN_INFORMATION = 1e-6
"""Part of the largest information below which a direction stays as the first sensor has it: rounding leaves as much."""


class PoseEstimate(NamedTuple):
    """What one sensor says about the pose of an object.

    Attributes
    ----------
    T_rig_object
        Where it is.
    T_view_object
        Pose of the object in the view that it was registered with.
    information
        (6, 6) inverse covariance of a small motion (turn, shift) of the frame in the view's camera, see
        `threedvc.encoder.registration.icp.Alignment.information`.
    """

    T_rig_object: Pose
    T_view_object: Pose
    information: Doubles


def fused_pose(estimates: Sequence[PoseEstimate]) -> Pose:
    """Return the pose T_rig_object that fits all estimates best; directions that none determines follow the first.

    Poses must lie near each other. At least one is needed.
    """
    first = estimates[0].T_rig_object
    matrix, side = np.zeros((6, 6)), np.zeros(6)
    for estimate in estimates:
        # A motion of the frame in the view is the same motion of the object in its own frame, backwards.
        slope = adjoint(estimate.T_view_object)
        information = slope.T @ estimate.information @ slope
        matrix += information
        side += information @ log_motion(inverse(first) @ estimate.T_rig_object)
    floor = MIN_INFORMATION * float(np.linalg.eigvalsh(matrix)[-1]) + 1e-12
    twist = np.linalg.solve(matrix + floor * np.eye(6), side).astype(np.float64)
    return orthonormalized(compose(first, exp_motion(twist)))
