# SPDX-License-Identifier: MIT
"""Prediction of depth from what is around a pixel and from the map ahead, compiled.

Depths are places in a table of values, in 64ths of a step. What is ahead is what the frames before predict: it has
values also where a picture is not coded yet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import inlined, kernel, lean

__all__ = [
    "BORDER",
    "NEAR_TAPS",
    "TAPS",
    "UNIT",
    "UNIT_BITS",
    "WEIGHT_BITS",
    "add_products",
    "around",
    "clipped",
    "place_ahead",
    "predicted",
]

BORDER = 3
"""Pixels around a picture that predictions reach. All numbers here but the last two are part of the
format (docs/coding.md)."""
NEAR_TAPS = BORDER + BORDER * (2 * BORDER + 1)
AHEAD_TAPS, BEFORE_TAPS = 11, 5
TAPS = NEAR_TAPS + AHEAD_TAPS + BEFORE_TAPS
"""Values that a prediction sums: three before in the row, seven in each of the three rows above, eleven of the map
ahead, which knows what comes later, too, and five of the frame before: some noise sticks to pixels, not to surfaces."""
WEIGHT_BITS = 9
"""Weights of them are in 1/512: a coarser step costs bits, a finer one bytes."""
UNIT_BITS = 6
UNIT = 1 << UNIT_BITS
"""Predictions are in 64ths of a step of the table: as finely as contexts tell them apart."""
REACH = 4 * UNIT
"""Neighbors that lie farther away than four steps count as four: they are on another surface."""
FIT_RANGE, FIT_ERROR = 6 * UNIT + 16, 2 * UNIT + 32
"""Pixels whose neighbors differ more, or that lie farther off, are at edges and tell nothing of the noise."""


@inlined
def clipped(value: int, limit: int) -> int:
    """Return a number, clamped to plus or minus a limit."""
    return min(max(value, -limit), limit)


@inlined
def around(levels: NDArray[np.int32], y: int, x: int) -> int:
    """Return the median of left, above, and both less the one left above."""
    left, above = np.int64(levels[y, x - 1]), np.int64(levels[y - 1, x])
    slant = left + above - levels[y - 1, x - 1]
    return max(min(left, above), min(max(left, above), slant))


@inlined
def predicted(
    levels: NDArray[np.int32],
    ahead: NDArray[np.int32],
    before: NDArray[np.int32],
    weights: NDArray[np.int64],
    y: int,
    x: int,
) -> int:
    """Return the weighted sum for a pixel; the arrays have the same border before it."""
    middle = around(levels, y, x)
    total = np.int64(1 << (WEIGHT_BITS - 1))
    for i in range(BORDER):
        total += clipped(levels[y, x - 1 - i] - middle, REACH) * weights[i]
    for j in range(BORDER):
        for i in range(2 * BORDER + 1):
            tap = BORDER + (2 * BORDER + 1) * j + i
            total += clipped(levels[y - 1 - j, x - BORDER + i] - middle, REACH) * weights[tap]
    for j in range(3):
        for i in range(3):
            total += clipped(ahead[y - 1 + j, x - 1 + i] - middle, REACH) * weights[NEAR_TAPS + 3 * j + i]
    total += clipped(ahead[y, x + 2] - middle, REACH) * weights[NEAR_TAPS + 9]
    total += clipped(ahead[y + 2, x] - middle, REACH) * weights[NEAR_TAPS + 10]
    total += clipped(before[y, x] - middle, REACH) * weights[TAPS - 5]
    total += clipped(before[y - 1, x] - middle, REACH) * weights[TAPS - 4]
    total += clipped(before[y, x - 1] - middle, REACH) * weights[TAPS - 3]
    total += clipped(before[y, x + 1] - middle, REACH) * weights[TAPS - 2]
    total += clipped(before[y + 1, x] - middle, REACH) * weights[TAPS - 1]
    return middle + (total >> WEIGHT_BITS)


@lean
def place_ahead(
    ahead: NDArray[np.int32],
    measured: NDArray[np.uint8],
    foretold: NDArray[np.uint16],
    places: NDArray[np.int32],
    levels: NDArray[np.int32],
    first: int,
    last: int,
) -> None:
    """Write rows first..last of what is ahead: the place of a foretold depth in the table, else the level before.

    `ahead` and `measured` have a border, `foretold` (0 = nothing) and `levels` have none; `measured` holds 0 and 1.
    """
    for y in range(first, last):
        for x in range(foretold.shape[1]):
            raw = foretold[y, x]
            if raw > 0:
                measured[y + BORDER, x + BORDER] |= 2
                ahead[y + BORDER, x + BORDER] = places[raw]
            else:
                ahead[y + BORDER, x + BORDER] = levels[y, x]


@kernel
def add_products(
    levels: NDArray[np.int32],
    ahead: NDArray[np.int32],
    before: NDArray[np.int32],
    present: NDArray[np.bool_],
    spacing: int,
    products: NDArray[np.int64],
    first: int,
    last: int,
) -> None:
    """Add, over every `spacing`-th pixel of rows first..last, the products of all taps and of the value itself.

    `products` is (TAPS + 1, TAPS + 1); of it what is right of and on the diagonal is added to. The arrays have a border
    but `present`.
    """
    taps = np.empty(TAPS + 1, dtype=np.int64)
    for row in range(first, last):
        for column in range(row * 7 % spacing, present.shape[1], spacing):
            if not present[row, column]:
                continue
            y, x = row + BORDER, column + BORDER
            middle = around(levels, y, x)
            spread = np.int64(0)
            for i in range(BORDER):
                taps[i] = levels[y, x - 1 - i] - middle
            for j in range(BORDER):
                for i in range(2 * BORDER + 1):
                    taps[BORDER + (2 * BORDER + 1) * j + i] = levels[y - 1 - j, x - BORDER + i] - middle
            for i in range(NEAR_TAPS):
                spread = max(spread, abs(taps[i]))
            for i in range(9):
                taps[NEAR_TAPS + i] = ahead[y - 1 + i // 3, x - 1 + i % 3] - middle
            taps[NEAR_TAPS + 9], taps[NEAR_TAPS + 10] = ahead[y, x + 2] - middle, ahead[y + 2, x] - middle
            taps[TAPS - 5], taps[TAPS - 4] = before[y, x] - middle, before[y - 1, x] - middle
            taps[TAPS - 3], taps[TAPS - 2] = before[y, x - 1] - middle, before[y, x + 1] - middle
            taps[TAPS - 1] = before[y + 1, x] - middle
            taps[TAPS] = levels[y, x] - middle
            if spread > FIT_RANGE or abs(taps[TAPS]) > FIT_ERROR:
                continue
            for i in range(TAPS):
                taps[i] = clipped(taps[i], REACH)
            for i in range(TAPS + 1):
                for j in range(i, TAPS + 1):
                    products[i, j] += taps[i] * taps[j]
