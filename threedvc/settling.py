# SPDX-License-Identifier: MIT
"""Poses that follow the depth of every frame, without its noise from one frame to the next.

Poses that fit colour and depth together know best how a camera moved from frame to frame; poses that fit the depth
alone know where its surfaces meet those of other frames, but jump by what the noise of one depth picture leaves open.
What the one differ from the other by has causes that change slowly: instants of exposure that drift apart, drift of the
model along directions that its shape leaves open. So that difference is smoothed over time, by
least squares with a weight on its changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from threedvc.motion import Located
from threedvc.pose import compose, inverse, make_pose, rotation_from_vector, rotation_vector

__all__ = ["settled", "smoothed"]

STIFFNESS = 32.0
"""Weight of a change from one frame to the next, against a deviation from what was measured: about six frames to each
side count."""
FREE = 1e-9
"""Values that nothing determines are 0."""

Doubles = NDArray[np.float64]


def settled(
    found: Sequence[Located | None], together: Sequence[Located | None], blind: Sequence[bool]
) -> list[Located | None]:
    """Return located frames that go from one to the next as others do, and lie where they did on an average.

    Only tracked poses change: given ones, and those of frames that cannot be fused, stay. A camera at rest rests.

    Parameters
    ----------
    found
        Where an object is in every frame, by its depth.
    together
        Where it is by colour and depth.
    blind
        Whether a frame has no depth: it goes with those about it.
    """
    pairs = list(zip(found, together, strict=True))
    deviations, moves = np.zeros((len(pairs), 6)), np.zeros(len(pairs), dtype=np.bool_)
    for k, (at, both) in enumerate(pairs):
        if at is not None and both is not None and at.usable and at.status != "known":
            motion = at.T_camera_object @ inverse(both.T_camera_object)
            deviations[k, :3], deviations[k, 3:], moves[k] = rotation_vector(motion[:3, :3]), motion[:3, 3], True
    parts = [None if at is None else at.part for at, _ in pairs]
    joined = np.array([a is not None and a == b for a, b in pairwise(parts)])
    smooth = smoothed(deviations, moves & ~np.array(blind), STIFFNESS * joined)
    result = list(found)
    for k, (at, both) in enumerate(pairs):
        if not moves[k] or at is None or both is None:
            continue
        if k and _same(at, found[k - 1]) and _same(both, together[k - 1]):
            pose = result[k - 1].T_camera_object  # type: ignore[union-attr]
        else:
            motion = make_pose(rotation_from_vector(smooth[k, :3]), smooth[k, 3:])
            pose = compose(motion, both.T_camera_object)
        result[k] = replace(at, T_camera_object=pose)
    return result


def smoothed(values: Doubles, weights: Doubles | NDArray[np.bool_], stiffness: Doubles) -> Doubles:
    """Return values (n, c) near weighted ones that change little from each to the next.

    Minimises ``sum weights |x - values|^2 + sum stiffness |x[k + 1] - x[k]|^2``, by elimination from first to last.

    Parameters
    ----------
    values
        (n, c) values.
    weights
        (n,) their weights, or whether they count.
    stiffness
        (n - 1,) weights of the changes.
    """
    diagonal = np.asarray(weights, dtype=np.float64) + FREE
    diagonal[:-1] += stiffness
    diagonal[1:] += stiffness
    result = weights[:, None] * values
    for k in range(len(stiffness)):
        factor = stiffness[k] / diagonal[k]
        diagonal[k + 1] -= factor * stiffness[k]
        result[k + 1] += factor * result[k]
    result[-1:] /= diagonal[-1:, None]
    for k in reversed(range(len(stiffness))):
        result[k] = (result[k] + stiffness[k] * result[k + 1]) / diagonal[k]
    return result


def _same(one: Located, other: Located | None) -> bool:
    return other is not None and np.array_equal(one.T_camera_object, other.T_camera_object)
