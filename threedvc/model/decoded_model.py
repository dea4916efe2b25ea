# SPDX-License-Identifier: MIT
"""The model Gamma of one rigid object (sec. 2.1), as the decoder holds it and as the encoder does.

`DecodedModel` is what the stream has conveyed: integers alone, changed by `apply` only, equal on
both sides bit by bit. `EvidenceModel` is the encoder's: for every cell the distributions of
occupancy (log-odds, 0 = equiprobable), of the surface's signed distance (Gaussian) and of color
(Gaussian per channel).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import CorruptStream
from threedvc.kernels.coding.relief import UNSET
from threedvc.kernels.render.render_blocks import fit_planes
from threedvc.model.block_index import BLOCK_CELLS, BLOCK_SIDE, BlockIndex
from threedvc.model.model_update import ModelUpdate
from threedvc.model.texture import ColorGrid, Texture, texels_of
from threedvc.parallel import for_ranges
from threedvc.stream.wire import DIGEST_BYTES

__all__ = ["DecodedModel", "models_digest", "shifted_blocks"]

PLANE_WEIGHTS = np.array([0.25, 0.75, 1.0, 0.75, 0.25])
"""Weights of cells in the fit of a plane by their distance along each axis (decision 0003). Every reader must use
them."""


def shifted_blocks(blocks: NDArray[np.int32], shifts: tuple[int, ...]) -> NDArray[np.int32]:
    """Return the distinct blocks reached from `blocks` (n, 3) by any combination of shifts."""
    offsets = np.array([(x, y, z) for x in shifts for y in shifts for z in shifts], dtype=np.int32)
    return np.unique((blocks[:, None] + offsets).reshape(-1, 3), axis=0)


class DecodedModel:
    """Occupied cells and their colors: the MAP read-out that was sent.

    Attributes
    ----------
    voxel_size_m
        Edge of a cell.
    index
        Blocks.
    occupied
        (blocks, 512) uint8.
    color
        (blocks, 512, 3) int16 RGB; 0 in empty cells.
    guessed
        Whether its shape is a guess, drawn in color only and behind all others.
    passing
        Whether it stands for things that are there for a moment.
    planes
        (blocks, 512, 4) int8 planes of the occupied cells, as of the last call of `fit_planes`.
    relief
        (blocks, 512) uint8: where in the occupied cells the surface passes, see `threedvc.kernels.coding.relief`.
    relief_bits
        Binary logarithm of the places in a cell that it may pass; 0: it passes through the centers.
    texture
        Colors of parts of cells, or None for an object without.
    version
        Number of changes so far.
    """

    def __init__(
        self,
        voxel_size_m: float,
        texture_scale: int = 1,
        *,
        guessed: bool = False,
        relief_bits: int = 0,
        passing: bool = False,
    ) -> None:
        self.voxel_size_m = voxel_size_m
        self.relief_bits = relief_bits
        self.guessed, self.passing = guessed, passing
        self.texture = Texture(texture_scale) if texture_scale > 1 else None
        self.index = BlockIndex()
        self.occupied = np.zeros((0, BLOCK_CELLS), dtype=np.uint8)
        self.color = np.zeros((0, BLOCK_CELLS, 3), dtype=np.int16)
        self.relief = np.zeros((0, BLOCK_CELLS), dtype=np.uint8)
        self.planes = np.zeros((0, BLOCK_CELLS, 4), dtype=np.int8)
        self.cell_count = 0
        self.version = 0
        self._planes_version = 0
        self._changed = np.zeros(0, dtype=np.int64)

    def cells(self) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
        """Return the occupied cells (n, 3) in Morton order and their colors (n, 3)."""
        cells, positions = self.index.flagged(self.occupied[: self.index.count])
        return cells, self.color.reshape(-1, 3)[positions]

    def apply(self, update: ModelUpdate) -> None:
        """Apply a decoded update.

        Raises
        ------
        CorruptStream
            If the update adds a cell twice, or removes or recolors one that is not there.
        """
        self.index.insert(update.added // BLOCK_SIDE)
        self._grow()
        added = self._positions(update.added, present=False)
        removed = self._positions(update.removed, present=True)
        recolored = self._positions(update.recolored, present=True)
        occupied, color = self.occupied.reshape(-1), self.color.reshape(-1, 3)
        occupied[removed] = 0
        color[removed] = 0
        occupied[added] = 1
        color[added] = update.added_colors
        color[recolored] = update.recolored_colors
        self.relief.reshape(-1)[removed] = UNSET
        self.cell_count += len(added) - len(removed)
        self._note_change(np.concatenate([added, removed, recolored]))
        if self.texture is not None:
            self.texture.erase(np.concatenate([update.removed, update.recolored]))

    def cells_without_offset(self) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """Return the occupied cells (n, 3), in Morton order, without a relief yet, and where they are in the arrays."""
        cells, positions = self.index.flagged(self.occupied[: self.index.count])
        untold = self.relief.reshape(-1)[positions] == UNSET
        return cells[untold], positions[untold]

    def shape(self, positions: NDArray[np.int64], relief: NDArray[np.uint8]) -> None:
        """Give cells at positions (n,) a relief (n,)."""
        self.relief.reshape(-1)[positions] = relief
        self._note_change(positions)

    def fit_planes(self, threads: int = 1) -> None:
        """Bring `planes` up to date."""
        changed, self._planes_version = self.changed_since(self._planes_version), self.version
        if not len(changed):
            return
        if len(self.occupied) > len(self.planes):
            more = np.zeros((len(self.occupied) - len(self.planes), BLOCK_CELLS, 4), dtype=np.int8)
            self.planes = np.concatenate([self.planes, more])
        places = _relief_places(self.relief_bits)
        positions = self.index.locate(shifted_blocks(changed, (-1, 0, 1)) * BLOCK_SIDE)
        numbers = positions[positions >= 0] // BLOCK_CELLS

        def plane_range(start: int, stop: int) -> None:
            fit_planes(
                numbers, start, stop, self.index.coords, self.index.tables, self.occupied, self.relief, places,
                PLANE_WEIGHTS, self.planes,
            )  # fmt: skip

        for_ranges(plane_range, len(numbers), threads)

    def uncolored_texels(self) -> NDArray[np.int32]:
        """Return the texels (n, 3), in Morton order, of the occupied cells that have none with a color yet.

        Which texels a cell has depends on the cells around it at this moment.
        """
        assert self.texture is not None
        self.fit_planes()
        cells, positions = self.index.flagged(self.occupied[: self.index.count])
        texels, _ = self.texture.texels()
        painted = self.index.locate(np.unique(texels // self.texture.scale, axis=0))
        bare = np.ones(self.occupied.size, dtype=bool)
        bare[painted[painted >= 0]] = False
        chosen = bare[positions]
        return texels_of(cells[chosen], self.planes.reshape(-1, 4)[positions[chosen]], self.texture.scale)

    def color_grids(self) -> list[ColorGrid]:
        """Return where to look a color up, the finest first."""
        own = ColorGrid(self.voxel_size_m, self.index.tables, self.occupied.reshape(-1), self.color.reshape(-1, 3))
        return [own] if self.texture is None else [self.texture.grid(self.voxel_size_m), own]

    def changed_since(self, version: int) -> NDArray[np.int32]:
        """Return the coordinates (n, 3) of blocks that updates after `version` touched."""
        return self.index.coords[: self.index.count][self._changed[: self.index.count] > version]

    def digest(self) -> bytes:
        """Return a hash of cells and colors, independent of the order in which they came."""
        cells, colors = self.cells()
        state = hashlib.sha256()
        state.update(np.float64(self.voxel_size_m).tobytes())
        state.update(cells.astype("<i4").tobytes())
        state.update(colors.astype("<i2").tobytes())
        if self.relief_bits:
            _, positions = self.index.flagged(self.occupied[: self.index.count])
            state.update(self.relief.reshape(-1)[positions].tobytes())
        if self.texture is not None:
            texels, texel_colors = self.texture.texels()
            state.update(texels.astype("<i4").tobytes())
            state.update(texel_colors.astype("<i2").tobytes())
        return state.digest()[:DIGEST_BYTES]

    def _positions(self, cells: NDArray[np.int32], *, present: bool) -> NDArray[np.int64]:
        positions = self.index.locate(cells)
        if len(cells) and (positions.min() < 0 or np.any(self.occupied.reshape(-1)[positions] != present)):
            raise CorruptStream("a model update does not fit the model; the stream is damaged or a packet is missing")
        return positions

    def _note_change(self, positions: NDArray[np.int64]) -> None:
        self.version += 1
        self._changed[positions // BLOCK_CELLS] = self.version

    def _grow(self) -> None:
        if self.index.count > len(self.occupied):
            more = max(self.index.count, len(self.occupied) * 3 // 2) - len(self.occupied)
            self.occupied = np.concatenate([self.occupied, np.zeros((more, BLOCK_CELLS), dtype=np.uint8)])
            self.color = np.concatenate([self.color, np.zeros((more, BLOCK_CELLS, 3), dtype=np.int16)])
            self.relief = np.concatenate([self.relief, np.zeros((more, BLOCK_CELLS), dtype=np.uint8)])
            self._changed = np.concatenate([self._changed, np.zeros(more, dtype=np.int64)])


def _relief_places(bits: int) -> NDArray[np.float64]:
    """Return for each relief the point (256, 3), from a cell's center in cells, through which the surface passes."""
    places = np.zeros((256, 3))
    levels = 1 << bits
    for axis in range(3 if bits else 0):
        first = 1 + 8 * axis
        places[first : first + levels, axis] = (2 * np.arange(levels) + 1 - levels) / (2 * levels)
    return places


def models_digest(models: Mapping[int, DecodedModel]) -> bytes:
    """Return the digest of all models that END carries (16 bytes)."""
    state = hashlib.sha256()
    for number in sorted(models):
        state.update(number.to_bytes(4, "little") + models[number].digest())
    return state.digest()[:DIGEST_BYTES]
