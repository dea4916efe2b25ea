# SPDX-License-Identifier: MIT
"""One pose from several sensors that see the same object at the same moment.

Each sensor's registration says where the object is, and by its information how surely in which directions: one that
looks along a plain wall leaves to others what it cannot tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.pose import (
    Pose,
    adjoint,
    compose,
    inverse,
    make_pose,
    orthonormalised,
    rotation_from_vector,
    twist_of,
)

__all__ = ["PoseWitness", "joint_pose"]

LEAST_INFORMATION = 1e-6
"""Part of the greatest information below which a direction stays as the first sensor has it."""


class PoseWitness(NamedTuple):
    """What one sensor says about the pose of an object.

    Attributes
    ----------
    T_base_object
        Where it is.
    T_view_object
        Pose of the object in the view that it was registered with.
    information
        (6, 6) inverse covariance of a small motion (turn, shift) of the frame in the view's camera, see
        `threedvc.encoder.tracking.alignment.Alignment.information`.
    """

    T_base_object: Pose
    T_view_object: Pose
    information: NDArray[np.float64]


def joint_pose(witnesses: Sequence[PoseWitness]) -> Pose:
    """Return the pose T_base_object that fits all witnesses best; directions that none determines follow the first.

    Poses must lie near each other. At least one is needed.
    """
    first = witnesses[0].T_base_object
    matrix, side = np.zeros((6, 6)), np.zeros(6)
    for witness in witnesses:
        # A motion of the frame in the view is the same motion of the object in its own frame, backwards.
        slope = adjoint(witness.T_view_object)
        information = slope.T @ witness.information @ slope
        matrix += information
        side += information @ twist_of(inverse(first) @ witness.T_base_object)
    floor = LEAST_INFORMATION * float(np.linalg.eigvalsh(matrix)[-1]) + 1e-12
    twist = np.linalg.solve(matrix + floor * np.eye(6), side).astype(np.float64)
    return orthonormalised(compose(first, make_pose(rotation_from_vector(twist[:3]), twist[3:])))
