# SPDX-License-Identifier: MIT
"""Coding of measured depth, pixel by pixel, in slices of rows, compiled.

A depth is the number of a value in a sorted table. Every pixel is predicted by a weighted sum of values around it and
of the map that the frames before predict; whether there is a value, and how far it lies from the prediction, is coded
in mixed contexts. A writer may choose among several values for a pixel; a reader need not know why it took one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import inlined, kernel, lean
from threedvc.kernels.coding.depth_prediction import BORDER, UNIT, UNIT_BITS, around, clipped, predicted
from threedvc.kernels.coding.mixing import hash_pair, squash, stretch
from threedvc.kernels.coding.range_coder import (
    READING,
    Coder,
    adapted_counter,
    clamp_probability,
    code_adaptive_bit,
    code_bit,
    code_number,
    overrun,
)

__all__ = [
    "MASK_ROWS",
    "MODELS",
    "STEP_ROWS",
    "Blend",
    "DepthSlice",
    "DepthTable",
    "SliceModels",
    "code_slice",
]

MODELS = 6
"""Contexts of a decision. All numbers here are part of the format (docs/coding.md)."""
MASK_ROWS, STEP_ROWS = 512, 224
"""Rows of weights of whether there is a value, and of the steps from the prediction."""
RATE, RATE_SHIFT = 6, 18
"""Rate at which weights learn, a numerator and a shift: half of that of other payloads, which are shorter."""
KINDS = 14
"""Kinds of decisions about steps: none; back or forth; one more, by how many there are and their direction."""
MAX_UNARY = 19
"""Steps that are coded one by one; the rest of larger numbers is coded as a number."""
MAX_MISS = 15
"""Steps that a pixel counts for at most in the activity around others."""
COUNTER_LIMIT = 255
"""Bits that a counter remembers, as everywhere."""


class DepthTable(NamedTuple):
    """The values that may be coded, and the writer's choice among them.

    Attributes
    ----------
    size
        Number of values; they have numbers from 1 on.
    lowest, highest
        (65536,) int32 first and last number that may stand for a raw depth; of no meaning to a reader.
    stride
        The writer keeps to steps that are multiples of it where it may; 1 takes the middle of what may be.
    memory
        How much of a prediction, in 64ths of a step, outlasts a value coded: a value alone is rounded.
    """

    size: int
    lowest: NDArray[np.int32]
    highest: NDArray[np.int32]
    stride: int
    memory: int


class Blend(NamedTuple):
    """Models of one kind of decision: mixing as in `mixing`, of a fixed number of contexts and two sets of weights.

    In one piece it takes a third of the time: a call counts the references of every array.

    Attributes
    ----------
    tables
        (MODELS, 2^k) uint32 counters.
    weights
        (2, rows, MODELS + 1) int32 in units of 1 / 65536.
    contexts
        (MODELS,) int64 hashes, set before each decision.
    inputs
        (MODELS + 1,) int64 log-odds; the last is constant.
    """

    tables: NDArray[np.uint32]
    weights: NDArray[np.int32]
    contexts: NDArray[np.int64]
    inputs: NDArray[np.int64]


class SliceModels(NamedTuple):
    """What adapts while a slice is coded; it goes on from frame to frame.

    Attributes
    ----------
    mask, steps
        Mixers of whether there is a value, and of the steps.
    certain
        (2,) uint32 counters of the first where all around agree.
    rest
        (NUMBER_COUNTERS,) uint32 of large numbers of steps.
    """

    mask: Blend
    steps: Blend
    certain: NDArray[np.uint32]
    rest: NDArray[np.uint32]


class DepthSlice(NamedTuple):
    """Rows of a frame, all arrays but the first with a border.

    Attributes
    ----------
    wishes
        (rows, columns) uint16 raw depths; of no meaning to a reader.
    numbers
        (rows + 3, columns + 6) int32 numbers as coded, 0 = no value; three rows above, three columns on either side.
    levels
        The same shape, int32: values or what stands for them, in 64ths of a step.
    misses
        The same shape, int32: steps from the prediction.
    ahead
        (rows + 6, columns + 6) int32 what the frames before predict, in 64ths of a step.
    before
        The same shape, int32: the levels of the frame before.
    measured
        The same shape, uint8: 1 where the frame before has a value, 2 more where it says what comes here.
    weights
        (TAPS,) int64 of the prediction.
    first
        1 in a frame that nothing comes before.
    """

    wishes: NDArray[np.uint16]
    numbers: NDArray[np.int32]
    levels: NDArray[np.int32]
    misses: NDArray[np.int32]
    ahead: NDArray[np.int32]
    before: NDArray[np.int32]
    measured: NDArray[np.uint8]
    weights: NDArray[np.int64]
    first: int


@inlined
def code_blended(coder: Coder, bit: int, blend: Blend, row: int, other: int) -> int:
    """Code a bit whose contexts are set, with two rows of weights, and learn from it."""
    tables, weights, contexts, inputs = blend.tables, blend.weights, blend.contexts, blend.inputs
    size = tables.shape[1]
    one = inputs[MODELS] * weights[0, row, MODELS]
    two = inputs[MODELS] * weights[1, other, MODELS]
    for k in range(MODELS):
        at = (contexts[k] >> 8) & (size - 1)
        contexts[k] = at
        counter = np.int64(tables[k, at])
        value = stretch(counter >> 16) if counter & 1023 else np.int64(0)
        inputs[k] = value
        one += value * weights[0, row, k]
        two += value * weights[1, other, k]
    one >>= 16
    two >>= 16
    bit = code_bit(coder, bit, clamp_probability(squash((one + two) >> 1)))
    sign = np.int64(bit) * 65535
    miss, miss_too = (sign - squash(one)) * RATE, (sign - squash(two)) * RATE
    for k in range(MODELS + 1):
        weights[0, row, k] += (inputs[k] * miss + (1 << (RATE_SHIFT - 1))) >> RATE_SHIFT
        weights[1, other, k] += (inputs[k] * miss_too + (1 << (RATE_SHIFT - 1))) >> RATE_SHIFT
    for k in range(MODELS):
        tables[k, contexts[k]] = adapted_counter(np.int64(tables[k, contexts[k]]), bit, COUNTER_LIMIT)
    return bit


@inlined
def step_class(difference: int) -> int:
    """Return a difference in whole steps, clamped to two on either side, as 0..4."""
    return clipped((difference + UNIT // 2) >> UNIT_BITS, 2) + 2


@inlined
def fine_class(difference: int) -> int:
    """Return one of 17 classes of a difference, narrow ones about zero."""
    size = abs(difference)
    if size <= 40:
        found = 0 if size <= 8 else (1 if size <= 24 else 2)
    elif size <= 160:
        found = 3 if size <= 64 else (4 if size <= 96 else 5)
    else:
        found = 6 if size <= 320 else (7 if size <= 800 else 8)
    return 8 + found if difference >= 0 else 8 - found


@inlined
def activity(misses: NDArray[np.int32], y: int, x: int) -> int:
    """Return one of eight classes of the steps around."""
    total = 2 * min(misses[y, x - 1], 7) + 2 * min(misses[y - 1, x], 7) + min(misses[y - 1, x + 1], 7)
    total += min(misses[y - 1, x - 1], 7) + min(misses[y, x - 2], 7) + min(misses[y - 2, x], 7)
    if total < 4:
        return total
    if total < 9:
        return 4 if total < 6 else 5
    return 6 if total < 16 else 7


@inlined
def code_presence(coder: Coder, models: SliceModels, wish: int, near: int, before: int, x: int) -> int:
    """Code whether a pixel has a value.

    `near` has a bit for each of seven neighbors that have one, `before` nine bits of the frame before and one more if
    it says what comes here.
    """
    says = before >> 9
    if (near == 127 and before == 1023) or (near == 0 and before == 0):
        return code_adaptive_bit(coder, wish, models.certain, near & 1, COUNTER_LIMIT)
    blend = models.mask
    middle = before >> 4 & 1
    blend.contexts[0] = hash_pair(near, says)
    blend.contexts[1] = hash_pair(near & 15, before & 511)
    blend.contexts[2] = hash_pair(near & 15, x >> 3)
    blend.contexts[3] = hash_pair(near, before & 63)
    blend.contexts[4] = hash_pair(near, (before >> 7 & 1) * 8 + (before >> 5 & 1) * 4 + 2 * middle + says)
    blend.contexts[5] = hash_pair(near, before & 511)
    return code_blended(coder, wish, blend, near, before & 511)


@inlined
def code_step(
    coder: Coder,
    blend: Blend,
    job: DepthSlice,
    y: int,
    x: int,
    place: int,
    fraction: int,
    noise: int,
    kind: int,
    bit: int,
) -> int:
    """Code one decision of a pixel at (y, x) about `place`, a value in 64ths of a step, with contexts around it.

    `fraction`, 0..63, tells where within a step the prediction lies, `noise` how active it is around.
    """
    levels, ahead = job.levels, job.ahead
    left, above = step_class(levels[y, x - 1] - place), step_class(levels[y - 1, x] - place)
    corner, right = step_class(levels[y - 1, x - 1] - place), step_class(levels[y - 1, x + 1] - place)
    before, over = step_class(levels[y, x - 2] - place), step_class(levels[y - 2, x] - place)
    both = kind * 25 + left * 5 + above
    guess = fine_class(ahead[y, x] - place)
    slope = fine_class(2 * levels[y, x - 1] - levels[y, x - 2] - place)
    contexts = blend.contexts
    contexts[0] = hash_pair((both * 5 + corner) * 5 + right, before * 5 + over)
    contexts[1] = hash_pair(
        (both * 5 + right) * 5 + step_class(levels[y - 1, x + 2] - place),
        step_class(levels[y - 2, x + 1] - place) * 5 + over,
    )
    contexts[2] = hash_pair(both * 5 + right, guess * 4 + (job.measured[y, x] & 2) + (fraction >> 5))
    contexts[3] = hash_pair(kind, (place >> UNIT_BITS) * 8 + (fraction >> 3))
    contexts[4] = hash_pair(
        (both * 5 + corner) * 5 + before,
        step_class(levels[y, x - 3] - place) * 5 + step_class(levels[y - 1, x - 2] - place),
    )
    contexts[5] = hash_pair(kind * UNIT + fraction, fine_class(around(levels, y, x) - place) * 17 + slope)
    return code_blended(coder, bit, blend, kind * 8 + noise, kind * 16 + (fraction >> 2))


@inlined
def wanted_steps(table: DepthTable, raw: int, nearest: int) -> int:
    """Return the steps from number `nearest` that a writer takes for a raw depth."""
    low, high = np.int64(table.lowest[raw]) - nearest, np.int64(table.highest[raw]) - nearest
    if low <= 0 <= high:
        return np.int64(0)
    stride = min(high - low + 1, np.int64(table.stride))
    steps = (low + high + stride) // (2 * stride) * stride
    return min(max(steps, low), high)


@inlined
def code_steps(
    coder: Coder, models: SliceModels, job: DepthSlice, y: int, x: int, guess: int, steps: int, last: int
) -> int:
    """Code how many steps a value lies from the prediction `guess`; return it, or more than `last` if it cannot be."""
    nearest = (guess + UNIT // 2) >> UNIT_BITS
    place = nearest << UNIT_BITS
    fraction, noise = guess - place + UNIT // 2, activity(job.misses, y, x)
    size, back, count, towards, kind = abs(steps), np.int64(0), np.int64(0), np.int64(0), np.int64(0)
    bit = np.int64(1 if steps != 0 else 0)
    # First whether there are any, then where to, then whether there is one more: in one loop, so that the contexts
    # are compiled once.
    while True:
        bit = code_step(coder, models.steps, job, y, x, place + count * towards, fraction, noise, kind, bit)
        if kind == 0 and bit == 1:
            kind, bit = np.int64(1), np.int64(1 if steps < 0 else 0)
            continue
        if kind == 1:
            back, towards = bit, np.int64(-UNIT if bit == 1 else UNIT)
        elif bit == 0:
            break
        count += 1
        if count > MAX_UNARY:
            count += code_number(coder, size - count, models.rest, 0, COUNTER_LIMIT)
            break
        kind, bit = 2 * min(count + 1, KINDS // 2) - 2 + back, np.int64(1 if size > count else 0)
    if count > (nearest - 1 if back == 1 else last - nearest):
        return last + 1
    return -count if back == 1 else count


@lean
def code_row(coder: Coder, models: SliceModels, job: DepthSlice, table: DepthTable, y: int) -> bool:
    """Code a row; `y` counts the border. Return False if a value is not in the table."""
    numbers, levels, measured = job.numbers, job.levels, job.measured
    width = job.wishes.shape[1]
    reading = coder.state[READING] == 1
    steps, wish = np.int64(0), np.int64(0)
    for x in range(BORDER, BORDER + width):
        near = (
            (1 if numbers[y, x - 1] > 0 else 0)
            | (2 if numbers[y - 1, x] > 0 else 0)
            | (4 if numbers[y - 1, x - 1] > 0 else 0)
            | (8 if numbers[y - 1, x + 1] > 0 else 0)
            | (16 if numbers[y, x - 2] > 0 else 0)
            | (32 if numbers[y - 2, x] > 0 else 0)
            | (64 if numbers[y - 1, x + 2] > 0 else 0)
        )
        before = np.int64(measured[y, x] >> 1)
        for j in range(-1, 2):
            for i in range(-1, 2):
                before = (before << 1) | (measured[y + j, x + i] & 1)
        if job.first == 1 and y == BORDER:
            guess = np.int64(levels[y, x - 1])
        else:
            guess = predicted(levels, job.ahead, job.before, job.weights, y, x)
        guess = min(max(guess, np.int64(UNIT)), table.size * UNIT)
        if not reading:
            wish = np.int64(job.wishes[y - BORDER, x - BORDER])
        if code_presence(coder, models, 1 if wish > 0 else 0, near, before, x - BORDER) == 0:
            levels[y, x], job.misses[y, x], numbers[y, x] = guess, 1, 0
            continue
        nearest = (guess + UNIT // 2) >> UNIT_BITS
        if not reading:
            steps = wanted_steps(table, wish, nearest)
        steps = code_steps(coder, models, job, y, x, guess, steps, table.size)
        if steps > table.size:
            return False
        number = nearest + steps
        numbers[y, x], job.misses[y, x] = number, min(abs(steps), np.int64(MAX_MISS))
        levels[y, x] = number * UNIT + clipped(guess - number * UNIT, table.memory)
    return True


@kernel
def code_slice(coder: Coder, models: SliceModels, job: DepthSlice, table: DepthTable) -> bool:
    """Code the rows of a slice; return False if the data end too early or hold what is not in the table."""
    rows, width = job.wishes.shape
    levels = job.levels
    levels[:BORDER] = job.ahead[:BORDER]
    for y in range(BORDER, BORDER + rows):
        levels[y, :BORDER] = levels[y - 1, BORDER]
        if not code_row(coder, models, job, table, y) or overrun(coder):
            return False
        levels[y, BORDER + width :] = levels[y, BORDER + width - 1]
        if job.first == 1 and y == BORDER:
            for above in range(BORDER):
                levels[above] = levels[y]
    return True
