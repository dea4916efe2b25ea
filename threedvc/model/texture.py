# SPDX-License-Identifier: MIT
"""Texture: colors on a grid finer than that of the cells, along the surface that the decoder sees."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.model.block_index import BLOCK_CELLS, BLOCK_SIDE, BlockIndex, morton_keys

__all__ = ["ColorGrid", "Texture", "texels_of"]

MARGIN = 25
"""How far beyond touching it a texel may lie from the plane of its cell, in 1/254 texels: a tenth of one, as planes are
rounded. Part of the format (docs/coding.md)."""


class ColorGrid(NamedTuple):
    """Colored cells as the shading takes them.

    Attributes
    ----------
    cell_size_m
        Edge of a cell.
    tables
        Index of the cells, see `threedvc.kernels.blocks`.
    colored
        (cells,) uint8: whether a cell has a color.
    colors
        (cells, 3) int16 RGB.
    """

    cell_size_m: float
    tables: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]
    colored: NDArray[np.uint8]
    colors: NDArray[np.int16]


def texels_of(cells: NDArray[np.int32], planes: NDArray[np.int8], scale: int) -> NDArray[np.int32]:
    """Return the texels (m, 3) of cells (n, 3) in Morton order: those of `scale`^3 that the cell's plane passes.

    `planes` (n, 4) are those of `threedvc.kernels.render.render_blocks.fit_plane`; a cell without one has all its
    texels.
    """
    normal, offset = planes[:, :3].astype(np.int64), planes[:, 3].astype(np.int64)
    width = np.abs(normal).sum(axis=1)
    parts = []
    for place in np.ndindex(scale, scale, scale):
        distance = np.abs(normal @ (2 * np.array(place) + 1 - scale) - 2 * scale * offset)
        met = (distance <= width + 2 * MARGIN) | (width == 0)
        parts.append(cells[met] * np.int32(scale) + np.array(place, dtype=np.int32))
    texels = np.concatenate(parts)
    return texels[np.argsort(morton_keys(texels), kind="stable")]


class Texture:
    """Texels of one object that have a color.

    Parameters
    ----------
    scale
        Texels along an edge of a cell.
    """

    def __init__(self, scale: int) -> None:
        self.scale = scale
        self.index = BlockIndex()
        self.known = np.zeros((0, BLOCK_CELLS), dtype=np.uint8)
        self.color = np.zeros((0, BLOCK_CELLS, 3), dtype=np.int16)

    def texels(self) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
        """Return the texels (n, 3) in Morton order and their colors (n, 3)."""
        texels, positions = self.index.flagged(self.known[: self.index.count])
        return texels, self.color.reshape(-1, 3)[positions]

    def paint(self, texels: NDArray[np.int32], colors: NDArray[np.int16]) -> None:
        """Give texels (n, 3) their colors (n, 3)."""
        self.index.insert(texels // BLOCK_SIDE)
        if self.index.count > len(self.known):
            more = max(self.index.count, len(self.known) * 3 // 2) - len(self.known)
            self.known = np.concatenate([self.known, np.zeros((more, BLOCK_CELLS), dtype=np.uint8)])
            self.color = np.concatenate([self.color, np.zeros((more, BLOCK_CELLS, 3), dtype=np.int16)])
        positions = self.index.locate(texels)
        self.known.reshape(-1)[positions] = 1
        self.color.reshape(-1, 3)[positions] = colors

    def erase(self, cells: NDArray[np.int32]) -> None:
        """Forget the texels of cells (n, 3)."""
        for place in np.ndindex(self.scale, self.scale, self.scale):
            positions = self.index.locate(cells * np.int32(self.scale) + np.array(place, dtype=np.int32))
            positions = positions[positions >= 0]
            self.known.reshape(-1)[positions] = 0
            self.color.reshape(-1, 3)[positions] = 0

    def grid(self, cell_size_m: float) -> ColorGrid:
        """Return the texels of cells of an edge for the shading."""
        size = cell_size_m / self.scale
        return ColorGrid(size, self.index.tables, self.known.reshape(-1), self.color.reshape(-1, 3))
