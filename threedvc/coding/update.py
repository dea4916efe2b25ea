# SPDX-License-Identifier: MIT
"""Payload of a model update: cells that appear, vanish or change color, against the state before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.color import ColorSettings, code_cell_colors
from threedvc.coding.entropy.range_coder import RangeCoder, RangeReader, RangeWriter, new_counters
from threedvc.coding.geometry import code_new_cells, code_subset
from threedvc.coding.morton import MAX_COORDINATE, Cube, cells_of_codes, morton_codes, morton_order
from threedvc.coding.octree import Octree
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.kernels.coding.octree import COORDINATE_BITS
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS
from threedvc.model.model_update import ModelUpdate

__all__ = ["decode_update", "encode_update_with_result"]

NO_CELLS = np.empty((0, 3), dtype=np.int32)
NO_COLORS = np.empty((0, 3), dtype=np.int16)
NO_CODES = np.empty(0, dtype=np.int64)
"""What an update is without."""


def encode_update_with_result(
    update: ModelUpdate, cells: NDArray[np.int32], colors: NDArray[np.int16], settings: ColorSettings
) -> tuple[bytes, ModelUpdate]:
    """Encode an update.

    Parameters
    ----------
    update
        What changes.
    cells, colors
        (n, 3) int32 occupied cells before the update in Morton order, and their (n, 3) int16 RGB.
    settings
        How finely colors are coded.

    Returns
    -------
    payload
        Bytes for `decode_update`.
    decoded
        The update as the decoder will see it: the same cells, quantized colors.

    Raises
    ------
    LimitExceeded
        If there are more than about 2^22 cells, or they lie too far from the origin or from each other.
    """
    if not _in_range(update.added) or Cube.around(cells, update.added).depth > COORDINATE_BITS:
        raise LimitExceeded(f"cells must lie within +-{MAX_COORDINATE} and span no more; use larger cells")
    writer = RangeWriter()
    decoded = _code_update(writer, update, cells, colors, settings)
    return writer.finish(), decoded


def decode_update(payload: bytes, cells: NDArray[np.int32], colors: NDArray[np.int16]) -> ModelUpdate:
    """Decode an update against the state before it, as given to `encode_update_with_result`.

    Raises
    ------
    CorruptStream
        If the payload is damaged or does not fit the state.
    LimitExceeded
        If a tree of its cells has more than 2^23 nodes.
    """
    reader = RangeReader(payload)
    update = _code_update(reader, None, cells, colors, ColorSettings())
    reader.finish()
    if not _in_range(update.added):
        raise CorruptStream(f"a model update has cells beyond +-{MAX_COORDINATE}; the stream is damaged")
    return update


def _in_range(cells: NDArray[np.int32]) -> bool:
    return bool(np.all((cells >= -MAX_COORDINATE) & (cells < MAX_COORDINATE)))


def _code_update(
    coder: RangeCoder,
    update: ModelUpdate | None,
    cells: NDArray[np.int32],
    colors: NDArray[np.int16],
    settings: ColorSettings,
) -> ModelUpdate:
    """Code an update in either direction; `update` is None when reading."""
    given = update if update is not None else _update(NO_CELLS, NO_COLORS, NO_CELLS, NO_CELLS, NO_COLORS)
    has_added, has_removed, has_recolored = (
        coder.bit(len(group) > 0) for group in (given.added, given.removed, given.recolored)
    )
    if not (has_added or has_removed or has_recolored):
        return given
    if (has_removed or has_recolored) and not len(cells):
        raise CorruptStream("a model update changes cells of an empty model; the stream is damaged")
    cube = _code_cube(coder, given.added, cells)
    state_codes, (state_colors,) = _sorted_codes(cells, cube, colors)
    state = Octree(state_codes, cube.depth)

    def wanted(group: NDArray[np.int32]) -> NDArray[np.int64] | None:
        return _sorted_codes(group, cube)[0] if update is not None else None

    added = code_new_cells(coder, wanted(given.added), state) if has_added else NO_CODES
    side = Octree(added, cube.depth)
    removed = code_subset(coder, wanted(given.removed), state, side) if has_removed else NO_CODES
    remaining = Octree(np.setdiff1d(state_codes, removed, assume_unique=True), cube.depth)
    if has_recolored and not len(remaining.codes):
        raise CorruptStream("a model update removes every cell and recolors some; the stream is damaged")
    recolored = code_subset(coder, wanted(given.recolored), remaining, side) if has_recolored else NO_CODES
    colored = Octree(np.sort(np.concatenate([added, recolored])), cube.depth)
    decoded = np.empty((0, 3), dtype=np.int16)
    if len(colored.codes):
        settings = settings.code(coder)
        true, importance = np.zeros((len(colored.codes), 3), dtype=np.int16), None
        if update is not None:
            both = np.concatenate([given.added, given.recolored])
            codes = morton_codes(both, cube.origin)
            order = np.argsort(codes, kind="stable")
            true = np.concatenate([given.added_colors, given.recolored_colors])[order]
            importance = update.importance[order] if update.importance is not None else None
        decoded = code_cell_colors(coder, colored, true, state, state_colors, settings, importance=importance)
    return _update(
        *_in_order(added, cube, decoded[np.searchsorted(colored.codes, added)]),
        _in_order(removed, cube)[0],
        *_in_order(recolored, cube, decoded[np.searchsorted(colored.codes, recolored)]),
    )


def _update(
    added: NDArray[np.int32],
    added_colors: NDArray[np.int16],
    removed: NDArray[np.int32],
    recolored: NDArray[np.int32],
    recolored_colors: NDArray[np.int16],
) -> ModelUpdate:
    return ModelUpdate(
        added=added,
        added_colors=added_colors,
        removed=removed,
        recolored=recolored,
        recolored_colors=recolored_colors,
    )


def _code_cube(coder: RangeCoder, added: NDArray[np.int32], cells: NDArray[np.int32]) -> Cube:
    """Code the cube that holds the state and the added cells: one bit where that of the state will do."""
    own = Cube.around(cells) if len(cells) else None
    if own is not None and not coder.bit(not own.contains(added)):
        return own
    cube = Cube.around(cells, added)
    counters = new_counters(NUMBER_COUNTERS)
    depth = coder.number(cube.depth, counters)
    corner = tuple(coder.signed(value, counters) for value in cube.corner)
    coder.check()
    if not 1 <= depth <= COORDINATE_BITS or any(abs(value) << (depth - 1) > MAX_COORDINATE for value in corner):
        raise CorruptStream(f"a cube of depth {depth} at {corner} is out of range; the stream is damaged")
    cube = Cube(depth, (corner[0], corner[1], corner[2]))
    if not cube.contains(cells):
        raise CorruptStream("the cube of a model update does not hold the state before; the stream is damaged")
    return cube


def _sorted_codes(
    cells: NDArray[np.int32], cube: Cube, *values: NDArray[np.int16]
) -> tuple[NDArray[np.int64], list[NDArray[np.int16]]]:
    """Return the codes of cells within the cube, ascending, and values per cell in the same order."""
    codes = morton_codes(cells, cube.origin)
    order = np.argsort(codes, kind="stable")
    return codes[order], [value[order] for value in values]


def _in_order(
    codes: NDArray[np.int64], cube: Cube, colors: NDArray[np.int16] = NO_COLORS
) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """Return cells and colors in Morton order."""
    cells = cells_of_codes(codes, cube.origin)
    order = morton_order(cells)
    return cells[order], colors[order] if len(colors) else colors
