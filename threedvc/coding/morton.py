# SPDX-License-Identifier: MIT
"""Morton order of cells and the cube that holds them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.coding.octree import COORDINATE_BITS, interleave_bits, separate_bits

__all__ = ["MAX_COORDINATE", "Cube", "cells_of_codes", "morton_codes", "morton_order"]

MAX_COORDINATE = 1 << (COORDINATE_BITS - 1)
"""Cells lie within this on either side of the origin. Part of the format."""


def morton_codes(cells: NDArray[np.int32], origin: tuple[int, int, int] | None = None) -> NDArray[np.int64]:
    """Return the Morton codes (n,) of cells (n, 3) relative to `origin`, by default (-2^20, -2^20, -2^20)."""
    start = np.array(origin if origin is not None else (-MAX_COORDINATE,) * 3, dtype=np.int64)
    codes = np.empty(len(cells), dtype=np.int64)
    interleave_bits(cells.astype(np.int64) - start, codes)
    return codes


def cells_of_codes(codes: NDArray[np.int64], origin: tuple[int, int, int]) -> NDArray[np.int32]:
    """Return the cells (n, 3) of Morton codes relative to `origin`."""
    cells = np.empty((len(codes), 3), dtype=np.int64)
    separate_bits(codes, cells)
    return (cells + np.array(origin, dtype=np.int64)).astype(np.int32)


def morton_order(cells: NDArray[np.int32]) -> NDArray[np.intp]:
    """Return the permutation that brings cells (n, 3) into Morton order."""
    return np.argsort(morton_codes(cells), kind="stable")


@dataclass(frozen=True)
class Cube:
    """Two by two by two cubes of edge ``2^(depth - 1)`` cells, the first at a multiple of that edge.

    Eight cubes instead of one let a small set of cells have a shallow tree wherever it lies.
    """

    depth: int
    corner: tuple[int, int, int]

    @classmethod
    def around(cls, *cell_sets: NDArray[np.int32]) -> Self:
        """Return the smallest cube around all cells of some sets (n, 3)."""
        if not any(len(cells) for cells in cell_sets):
            return cls(1, (0, 0, 0))
        low = np.min([cells.min(axis=0) for cells in cell_sets if len(cells)], axis=0).astype(np.int64)
        high = np.max([cells.max(axis=0) for cells in cell_sets if len(cells)], axis=0).astype(np.int64)
        bits = int((high - low).max()).bit_length()
        corner = low >> bits
        return cls(bits + 1, (int(corner[0]), int(corner[1]), int(corner[2])))

    @property
    def origin(self) -> tuple[int, int, int]:
        """The lowest cell."""
        edge = 1 << (self.depth - 1)
        return (self.corner[0] * edge, self.corner[1] * edge, self.corner[2] * edge)

    def contains(self, cells: NDArray[np.int32]) -> bool:
        """Tell whether all cells (n, 3) lie inside."""
        start = np.array(self.origin, dtype=np.int64)
        return bool(np.all((cells >= start) & (cells < start + (1 << self.depth))))
