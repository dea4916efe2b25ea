# SPDX-License-Identifier: MIT
"""Coding of where in its cell the surface passes, compiled.

A cell's relief is the distance of the surface from the cell's center along the axis that its plane faces most,
in 2^bits levels of equal width across the cell. It is coded as ``1 + 8 axis + level``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.blocks import find_cell
from threedvc.kernels.coding.range_coder import (
    READING,
    Coder,
    clamp_probability,
    code_adaptive_bit,
    counter_probability,
    overrun,
)

__all__ = ["FLAT", "RELIEF_COUNTERS", "UNSET", "ReliefCells", "code_relief"]

UNSET = 0
"""Relief of a cell of which none was coded yet. All numbers here are part of the format (docs/coding.md)."""
FLAT = 255
"""Relief of a cell that spans no plane: its center."""
SIXTEENTHS = 16
"""Parts of a cell in which places are guessed: half a level of three bits is one."""
MAX_GUESS = 12
"""Largest guess, in sixteenths: beyond the cell's end at 8 only how sure the end is matters."""
GUESS_BINS = MAX_GUESS + 1
"""Classes of guesses, of two sixteenths."""
TOLD_BINS = 4
"""Classes by how many cells around are told: the more are, the surer is the guess."""
NODES = 8
"""Counters of the bits of a level, of three bits at most: one for each node of their tree."""
RELIEF_COUNTERS = GUESS_BINS * TOLD_BINS * NODES
COUNTER_LIMIT = 255
"""Bits that a counter remembers, as everywhere."""
MAX_HEIGHT = 24
"""Largest height of a neighbor, in sixteenths, that counts: what is one and a half cells off is another surface."""
TOLD_WEIGHT = 4
"""Weight of a neighbor that is told against one that is not, which stands for its center alone."""


class ReliefCells(NamedTuple):
    """Cells whose relief is to be coded, and the model they belong to.

    Attributes
    ----------
    cells, positions
        (n, 3) int32 in Morton order, and (n,) int64 where they are in the model.
    tables, occupied, planes
        Index of the model, (blocks * 512,) uint8, (blocks * 512, 4) int8.
    relief
        (blocks * 512,) uint8, updated.
    """

    cells: NDArray[np.int32]
    positions: NDArray[np.int64]
    tables: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]
    occupied: NDArray[np.uint8]
    planes: NDArray[np.int8]
    relief: NDArray[np.uint8]


@kernel
def facing_axis(plane: NDArray[np.int8]) -> int:
    """Return the axis that a plane (4,) faces most, the lowest of several, or -1 if it faces none."""
    axis, most = -1, np.int64(0)
    for k in range(3):
        size = abs(np.int64(plane[k]))
        if size > most:
            axis, most = k, size
    return axis


@kernel
def rounded_quotient(a: int, b: int) -> int:
    """Return a / b for b != 0, rounded to the nearest integer, halves up."""
    if b < 0:
        a, b = -a, -b
    return (2 * a + b) // (2 * b)


@kernel
def guess_relief(job: ReliefCells, n: int, axis: int, levels: int) -> tuple[int, int]:
    """Guess the relief of a cell from the cells around it, in sixteenths; return it and how many of them are told."""
    root_origin, root, supers = job.tables
    plane = job.planes[job.positions[n]]
    total, weight, told = np.int64(0), np.int64(0), np.int64(0)
    for k in range(27):
        other = np.int64(-1)
        if k != 13:
            other = np.int64(
                find_cell(
                    job.cells[n, 0] + k % 3 - 1,
                    job.cells[n, 1] + k // 3 % 3 - 1,
                    job.cells[n, 2] + k // 9 - 1,
                    root_origin,
                    root,
                    supers,
                )
            )
        if other < 0 or job.occupied[other] == 0:
            continue
        value = np.int64(job.relief[other])
        known = value != UNSET and value != FLAT
        away = np.int64(0)
        for a in range(3):
            place = SIXTEENTHS * (k // 3**a % 3 - 1)
            if known and (value - 1) >> 3 == a:
                place += (2 * ((value - 1) & 7) + 1 - levels) * (SIXTEENTHS // 2) // levels
            away += np.int64(plane[a]) * place
        height = rounded_quotient(away, np.int64(plane[axis]))
        if abs(height) > MAX_HEIGHT:
            continue
        w = np.int64(TOLD_WEIGHT if known else 1)
        total += w * height
        weight += w
        told += known
    if weight == 0:
        return np.int64(0), told
    return min(max(rounded_quotient(total, weight), -MAX_GUESS), MAX_GUESS), told


@kernel
def choose_level(wish: float, bits: int, counters: NDArray[np.uint32], first: int, price: float) -> int:
    """Return the level of least squared error, in cells, plus price times bits."""
    levels = np.int64(1) << bits
    best, least = np.int64(0), np.inf
    for level in range(levels):
        error = (2 * level + 1 - levels) / (2.0 * levels) - wish
        cost, node = error * error, np.int64(1)
        for place in range(bits - 1, -1, -1):
            bit = level >> place & 1
            odds = clamp_probability(counter_probability(counters[first + node])) / 65536.0
            cost -= price * np.log2(odds if bit else 1.0 - odds)
            node = 2 * node + bit
        if cost < least:
            best, least = np.int64(level), cost
    return best


@kernel
def code_relief(
    coder: Coder, job: ReliefCells, bits: int, wishes: NDArray[np.float32], price: float, counters: NDArray[np.uint32]
) -> bool:
    """Code the relief of cells; return False if the data end too early.

    Parameters
    ----------
    bits
        Binary logarithm of the number of levels, 1 to 3.
    wishes
        (n, 3) where the surface passes along each axis, in cells; of no meaning to a reader.
    price
        The writer's price of a bit, in squared cells.
    counters
        (RELIEF_COUNTERS,) uint32.
    """
    levels = np.int64(1) << bits
    for n in range(len(job.cells)):
        if overrun(coder):
            return False
        position = job.positions[n]
        axis = facing_axis(job.planes[position])
        if axis < 0:
            job.relief[position] = FLAT
            continue
        guess, told = guess_relief(job, n, axis, levels)
        first = (min((told + 1) >> 1, TOLD_BINS - 1) * GUESS_BINS + ((guess + MAX_GUESS) >> 1)) * NODES
        level = np.int64(0)
        if coder.state[READING] == 0:
            level = choose_level(np.float64(wishes[n, axis]), bits, counters, first, price)
        node = np.int64(1)
        for place in range(bits - 1, -1, -1):
            node = 2 * node + code_adaptive_bit(coder, level >> place & 1, counters, first + node, COUNTER_LIMIT)
        job.relief[position] = 1 + 8 * axis + (node - levels)
    return True
