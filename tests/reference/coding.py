# SPDX-License-Identifier: MIT
"""Slow, obvious versions of the coding kernels: exact arithmetic, dictionaries of cells, floats."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

Cell = tuple[int, int, int]

TOP = 1 << 32
BOTTOM = 1 << 24


class ExactCoder:
    """A range coder whose low end is one number of any length: no carries to think about."""

    def __init__(self) -> None:
        self.low, self.width, self.shifts = 0, TOP - 1, 0

    def write(self, bit: int, probability: int) -> None:
        """Narrow the interval; ones stand at its lower end."""
        bound = self.width * probability >> 16
        if bit:
            self.width = bound
        else:
            self.low += bound
            self.width -= bound
        while self.width < BOTTOM:
            self.low, self.width, self.shifts = self.low << 8, self.width << 8, self.shifts + 1

    def finish(self) -> bytes:
        """Return the shortest bytes that, followed by zeros, name a point of the interval."""
        for count in range(5):
            unit = 1 << (32 - 8 * count)
            value = -(-self.low // unit) * unit
            if value < self.low + self.width:
                return (value // unit).to_bytes(self.shifts + count, "big")
        raise AssertionError("no point of the interval found")


class ExactCounter:
    """A probability in 1 / 2^22 that moves by 1 / (n + 1.5)."""

    def __init__(self) -> None:
        self.value, self.seen = 1 << 21, 0

    @property
    def probability(self) -> int:
        """Of 65536, kept off both ends by 32."""
        return min(max(self.value >> 6, 32), 65504)

    def adapt(self, bit: int, limit: int) -> None:
        """Move towards a bit."""
        target = (1 << 22) - 1 if bit else 0
        self.value += (target - self.value) * (2 * 65536 // (2 * self.seen + 3)) >> 16
        self.seen = min(self.seen + 1, limit)


def write_number(coder: ExactCoder, counters: dict[int, ExactCounter], value: int, limit: int) -> None:
    """Write a number in adaptive Exp-Golomb form."""
    bits = bin(value + 1)[2:]

    def adaptive(bit: int, place: int) -> None:
        counter = counters.setdefault(place, ExactCounter())
        coder.write(bit, counter.probability)
        counter.adapt(bit, limit)

    for place in range(len(bits) - 1):
        adaptive(1, place)
    if len(bits) - 1 < 31:
        adaptive(0, len(bits) - 1)
    if len(bits) > 1:
        adaptive(int(bits[1]), 32 + len(bits) - 1)
    for bit in bits[2:]:
        coder.write(int(bit), 1 << 15)


def morton_code(cell: Cell) -> int:
    """Interleave the bits of three numbers, those of x lowest."""
    return sum((cell[axis] >> bit & 1) << (3 * bit + axis) for bit in range(21) for axis in range(3))


def nodes_at(cells: set[Cell], height: int) -> set[Cell]:
    """Return the nodes that hold any of the cells; height 0 are the cells."""
    return {(x >> height, y >> height, z >> height) for x, y, z in cells}


def around(cell: Cell, reach: int) -> Iterator[tuple[int, Cell]]:
    """Yield number and coordinates of the places in the cube about a cell, x fastest."""
    side = range(-reach, reach + 1)
    for number, (dz, dy, dx) in enumerate(product(side, side, side)):
        yield number, (cell[0] + dx, cell[1] + dy, cell[2] + dz)


def orthonormal_energy(values: dict[Cell, float]) -> tuple[float, float]:
    """Return the sums of squares of the coefficients of the transform in floats, and of the values.

    Pairs along x, then y, then z, then the next level; a pair of weights a, b gives the coefficient
    ``(v2 - v1) sqrt(a b / (a + b))``.
    """
    total = sum(v * v for v in values.values())
    nodes = {cell: (value, 1.0) for cell, value in values.items()}
    energy = 0.0
    while len(nodes) > 1 or any(any(cell) for cell in nodes):
        for axis in range(3):
            merged: dict[Cell, tuple[float, float]] = {}
            for cell in sorted(nodes):
                value, weight = nodes[cell]
                parent = tuple(v >> 1 if k == axis else v for k, v in enumerate(cell))
                if parent in merged:
                    other, share = merged[parent]  # type: ignore[index]
                    energy += (value - other) ** 2 * weight * share / (weight + share)
                    value = (value * weight + other * share) / (weight + share)
                    weight += share
                merged[parent] = (value, weight)  # type: ignore[index]
            nodes = merged
    value, weight = next(iter(nodes.values()))
    return energy + weight * value * value, total


def quaternion_matrix(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (4, 4) matrix of left multiplication by a quaternion w, x, y, z."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
