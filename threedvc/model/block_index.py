# SPDX-License-Identifier: MIT
"""The two-level index that makes a tessellation block-sparse.

Only blocks of 8x8x8 cells that something was seen in have storage. The root array has one entry for
a superblock of 64x64x64 cells, so it stays small over a whole building.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import LimitExceeded
from threedvc.kernels.blocks import BLOCK_CELLS, BLOCK_SIDE, fill_slots, gather_cells, locate_cells

__all__ = ["BLOCK_CELLS", "BLOCK_SIDE", "CELL_LIMIT", "BlockIndex", "morton_keys"]

CELL_LIMIT = 1 << 20
"""Cells lie within this on either side of the origin: three coordinates fit into a Morton key. Part of the format."""
ROOT_LIMIT = 1 << 24
"""Superblocks in the bounding box: 64 MiB of root."""
BLOCK_LIMIT = 1 << 18
"""Blocks of an index: some gigabytes of evidence."""


def morton_keys(cells: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the Morton keys (n,) of cells (n, 3) within +-2^20; x has the lowest bit."""
    key = np.zeros(len(cells), dtype=np.int64)
    for axis in range(3):
        v = cells[:, axis].astype(np.int64) + CELL_LIMIT
        v = (v | v << 32) & 0x1F00000000FFFF
        v = (v | v << 16) & 0x1F0000FF0000FF
        v = (v | v << 8) & 0x100F00F00F00F00F
        v = (v | v << 4) & 0x10C30C30C30C30C3
        v = (v | v << 2) & 0x1249249249249249
        key |= v << axis
    return key


class BlockIndex:
    """Numbers blocks in the order in which they come.

    Attributes
    ----------
    coords
        (capacity, 3) int32 block coordinates; the first `count` rows are in use.
    root_origin, root, supers
        The index as the kernels take it, see `threedvc.kernels.blocks`.
    """

    def __init__(self) -> None:
        self.count = 0
        self.coords = np.zeros((64, 3), dtype=np.int32)
        self.root_origin = np.zeros(3, dtype=np.int64)
        self.root = np.full((1, 1, 1), -1, dtype=np.int32)
        self.supers = np.full((4, BLOCK_CELLS), -1, dtype=np.int32)
        self._super_count = 0

    @property
    def tables(self) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
        """Return the three arrays that every kernel takes."""
        return self.root_origin, self.root, self.supers

    def insert(self, blocks: NDArray[np.int32]) -> int:
        """Give storage to blocks (n, 3) that have none yet; return how many were new.

        Raises
        ------
        LimitExceeded
            If a block is out of range, the blocks lie too far apart, or there are too many.
        """
        if not len(blocks):
            return 0
        if np.abs(blocks.astype(np.int64)).max() >= CELL_LIMIT // BLOCK_SIDE:
            raise LimitExceeded(
                "a cell lies further than 2^20 cells from the origin; use larger cells or a maximum depth"
            )
        blocks = np.unique(blocks, axis=0)
        new = blocks[self.locate(blocks * BLOCK_SIDE) < 0]
        if not len(new):
            return 0
        if self.count + len(new) > BLOCK_LIMIT:
            raise LimitExceeded(
                f"a model of more than {BLOCK_LIMIT} blocks of 8x8x8 cells is too large; use larger cells"
            )
        new = new[np.argsort(morton_keys(new), kind="stable")]
        supers = np.unique(new >> 3, axis=0)
        self._cover(supers)
        self._reserve(len(new), int(np.count_nonzero(self.root[tuple((supers - self.root_origin).T)] < 0)))
        self.coords[self.count : self.count + len(new)] = new
        self._super_count = fill_slots(new, self.count, *self.tables, self._super_count)
        self.count += len(new)
        return len(new)

    def locate(self, cells: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return positions (n,) of cells (n, 3) in arrays of ``count * 512`` entries; -1 where absent."""
        positions = np.empty(len(cells), dtype=np.int64)
        locate_cells(np.ascontiguousarray(cells), *self.tables, positions)
        return positions

    def flagged(self, flags: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """Return cells (n, 3) and positions (n,) where `flags` (count, 512) is set, in Morton order."""
        cells = np.empty((int(np.count_nonzero(flags)), 3), dtype=np.int32)
        positions = np.empty(len(cells), dtype=np.int64)
        gather_cells(flags, self.coords, cells, positions)
        order = np.argsort(morton_keys(cells), kind="stable")
        return cells[order], positions[order]

    def _cover(self, supers: NDArray[np.int32]) -> None:
        low, high = supers.min(axis=0).astype(np.int64), supers.max(axis=0).astype(np.int64) + 1
        if self.count:
            low = np.minimum(low, self.root_origin)
            high = np.maximum(high, self.root_origin + self.root.shape)
        shape = high - low
        if np.array_equal(low, self.root_origin) and np.array_equal(shape, self.root.shape):
            return
        if int(np.prod(shape.astype(object))) > ROOT_LIMIT:
            raise LimitExceeded(f"cells lie {shape.max() * 64} cells apart; use larger cells or a maximum depth")
        root = np.full(shape, -1, dtype=np.int32)
        if self.count:
            x, y, z = self.root_origin - low
            nx, ny, nz = self.root.shape
            root[x : x + nx, y : y + ny, z : z + nz] = self.root
        self.root_origin, self.root = low, root

    def _reserve(self, blocks: int, supers: int) -> None:
        if self.count + blocks > len(self.coords):
            grown = np.zeros((max(self.count + blocks, len(self.coords) * 2), 3), dtype=np.int32)
            grown[: self.count] = self.coords[: self.count]
            self.coords = grown
        if self._super_count + supers > len(self.supers):
            more = max(self._super_count + supers, len(self.supers) * 2) - len(self.supers)
            self.supers = np.concatenate([self.supers, np.full((more, BLOCK_CELLS), -1, dtype=np.int32)])
