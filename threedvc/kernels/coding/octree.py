# SPDX-License-Identifier: MIT
"""Octrees over sorted Morton codes, level by level, compiled.

Nodes and children stand in Morton order (x lowest bit). Child `o` of a node lies at
``(o & 1, o >> 1 & 1, o >> 2)``. Offset number ``(dx + 1) + 3 (dy + 1) + 9 (dz + 1)`` names one of the
27 places around and at a node.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel

__all__ = [
    "BIT_COUNTS",
    "COORDINATE_BITS",
    "Level",
    "expand_children",
    "find_neighbors",
    "group_children",
    "interleave_bits",
    "separate_bits",
]

COORDINATE_BITS = 21
"""Bits of a coordinate, and greatest depth of a tree: three of them fit into a code of 63. Part of the format."""


class Level(NamedTuple):
    """The nodes of one level.

    Attributes
    ----------
    codes
        (n,) int64 Morton codes, ascending.
    masks
        (n,) uint8: bit `o` tells whether child `o` is there.
    first
        (n,) int32: index of the first child in the level below.
    """

    codes: NDArray[np.int64]
    masks: NDArray[np.uint8]
    first: NDArray[np.int32]


def _bit_counts() -> NDArray[np.int64]:
    return np.array([bin(k).count("1") for k in range(256)], dtype=np.int64)


def _neighbor_tables() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return, for each child and offset, the parent's offset and the child number of that place."""
    offset = np.zeros((8, 27), dtype=np.int64)
    child = np.zeros((8, 27), dtype=np.int64)
    for octant in range(8):
        for d in range(27):
            place = [(octant >> a & 1) + d // 3**a % 3 - 1 for a in range(3)]
            offset[octant, d] = sum((p // 2 + 1) * 3**a for a, p in enumerate(place))
            child[octant, d] = sum((p & 1) << a for a, p in enumerate(place))
    return offset, child


BIT_COUNTS = _bit_counts()
"""Ones in each byte."""
PARENT_OFFSET, CHILD_NUMBER = _neighbor_tables()
"""See `_neighbor_tables`."""


@kernel
def interleave_bits(cells: NDArray[np.int64], codes: NDArray[np.int64]) -> None:
    """Write the Morton codes of cells (n, 3) with coordinates within 0..2^21 - 1."""
    for i in range(len(cells)):
        code = np.int64(0)
        for axis in range(3):
            v = np.int64(cells[i, axis])
            v = (v | (v << 32)) & 0x1F00000000FFFF
            v = (v | (v << 16)) & 0x1F0000FF0000FF
            v = (v | (v << 8)) & 0x100F00F00F00F00F
            v = (v | (v << 4)) & 0x10C30C30C30C30C3
            v = (v | (v << 2)) & 0x1249249249249249
            code |= v << axis
        codes[i] = code


@kernel
def separate_bits(codes: NDArray[np.int64], cells: NDArray[np.int64]) -> None:
    """Write the cells (n, 3) of Morton codes; the inverse of `interleave_bits`."""
    for i in range(len(codes)):
        for axis in range(3):
            v = (codes[i] >> axis) & 0x1249249249249249
            v = (v | (v >> 2)) & 0x10C30C30C30C30C3
            v = (v | (v >> 4)) & 0x100F00F00F00F00F
            v = (v | (v >> 8)) & 0x1F0000FF0000FF
            v = (v | (v >> 16)) & 0x1F00000000FFFF
            v = (v | (v >> 32)) & 0x1FFFFF
            cells[i, axis] = v


@kernel
def group_children(codes: NDArray[np.int64], parents: Level) -> int:
    """Write the parents of sorted, distinct `codes`; return their number."""
    count = 0
    for i in range(len(codes)):
        parent = codes[i] >> 3
        if count == 0 or parents.codes[count - 1] != parent:
            parents.codes[count] = parent
            parents.masks[count] = 0
            parents.first[count] = i
            count += 1
        parents.masks[count - 1] |= 1 << (codes[i] & 7)
    return count


@kernel
def expand_children(level: Level, codes: NDArray[np.int64], parents: NDArray[np.int32]) -> None:
    """Write the codes of all children named by the masks, the index of each one's parent, and `level.first`."""
    count = 0
    for i in range(len(level.codes)):
        level.first[i] = count
        for octant in range(8):
            if level.masks[i] >> octant & 1:
                codes[count] = level.codes[i] << 3 | octant
                parents[count] = i
                count += 1


@kernel
def find_neighbors(level: Level, near: NDArray[np.int32], target: Level, child_near: NDArray[np.int32]) -> None:
    """Find the 27 places around every child of every node in the level below of a target tree.

    `near` (n, 27) holds the indices of the nodes' places in the target's level (-1: not there);
    `child_near` (children, 27) receives the same for the children, in order.
    """
    row = 0
    for i in range(len(level.masks)):
        for octant in range(8):
            if level.masks[i] >> octant & 1 == 0:
                continue
            for d in range(27):
                other = near[i, PARENT_OFFSET[octant, d]]
                index = np.int64(-1)
                if other >= 0:
                    child = CHILD_NUMBER[octant, d]
                    mask = np.int64(target.masks[other])
                    if mask >> child & 1:
                        index = target.first[other] + BIT_COUNTS[mask & ((1 << child) - 1)]
                child_near[row, d] = index
            row += 1
