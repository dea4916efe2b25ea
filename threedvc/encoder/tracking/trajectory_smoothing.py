# SPDX-License-Identifier: MIT
"""Poses that follow the depth of every frame, without its noise from one frame to the next.

Poses that fit color and depth together know best how a camera moved from frame to frame; poses that fit the depth
alone know where its surfaces meet those of other frames, but jump by what the noise of one depth picture leaves open.
What the one differ from the other by has causes that change slowly: instants of exposure that drift apart, drift of the
model along directions that its shape leaves open. So that difference is smoothed over time, by least squares with a
weight on its changes, and accelerations of the motion that results are damped a little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.geometry.pose import Pose, compose, exp_motion, inverse, log_motion
from threedvc.stream.pose_status import PoseStatus

__all__ = ["damp_acceleration", "smooth_to_depth", "smoothed"]

STIFFNESS = 32.0
"""Weight of a change from one frame to the next, against a deviation from what was measured: about six frames to each
side count."""
DAMPING = 0.07
"""Weight of a change of motion, against a step away from what was measured: a hand that holds a camera has mass."""
DAMPING_STEPS = 30
"""Of Jacobi's iteration, by when what is left is far below the noise of poses: the weight is small."""
UNDETERMINED = 1e-9
"""Weight of 0 for every value: those that nothing determines become that."""


def smooth_to_depth(
    found: Sequence[TrackedPose | None], synchronized: Sequence[TrackedPose | None], blind: Sequence[bool]
) -> list[TrackedPose | None]:
    """Return located frames that go from one to the next as others do, and lie where they did on an average.

    Only tracked poses change: given ones, and those of frames that cannot be fused, stay. A camera at rest rests.

    Parameters
    ----------
    found
        Where an object is in every frame, by its depth.
    together
        Where it is by color and depth.
    blind
        Whether a frame has no depth: it goes with those about it.
    """
    pairs = list(zip(found, synchronized, strict=True))
    deviations, moves = np.zeros((len(pairs), 6)), np.zeros(len(pairs), dtype=np.bool_)
    for k, (at, both) in enumerate(pairs):
        if at is not None and both is not None and at.usable and at.status is not PoseStatus.KNOWN:
            deviations[k], moves[k] = log_motion(at.T_camera_object @ inverse(both.T_camera_object)), True
    submaps = [None if at is None else at.submap for at, _ in pairs]
    joined = np.array([a is not None and a == b for a, b in pairwise(submaps)])
    smooth = smoothed(deviations, moves & ~np.array(blind, dtype=np.bool_), STIFFNESS * joined)
    poses: dict[int, Pose] = {}
    for k, (_, both) in enumerate(pairs):
        if moves[k] and both is not None and not _is_stationary(pairs, k):
            poses[k] = compose(exp_motion(smooth[k]), both.T_camera_object)
    for run in _runs(list(poses), joined):
        poses |= zip(run, damp_acceleration([poses[k] for k in run]), strict=True)
    result = list(found)
    for k, at in enumerate(found):
        if moves[k] and at is not None:
            if k not in poses:
                poses[k] = poses.get(k - 1, at.T_camera_object)
            result[k] = replace(at, T_camera_object=poses[k])
    return result


def damp_acceleration(poses: Sequence[Pose]) -> list[Pose]:
    """Return poses ``T_camera_object`` near given ones of consecutive frames that change their motion a little less.

    Minimizes, over small motions of each camera in its own frame, the sum of their squares plus `DAMPING` times that of
    the changes of motion, turns and shifts alike.
    """
    if len(poses) < 3:
        return list(poses)
    motions = np.array([log_motion(a @ inverse(b)) for a, b in pairwise(poses)])
    bends, steps = np.diff(motions, axis=0), np.zeros((len(poses), 6))
    for _ in range(DAMPING_STEPS):
        bent, pull = bends + np.diff(steps, n=2, axis=0), steps.copy()
        for offset, weight in enumerate((DAMPING, -2 * DAMPING, DAMPING)):
            pull[offset : offset + len(bent)] += weight * bent
        steps -= pull / (1 + 8 * DAMPING)
    return [compose(inverse(exp_motion(step)), pose) for step, pose in zip(steps, poses, strict=True)]


def smoothed(values: Doubles, weights: Doubles | NDArray[np.bool_], stiffness: Doubles) -> Doubles:
    """Return values (n, c) near weighted ones that change little from each to the next.

    Minimizes ``sum weights |x - values|^2 + sum stiffness |x[k + 1] - x[k]|^2``, by elimination from first to last.

    Parameters
    ----------
    values
        (n, c) values.
    weights
        (n,) their weights, or whether they count.
    stiffness
        (n - 1,) weights of the changes.
    """
    diagonal = np.asarray(weights, dtype=np.float64) + UNDETERMINED
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


def _is_stationary(pairs: Sequence[tuple[TrackedPose | None, TrackedPose | None]], frame: int) -> bool:
    """Tell whether both poses of a frame are those of the frame before."""
    if not frame:
        return False
    befores = pairs[frame - 1]
    return all(
        at is not None and before is not None and np.array_equal(at.T_camera_object, before.T_camera_object)
        for at, before in zip(pairs[frame], befores, strict=True)
    )


def _runs(frames: Sequence[int], joined: NDArray[np.bool_]) -> list[list[int]]:
    """Divide rising numbers of frames into runs of consecutive ones that are joined."""
    runs: list[list[int]] = []
    for frame in frames:
        if runs and runs[-1][-1] == frame - 1 and joined[frame - 1]:
            runs[-1].append(frame)
        else:
            runs.append([frame])
    return runs
