# SPDX-License-Identifier: MIT
"""Colors of models whose stream has a color video in their place: gathered from its pictures as they come.

A pixel of a decoded picture colors the texel that its ray meets first in the models as they are drawn. Other
viewpoints, sizes and choices of objects are then drawn in these colors (docs/drawing.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.render.video_texture import GatheredTexels, SeenSurface, gather_colors, surface_texels
from threedvc.model.block_index import BLOCK_CELLS, BLOCK_SIDE, BlockIndex
from threedvc.model.texture import ColorGrid
from threedvc.parallel import for_ranges

__all__ = ["MAX_DEPTH_RATIO", "SCALES", "VideoTexture"]

SCALES = (2, 1)
"""Texels along an edge of a cell, the finest first: where the fine ones were not met, a coarse one tells. As the next
two, every reader must use it."""
MAX_COUNT = 256
"""Pixels in a texel's mean: more are halved, so that surfaces look as they did lately."""
MAX_DEPTH_RATIO = 1.05
"""Depths of neighboring pixels on one surface differ by less: 5 % within a pixel is a slope of 88 degrees."""


class VideoTexture:
    """Texels of one object at one scale, colored by the pictures so far.

    Parameters
    ----------
    texel_size_m
        Edge of a texel.

    Attributes
    ----------
    index
        Blocks of texels.
    """

    def __init__(self, texel_size_m: float) -> None:
        self.texel_size_m = texel_size_m
        self.index = BlockIndex()
        self._gathered = _no_texels(0)

    def add(self, seen: SeenSurface, picture: NDArray[np.uint8], threads: int) -> None:
        """Take colors from a picture (h, w, 3) of the color camera; `seen` is what it shows of the object."""
        texels = np.zeros((*seen.depth.shape, 3), dtype=np.int32)
        found = np.zeros(seen.depth.shape, dtype=np.bool_)

        def row_range(start: int, stop: int) -> None:
            surface_texels(start, stop, seen, texels, found)

        for_ranges(row_range, len(found), threads)
        if not found.any():
            return
        self.index.insert(np.unique(texels[found] // BLOCK_SIDE, axis=0))
        self._grow()
        gather_colors(texels, found, picture, MAX_COUNT, self.index.tables, self._gathered)

    def grid(self) -> ColorGrid:
        """Return the texels for the shading."""
        return ColorGrid(self.texel_size_m, self.index.tables, self._gathered.known, self._gathered.colors)

    def _grow(self) -> None:
        have, wanted = len(self._gathered.counts), self.index.count * BLOCK_CELLS
        if wanted > have:
            more = _no_texels(max(wanted, have * 3 // 2) - have)
            old = self._gathered
            self._gathered = GatheredTexels(
                sums=np.concatenate([old.sums, more.sums]),
                counts=np.concatenate([old.counts, more.counts]),
                colors=np.concatenate([old.colors, more.colors]),
                known=np.concatenate([old.known, more.known]),
            )


def _no_texels(count: int) -> GatheredTexels:
    return GatheredTexels(
        sums=np.zeros((count, 3), dtype=np.int32),
        counts=np.zeros(count, dtype=np.int32),
        colors=np.zeros((count, 3), dtype=np.int16),
        known=np.zeros(count, dtype=np.uint8),
    )
