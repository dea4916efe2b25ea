# SPDX-License-Identifier: MIT
"""Coding of a picture of inverse depths, compiled.

Samples of a coarse grid come first. Then, level by level, those half-way between two known ones are predicted by
linear interpolation, first along the rows, then along the columns: in inverse depth a plane is linear, so it costs
next to nothing. Where the two lie on different surfaces a bit tells which of them goes on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.coding.range_coder import (
    NUMBER_COUNTERS,
    READING,
    Coder,
    code_adaptive_bit,
    code_number,
    overrun,
)

__all__ = ["DEPTH_COUNTERS", "JUMP", "MAX_SAMPLE", "DepthSamples", "code_depths"]

JUMP = 16
"""Samples that differ by more than a part of this many of the smaller lie on different surfaces. All numbers here are
part of the format (docs/coding.md)."""
MAX_SAMPLE = 1 << 20
"""Greatest sample: finer than any sensor, and products with it stay small."""
LINEAR, BEFORE, AFTER = 0, 1, 2
"""Modes: between its neighbors, or on the surface of one of them."""
LEVEL_BINS = 4
"""Levels with counters of their own; the coarser ones have few samples and share them."""
ENERGY_BINS = 6
"""See `energy_bin`."""
COUNTER_LIMIT = 255
"""Bits that a counter remembers, as everywhere."""
CHECK_BINS = 18
"""First counter of modes: before it are six of presence, others have no use."""
MODE_BINS = 6
"""Three of whether a mode is linear, and three of which of the others it is, by the mode beside."""
ZERO_FIRST = CHECK_BINS + MODE_BINS
SIGN_FIRST = ZERO_FIRST + LEVEL_BINS * ENERGY_BINS * 2
SIZE_FIRST = SIGN_FIRST + 3
ROOT_FIRST = SIZE_FIRST + ENERGY_BINS * NUMBER_COUNTERS
DEPTH_COUNTERS = ROOT_FIRST + NUMBER_COUNTERS
"""First counters of each kind, and their number."""


class DepthSamples(NamedTuple):
    """A picture that is coded.

    Attributes
    ----------
    values
        (rows, columns) int64 samples as decoded, 0 = nothing there; updated.
    residuals, modes
        (rows, columns) int64: quantized differences from the predictions, and whether a sample was predicted between
        its neighbors or from one of them; both 0 at first, updated.
    wishes
        (rows, columns) int64 what the writer would like; of no meaning to a reader.
    steps
        (levels,) int64 quantization steps, that of the finest level first.
    dead_zone
        Differences below this many 256ths of a step are coded as none.
    complete
        1 if there is something everywhere.
    counters
        (DEPTH_COUNTERS,) uint32.
    """

    values: NDArray[np.int64]
    residuals: NDArray[np.int64]
    modes: NDArray[np.int64]
    wishes: NDArray[np.int64]
    steps: NDArray[np.int64]
    dead_zone: int
    complete: int
    counters: NDArray[np.uint32]


@kernel
def at(array: NDArray[np.int64], y: int, x: int) -> int:
    """Return an element, 0 outside."""
    if y < 0 or x < 0 or y >= array.shape[0] or x >= array.shape[1]:
        return np.int64(0)
    return array[y, x]


@kernel
def differ(a: int, b: int) -> bool:
    """Tell whether two samples lie on different surfaces."""
    return abs(a - b) * JUMP > min(a, b)


@kernel
def carried_on(near: int, far: int) -> int:
    """Return what lies as far beyond `near` as half the way from `far` to it; `far` may be 0."""
    if far == 0 or differ(near, far):
        return near
    return max(near + ((near - far) >> 1), np.int64(1))


@kernel
def is_bent(far: int, near: int, other: int) -> bool:
    """Tell whether `other` lies off the straight line through two samples before it; without the first, off them."""
    if far == 0:
        return differ(near, other)
    return abs(far - 2 * near + other) * JUMP > min(near, other)


@kernel
def quantized(difference: int, step: int, dead_zone: int) -> int:
    """Return the multiple of `step` that is nearest to a difference, 0 within the dead zone."""
    size = abs(difference)
    if 256 * size < dead_zone * step:
        return np.int64(0)
    units = (2 * size + step) // (2 * step)
    return units if difference > 0 else -units


@kernel
def energy_bin(energy: int) -> int:
    """Return the bin of a sum of magnitudes."""
    if energy < 3:
        return energy
    return np.int64(3) if energy < 6 else (np.int64(4) if energy < 12 else np.int64(5))


@kernel
def code_presence(coder: Coder, job: DepthSamples, y: int, x: int, a: int, b: int, beside: int) -> bool:
    """Code whether there is anything at a sample, from two neighbors around it and one beside it."""
    if job.complete == 1:
        return True
    inside = 2 if a > 0 and b > 0 else (1 if a > 0 or b > 0 else 0)
    bin_ = inside * 2 + (1 if beside > 0 else 0)
    wish = 1 if job.wishes[y, x] > 0 else 0
    return code_adaptive_bit(coder, wish, job.counters, bin_, COUNTER_LIMIT) == 1


@kernel
def code_value(
    coder: Coder, job: DepthSamples, y: int, x: int, guess: int, level: int, energy: int, slant: int, sign: int
) -> None:
    """Code the quantized difference of a sample from its prediction.

    `energy` sums magnitudes around, `slant` is 1 where two surfaces meet, `sign` is 0 to 2 for the signs around.
    """
    step, counters = job.steps[level], job.counters
    units = quantized(job.wishes[y, x] - guess, step, job.dead_zone) if coder.state[READING] == 0 else np.int64(0)
    around = energy_bin(energy)
    first = ZERO_FIRST + (min(level, LEVEL_BINS - 1) * ENERGY_BINS + around) * 2 + slant
    if code_adaptive_bit(coder, 1 if units != 0 else 0, counters, first, COUNTER_LIMIT) == 1:
        size = SIZE_FIRST + around * NUMBER_COUNTERS
        magnitude = code_number(coder, abs(units) - 1, counters, size, COUNTER_LIMIT) + 1
        negative = code_adaptive_bit(coder, 1 if units < 0 else 0, counters, SIGN_FIRST + sign, COUNTER_LIMIT)
        units = -magnitude if negative else magnitude
    else:
        units = np.int64(0)
    job.residuals[y, x] = units
    job.values[y, x] = min(max(guess + units * step, np.int64(1)), np.int64(MAX_SAMPLE))


@kernel
def code_mode(
    coder: Coder, job: DepthSamples, y: int, x: int, guesses: NDArray[np.int64], level: int, like: int
) -> int:
    """Code whether a sample amid two surfaces lies between them, or which of them goes on; `like` is a mode nearby."""
    mode = np.int64(LINEAR)
    if coder.state[READING] == 0:
        wish = job.wishes[y, x]
        if 2 * abs(wish - guesses[LINEAR]) > job.steps[level]:
            for other in (BEFORE, AFTER):
                if abs(wish - guesses[other]) < abs(wish - guesses[mode]):
                    mode = np.int64(other)
    bin_ = CHECK_BINS + like
    if code_adaptive_bit(coder, 1 if mode != LINEAR else 0, job.counters, bin_, COUNTER_LIMIT) == 0:
        return np.int64(LINEAR)
    after = code_adaptive_bit(coder, 1 if mode == AFTER else 0, job.counters, bin_ + 3, COUNTER_LIMIT)
    return np.int64(AFTER) if after == 1 else np.int64(BEFORE)


@kernel
def code_between(coder: Coder, job: DepthSamples, y: int, x: int, dy: int, dx: int, level: int, last: int) -> int:
    """Code the sample between those at a distance (dy, dx) on either side; return it, or `last` if nothing is there.

    `last` is the value coded before.
    """
    values, residuals = job.values, job.residuals
    a, b = at(values, y - dy, x - dx), at(values, y + dy, x + dx)
    # Beside it is the sample coded before on the line across.
    ny, nx = (y - 2 * dx, x) if dx else (y, x - dy)
    if not code_presence(coder, job, y, x, a, b, at(values, ny, nx)):
        return last
    guesses = np.empty(3, dtype=np.int64)
    mode, edge = np.int64(LINEAR), 0
    if a > 0 and b > 0:
        far_a, far_b = at(values, y - 3 * dy, x - 3 * dx), at(values, y + 3 * dy, x + 3 * dx)
        guesses[0], guesses[1], guesses[2] = (a + b + 1) >> 1, carried_on(a, far_a), carried_on(b, far_b)
        if is_bent(far_a, a, b) and is_bent(far_b, b, a):
            edge = 1
            mode = code_mode(coder, job, y, x, guesses, level, at(job.modes, ny, nx))
        guess = guesses[mode]
    elif a > 0:
        guess = carried_on(a, at(values, y - 3 * dy, x - 3 * dx))
    elif b > 0:
        guess = carried_on(b, at(values, y + 3 * dy, x + 3 * dx))
    else:
        guess = last
    job.modes[y, x] = mode
    beside, before = at(residuals, ny, nx), at(residuals, y - 2 * dy, x - 2 * dx)
    energy = 2 * (abs(beside) + abs(before))
    energy += abs(at(residuals, y - dy, x - dx)) + abs(at(residuals, y + dy, x + dx))
    tilt = 2 * beside + before
    code_value(coder, job, y, x, guess, level, energy, edge, 0 if tilt == 0 else (1 if tilt > 0 else 2))
    return job.values[y, x]


@kernel
def code_root(coder: Coder, job: DepthSamples, y: int, x: int, h: int, last: int) -> int:
    """Code a sample of the coarsest grid, of spacing h; see `code_between`."""
    values = job.values
    left, above, corner = at(values, y, x - h), at(values, y - h, x), at(values, y - h, x - h)
    if not code_presence(coder, job, y, x, left, above, corner):
        return last
    guess = last
    if left > 0 and above > 0 and corner > 0:
        guess = left + above - corner
    elif left > 0 or above > 0:
        guess = left if left > 0 else above
    level = len(job.steps) - 1
    units = quantized(job.wishes[y, x] - guess, job.steps[level], 0) if coder.state[READING] == 0 else np.int64(0)
    folded = code_number(coder, 2 * abs(units) - (1 if units > 0 else 0), job.counters, ROOT_FIRST, COUNTER_LIMIT)
    units = (folded + 1) >> 1 if folded & 1 else -(folded >> 1)
    values[y, x] = min(max(guess + units * job.steps[level], np.int64(1)), np.int64(MAX_SAMPLE))
    return values[y, x]


@kernel
def code_depths(coder: Coder, job: DepthSamples) -> bool:
    """Code all samples; return False if the data end too early."""
    rows, columns = job.values.shape
    levels = len(job.steps) - 1
    h = np.int64(1) << levels
    last = np.int64(MAX_SAMPLE >> 1)
    for y in range(0, rows, h):
        for x in range(0, columns, h):
            last = code_root(coder, job, y, x, h, last)
    for level in range(levels - 1, -1, -1):
        h = np.int64(1) << level
        for y in range(0, rows, 2 * h):
            for x in range(h, columns, 2 * h):
                last = code_between(coder, job, y, x, 0, h, level, last)
            if overrun(coder):
                return False
        for y in range(h, rows, 2 * h):
            for x in range(0, columns, h):
                last = code_between(coder, job, y, x, h, 0, level, last)
            if overrun(coder):
                return False
    return not overrun(coder)
