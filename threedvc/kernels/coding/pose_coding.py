# SPDX-License-Identifier: MIT
"""Prediction, quantization and entropy coding of poses, compiled.

A pose is (7,) float64: unit quaternion ``w, x, y, z``, then translation in meters. Scalars see only
+ - * / sqrt and floor, each rounded once, so that every machine decodes the same poses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS, Coder, code_adaptive_bit, code_signed, overrun

__all__ = [
    "MAGNITUDE_BINS",
    "MAX_RESIDUAL",
    "POSE_COUNTERS",
    "RECENT_SIZE",
    "code_residuals",
    "follow_poses",
    "repeats_last",
]

MAX_RESIDUAL = (1 << 30) - 1
"""What a writer gives a residual at most: within what a signed number can be."""
MAGNITUDE_BINS = 12
"""Size classes of a running mean. As all below but `MIN_COSINE`, it is part of the format (docs/coding.md)."""
POSE_COUNTERS = 2 + 2 * MAGNITUDE_BINS * NUMBER_COUNTERS
"""Two for poses that repeat, and those of numbers by kind, rotation or translation, and size class."""
RECENT_SIZE = 7
"""Running means of six numbers, and whether the last pose was a repeated one."""
SMALL_MEAN = 4
"""Running mean, in eighths of the step, up to which numbers are of the first size class."""
MAX_RECENT = 1 << 20
"""What a magnitude counts for at most in a running mean, which then stays small."""
COUNTER_LIMIT = 60
"""Bits that a counter remembers: fewer than elsewhere, as motion changes within seconds."""
MIN_COSINE = 1e-9
"""Of half a turn's angle, at least: a Gibbs vector has no half turns."""
COST_DECAY = 0.875
"""Part of the sums of misses that is left at the next frame: the last eight or so count."""


@kernel
def multiply(a: NDArray[np.float64], b: NDArray[np.float64], product: NDArray[np.float64]) -> None:
    """Write the product of two quaternions, scaled to unit length."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    length = np.sqrt(w * w + x * x + y * y + z * z)
    product[0], product[1], product[2], product[3] = w / length, x / length, y / length, z / length


@kernel
def rotate(q: NDArray[np.float64], v: NDArray[np.float64], rotated: NDArray[np.float64]) -> None:
    """Write the vector v (3,) turned by a unit quaternion."""
    a = 2 * (q[2] * v[2] - q[3] * v[1])
    b = 2 * (q[3] * v[0] - q[1] * v[2])
    c = 2 * (q[1] * v[1] - q[2] * v[0])
    x = v[0] + q[0] * a + (q[2] * c - q[3] * b)
    y = v[1] + q[0] * b + (q[3] * a - q[1] * c)
    z = v[2] + q[0] * c + (q[1] * b - q[2] * a)
    rotated[0], rotated[1], rotated[2] = x, y, z


@kernel
def copy_pose(source: NDArray[np.float64], target: NDArray[np.float64]) -> None:
    """Copy a pose."""
    for k in range(7):
        target[k] = source[k]


@kernel
def predict_pose(last: NDArray[np.float64], before: NDArray[np.float64], predicted: NDArray[np.float64]) -> None:
    """Continue the motion of the last two poses: ``(T_last T_before^-1) T_last``; exact where they are equal."""
    moved = False
    for k in range(7):
        predicted[k] = last[k]
        moved = moved or last[k] != before[k]
    if not moved:
        return
    turn = np.empty(4)
    back = np.empty(4)
    arm = np.empty(3)
    back[0], back[1], back[2], back[3] = before[0], -before[1], -before[2], -before[3]
    multiply(last[:4], back, turn)
    multiply(turn, last[:4], predicted[:4])
    for k in range(3):
        arm[k] = last[4 + k] - before[4 + k]
    rotate(turn, arm, arm)
    for k in range(3):
        predicted[4 + k] = last[4 + k] + arm[k]


@kernel
def turn_of(residual: NDArray[np.int64], step: float, turn: NDArray[np.float64]) -> None:
    """Write the quaternion (4,) of the Gibbs vector ``residual[:3] step / 2``."""
    x, y, z = residual[0] * (0.5 * step), residual[1] * (0.5 * step), residual[2] * (0.5 * step)
    length = np.sqrt(1 + (x * x + y * y + z * z))
    turn[0], turn[1], turn[2], turn[3] = 1 / length, x / length, y / length, z / length


@kernel
def apply_residual(
    predicted: NDArray[np.float64],
    residual: NDArray[np.int64],
    steps: NDArray[np.float64],
    about_origin: bool,
    pose: NDArray[np.float64],
) -> None:
    """Turn a predicted pose by ``residual[:3]``, about the origin or in its own place, and move it by the rest."""
    copy_pose(predicted, pose)
    if residual[0] != 0 or residual[1] != 0 or residual[2] != 0:
        turn = np.empty(4)
        turn_of(residual, steps[1], turn)
        multiply(turn, predicted[:4], pose[:4])
        if about_origin:
            rotate(turn, predicted[4:], pose[4:])
    for k in range(3):
        pose[4 + k] += residual[3 + k] * steps[0]


@kernel
def compare_pivots(
    predicted: NDArray[np.float64],
    residual: NDArray[np.int64],
    steps: NDArray[np.float64],
    pose: NDArray[np.float64],
    costs: NDArray[np.float64],
) -> None:
    """Add to the fading `costs` (2,) how far off the translation is by either way of turning: origin, own place."""
    turn, turned = np.empty(4), np.empty(3)
    turn_of(residual, steps[1], turn)
    rotate(turn, predicted[4:], turned)
    costs[0] *= COST_DECAY
    costs[1] *= COST_DECAY
    for k in range(3):
        costs[0] += abs(pose[4 + k] - turned[k])
        costs[1] += abs(pose[4 + k] - predicted[4 + k])


@kernel
def rounded(value: float) -> int:
    """Round to the nearest integer within what a residual may be."""
    return np.int64(np.floor(min(max(value, -float(MAX_RESIDUAL)), float(MAX_RESIDUAL)) + 0.5))


@kernel
def measure_residual(
    pose: NDArray[np.float64],
    predicted: NDArray[np.float64],
    steps: NDArray[np.float64],
    about_origin: bool,
    residual: NDArray[np.int64],
) -> None:
    """Write the six integers for which `apply_residual` comes nearest to `pose`."""
    back = np.empty(4)
    turn = np.empty(4)
    near = np.empty(7)
    back[0], back[1], back[2], back[3] = predicted[0], -predicted[1], -predicted[2], -predicted[3]
    multiply(pose[:4], back, turn)
    cosine = turn[0] if abs(turn[0]) > MIN_COSINE else MIN_COSINE
    scale = 2 / (cosine * steps[1])
    largest = max(abs(turn[1]), abs(turn[2]), abs(turn[3])) * abs(scale)
    if largest > MAX_RESIDUAL:
        scale *= MAX_RESIDUAL / largest
    for k in range(3):
        residual[k] = rounded(turn[1 + k] * scale)
        residual[3 + k] = 0
    apply_residual(predicted, residual, steps, about_origin, near)
    for k in range(3):
        residual[3 + k] = rounded((pose[4 + k] - near[4 + k]) / steps[0])


@kernel
def repeats_last(
    pose: NDArray[np.float64], last: NDArray[np.float64], steps: NDArray[np.float64], residual: NDArray[np.int64]
) -> bool:
    """Tell whether a pose differs from the last one by less than the quantization."""
    measure_residual(pose, last, steps, False, residual)
    largest = np.int64(0)
    for k in range(6):
        largest = max(largest, abs(residual[k]))
    return largest == 0


@kernel
def follow_poses(
    writing: bool,
    targets: NDArray[np.float64],
    still: NDArray[np.int64],
    residuals: NDArray[np.int64],
    state: NDArray[np.float64],
    costs: NDArray[np.float64],
    steps: NDArray[np.float64],
    decoded: NDArray[np.float64],
) -> None:
    """Go through a group of poses as the decoder will.

    Parameters
    ----------
    writing
        Whether `still` and `residuals` are to be found from `targets`, or are given.
    targets, decoded
        (n, 7) poses: wanted, and as decoded.
    still, residuals
        (n,) whether a frame repeats the last pose, and (n, 6) integers otherwise.
    state
        (2, 7): the last decoded pose and the one before; moved on.
    costs
        (2,) of `compare_pivots`: the cheaper way of turning is taken.
    steps
        Translation step in meters, rotation step in radians.
    """
    predicted = np.empty(7)
    for i in range(len(decoded)):
        if writing:
            still[i] = repeats_last(targets[i], state[0], steps, residuals[i])
        if still[i] == 1:
            copy_pose(state[0], decoded[i])
        else:
            predict_pose(state[0], state[1], predicted)
            about_origin = costs[0] <= costs[1]
            if writing:
                measure_residual(targets[i], predicted, steps, about_origin, residuals[i])
            apply_residual(predicted, residuals[i], steps, about_origin, decoded[i])
            compare_pivots(predicted, residuals[i], steps, decoded[i], costs)
        copy_pose(state[0], state[1])
        copy_pose(decoded[i], state[0])


@kernel
def code_residuals(
    coder: Coder,
    still: NDArray[np.int64],
    residuals: NDArray[np.int64],
    recent: NDArray[np.int64],
    counters: NDArray[np.uint32],
) -> bool:
    """Code flags and residuals of a group of frames; return False if the data end too early.

    The context of a number is the running mean in `recent` (7,) of the magnitudes of its component;
    rotation and translation have counters of their own.
    """
    for i in range(len(still)):
        if overrun(coder):
            return False
        context = 1 if recent[6] == 1 else 0
        still[i] = code_adaptive_bit(coder, still[i], counters, context, COUNTER_LIMIT)
        recent[6] = still[i]
        if still[i] == 1:
            continue
        for k in range(6):
            size = recent[k]
            place = 0
            while size > SMALL_MEAN and place < MAGNITUDE_BINS - 1:
                size >>= 1
                place += 1
            first = 2 + (k // 3 * MAGNITUDE_BINS + place) * NUMBER_COUNTERS
            residuals[i, k] = code_signed(coder, residuals[i, k], counters, first, COUNTER_LIMIT)
            recent[k] += (8 * min(abs(residuals[i, k]), MAX_RECENT) - recent[k]) >> 2
    return True
