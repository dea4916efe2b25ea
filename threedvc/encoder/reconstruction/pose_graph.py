# SPDX-License-Identifier: MIT
"""Poses that agree best with measured motions between pairs of them.

Each measurement says how one camera lies in another's frame, and how surely in which directions. Gauss-Newton
steps minimize the weighted squares of what the poses leave of it; one that contradicts the others loses its weight
(Geman and McClure 1987), so that a wrong one does no harm. At first all count: a right one that closes a long loop
contradicts the drifted poses, too, until the drift is spread over the loop (graduated non-convexity).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from threedvc.arrays import Doubles
from threedvc.geometry.pose import Pose, adjoint, compose, exp_motion, inverse, log_motion, orthonormalized

__all__ = ["Link", "optimized"]

STEPS = 30
"""At most: those over which the bound comes down, and some more to converge."""
GRADES = 12
"""Steps over which the bound of outliers comes down, by a half each."""
CONVERGED = 1e-7
"""Radians and meters by which a step still moves poses: far below what a link knows."""
OUTLIER = 6.0
"""Residual in standard deviations, of all six together, at which a link has a quarter of its weight."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """A measured motion between two cameras.

    Attributes
    ----------
    first, second
        Numbers of the cameras.
    T_first_second
        Pose of the second in the frame of the first.
    information
        (6, 6) inverse covariance of its error, a small motion (rotation, translation) in the frame of the first.
    """

    first: int
    second: int
    T_first_second: Pose
    information: Doubles


def optimized(poses: Sequence[Pose], links: Sequence[Link]) -> list[Pose]:
    """Return the poses ``T_world_camera`` that fit the links best, near given ones; the first stays.

    Parameters
    ----------
    poses
        Where to start, at least one. One that no chain of links joins to the first keeps its place.
    links
        What was measured.
    """
    poses = list(poses)
    for step in range(STEPS if len(poses) > 1 and links else 0):
        bound = OUTLIER * 2.0 ** max(0, GRADES - step)
        matrix, side = np.zeros((6 * len(poses), 6 * len(poses))), np.zeros(6 * len(poses))
        for link in links:
            _add(link, poses, bound, matrix, side)
        # Directions that nothing determines stay as they are.
        free = matrix[6:, 6:] + 1e-9 * np.trace(matrix) / len(side) * np.eye(len(side) - 6)
        motion = -np.linalg.solve(free, side[6:])
        poses[1:] = [
            orthonormalized(compose(exp_motion(motion[6 * k : 6 * k + 6]), pose)) for k, pose in enumerate(poses[1:])
        ]
        if step >= GRADES and np.abs(motion).max() < CONVERGED:
            break
    return poses


def _add(link: Link, poses: Sequence[Pose], bound: float, matrix: Doubles, side: Doubles) -> None:
    T_first_world = inverse(poses[link.first])
    error = log_motion(T_first_world @ poses[link.second] @ inverse(link.T_first_second))
    squares = float(error @ link.information @ error)
    weighted = link.information * (1 + squares / bound**2) ** -2
    slope = adjoint(T_first_world)
    block, pull = slope.T @ weighted @ slope, slope.T @ weighted @ error
    a, b = (slice(6 * k, 6 * k + 6) for k in (link.first, link.second))
    matrix[a, a] += block
    matrix[b, b] += block
    matrix[a, b] -= block
    matrix[b, a] -= block
    side[a] -= pull
    side[b] += pull
