# SPDX-License-Identifier: MIT
"""MAP read-out of an object's evidence, and the choice of what to send (sec. 2.1).

A ray is stopped by the first occupied cell, so only cells at the surface are read out: those nearest to
a change of sign of the mean signed distance whose log-odds say occupied. The rest of the occupied cells
can never be seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.kernels.encoder.surface import count_neighbors, find_crossings, mark_surface, smooth_distances
from threedvc.model.block_index import BLOCK_CELLS, morton_keys
from threedvc.parallel import for_ranges

__all__ = ["MIN_NEIGHBORS", "Surface", "extract_surface", "grouped_by_region"]

MIN_WEIGHT = 0.02
"""Weight of a cell's signed distance, in units of the sensor's at 1 m, with which it counts as measured: a fiftieth, as
a measurement at a picture's border has (decision 0011)."""
COLORLESS = 128
"""The gray of cells that have no colors of their own."""
MIN_NEIGHBORS = 3
"""Cells of a surface that touch a cell of it, of 26: specks of fewer than four cells are noise."""
SMOOTHING_PASSES = 3
"""Each draws a cell to the mean of its neighbors: three reach three cells (decision 0011)."""
SMOOTHING_TRUST = 4.0
"""Precision, in units of the sensor's at 1 m, with which neighbors tell a cell its distance. Measured: decision 0011
compares bytes and depth with and without it."""
REGION_SHIFT = 4
"""Binary logarithm of the cells along a region, 16: see `grouped_by_region` for what it saves."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """Surface cells of an object.

    Attributes
    ----------
    cells
        (n, 3) int32, in Morton order.
    colors
        (n, 3) int16 RGB.
    first_seen
        (n,) int32 frame in which the cell was first measured.
    crossings
        (n, 3) float32 where the surface passes along each axis, from the cell's center in cells.
    importance
        (n,) float32 how much an error of the cell's color counts, or None: alike.
    """

    cells: NDArray[np.int32]
    colors: NDArray[np.int16]
    first_seen: NDArray[np.int32]
    subvoxel_offsets: NDArray[np.float32]
    importance: NDArray[np.float32] | None = None

    def part(self, chosen: NDArray[np.bool_]) -> Surface:
        """Return the cells where `chosen` (n,) is true."""
        return Surface(
            cells=self.cells[chosen],
            colors=self.colors[chosen],
            first_seen=self.first_seen[chosen],
            subvoxel_offsets=self.subvoxel_offsets[chosen],
            importance=None if self.importance is None else self.importance[chosen],
        )

    def without_colors(self) -> Surface:
        """Return the cells in gray."""
        return replace(self, colors=np.full_like(self.colors, COLORLESS))

    def offsets_at(self, cells: NDArray[np.int32]) -> NDArray[np.float32]:
        """Return the crossings (n, 3) of some of its cells (n, 3)."""
        return self.subvoxel_offsets[np.searchsorted(morton_keys(self.cells), morton_keys(cells))]


def extract_surface(model: EvidenceModel, threads: int, *, min_log_odds: float = 0.0, smooth: bool = False) -> Surface:
    """Read the surface out of the evidence; specks of fewer than four touching cells are noise.

    Parameters
    ----------
    model
        Evidence of an object.
    threads
        Number of threads; the surface does not depend on it.
    min_log_odds
        How sure it must be that a surface is there.
    smooth
        Whether to straighten it, the more the less often it was measured: what is noise costs bits.
    """
    index, count = model.index, model.index.count
    distance = _smoothed(model, threads) if smooth else model.distance
    flags = np.zeros((count, BLOCK_CELLS), dtype=np.uint8)

    def mark(start: int, stop: int) -> None:
        mark_surface(
            start, stop, index.coords, index.tables, model.voxel_size_m, distance, model.distance_weight,
            model.log_odds, MIN_WEIGHT, min_log_odds, flags,
        )  # fmt: skip

    for_ranges(mark, count, threads)
    cells, positions = index.flagged(flags)
    neighbors = np.zeros(len(cells), dtype=np.int32)
    count_neighbors(cells, positions, index.tables, flags.reshape(-1), neighbors)
    cells, positions = cells[neighbors >= MIN_NEIGHBORS], positions[neighbors >= MIN_NEIGHBORS]
    subvoxel_offsets = np.empty((len(cells), 3), dtype=np.float32)
    find_crossings(
        cells, positions, index.tables, distance.reshape(-1), model.distance_weight.reshape(-1), subvoxel_offsets
    )
    return Surface(
        cells=cells,
        colors=_colors(model, positions),
        first_seen=model.first_seen.reshape(-1)[positions],
        subvoxel_offsets=subvoxel_offsets,
    )


def _smoothed(model: EvidenceModel, threads: int) -> NDArray[np.float32]:
    """Return the mean signed distances (blocks, 512), straightened."""
    distance = model.distance
    for _ in range(SMOOTHING_PASSES):
        smooth = partial(_smooth_range, model, distance, after := np.empty_like(distance))
        for_ranges(smooth, model.index.count, threads)
        distance = after
    return distance


def _smooth_range(
    model: EvidenceModel, before: NDArray[np.float32], after: NDArray[np.float32], start: int, stop: int
) -> None:
    smooth_distances(
        start, stop, model.index.coords, model.index.tables, model.voxel_size_m, before, model.distance_weight,
        MIN_WEIGHT, SMOOTHING_TRUST, after,
    )  # fmt: skip


def grouped_by_region(surface: Surface) -> Surface:
    """Let cells of a region of 16x16x16 cells be first seen together, when the first of them is.

    Sent one by one as the view wanders over them they cost 40 % more than all at once, so 7 %.
    """
    regions, member = np.unique(surface.cells >> REGION_SHIFT, axis=0, return_inverse=True)
    first = np.full(len(regions), EvidenceModel.NEVER, dtype=np.int32)
    np.minimum.at(first, member, surface.first_seen)
    return replace(surface, first_seen=first[member])


def _colors(model: EvidenceModel, positions: NDArray[np.int64]) -> NDArray[np.int16]:
    """Return the mean colors; a cell never seen in color takes the one before it in Morton order."""
    colors = np.round(model.color.reshape(-1, 3)[positions]).astype(np.int16)
    known = model.color_weight.reshape(-1)[positions] > 0
    if known.all():
        return colors
    if not known.any():
        return np.full_like(colors, 128)
    nearest = np.maximum.accumulate(np.where(known, np.arange(len(known)), int(np.argmax(known))))
    return colors[nearest]
