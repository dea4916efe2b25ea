# SPDX-License-Identifier: MIT
"""A decoded model laid out for ray casting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.render.render_blocks import BORDERED_CELLS, build_block
from threedvc.model.block_index import BLOCK_CELLS, BLOCK_SIDE, BlockIndex
from threedvc.model.decoded_model import DecodedModel, shifted_blocks
from threedvc.model.texture import ColorGrid
from threedvc.parallel import for_ranges
from threedvc.render.video_texture import SCALES, VideoTexture

__all__ = ["RenderModel"]


class RenderModel:
    """A decoded model in the form that rays walk through; kept up to date by `refresh`.

    Attributes
    ----------
    textures
        Colors from the pictures of a color video, the finest first; none before there was one.
    """

    def __init__(self, model: DecodedModel) -> None:
        self.model = model
        self.index = BlockIndex()
        self.skip = np.zeros((0, BLOCK_CELLS), dtype=np.uint8)
        self.corners = np.zeros((0, BLOCK_CELLS), dtype=np.uint8)
        self.plane = np.zeros((0, BORDERED_CELLS, 4), dtype=np.int8)
        self.textures: tuple[VideoTexture, ...] = ()
        self._version = 0

    def video_textures(self) -> tuple[VideoTexture, ...]:
        """Return the textures that pictures of a color video fill, made when first asked for."""
        if not self.textures:
            self.textures = tuple(VideoTexture(self.model.voxel_size_m / scale) for scale in SCALES)
        return self.textures

    def color_grids(self) -> list[ColorGrid]:
        """Return where to look a color up, the finest first: a model under a color video has none of its own."""
        return [texture.grid() for texture in self.textures] or self.model.color_grids()

    def refresh(self, threads: int) -> None:
        """Rebuild the blocks around everything that changed since the last call."""
        model = self.model
        model.fit_planes(threads)
        changed, self._version = model.changed_since(self._version), model.version
        if not len(changed):
            return
        around = shifted_blocks(changed, (-1, 0, 1))
        here = around[model.index.locate(around * BLOCK_SIDE) >= 0]
        self._build(shifted_blocks(here, (-1, 0)), threads)

    def _build(self, blocks: NDArray[np.int32], threads: int) -> None:
        skip = np.empty((len(blocks), BLOCK_CELLS), dtype=np.uint8)
        corners = np.empty((len(blocks), BLOCK_CELLS), dtype=np.uint8)
        plane = np.empty((len(blocks), BORDERED_CELLS, 4), dtype=np.int8)
        targets = np.arange(len(blocks))
        model = self.model

        def block_range(start: int, stop: int) -> None:
            build_block(
                targets, blocks, start, stop, model.index.tables, model.occupied, model.planes, skip, corners,
                plane,
            )  # fmt: skip

        for_ranges(block_range, len(blocks), threads)
        keep = (skip == 0).any(axis=1) | (self.index.locate(blocks * BLOCK_SIDE) >= 0)
        self.index.insert(blocks[keep])
        self._grow()
        slots = self.index.locate(blocks[keep] * BLOCK_SIDE) // BLOCK_CELLS
        self.skip[slots], self.corners[slots], self.plane[slots] = skip[keep], corners[keep], plane[keep]

    def _grow(self) -> None:
        more = max(self.index.count, len(self.skip) * 3 // 2) - len(self.skip)
        if self.index.count <= len(self.skip):
            return
        for name in ("skip", "corners", "plane"):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.zeros((more, *array.shape[1:]), dtype=array.dtype)]))
