# SPDX-License-Identifier: MIT
"""Lossless coding of sets of cells as octrees, breadth first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.mixer import new_mixer
from threedvc.coding.octree import Neighborhood, Octree, children_of
from threedvc.coding.range_coder import RangeReader, RangeWriter
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.kernels.geometry_coding import (
    GEOMETRY_MODELS,
    GEOMETRY_SETS,
    GEOMETRY_WEIGHT_ROWS,
    Surroundings,
    code_masks,
)
from threedvc.kernels.octree import Level

__all__ = ["MAX_CELLS", "code_new_cells", "code_subset"]

MAX_CELLS = 1 << 24
BYTES_PER_NODE = 16
MAX_HEIGHT = 3
ALL_CHILDREN = 255


def code_new_cells(
    coder: RangeWriter | RangeReader, codes: NDArray[np.int64] | None, state: Octree
) -> NDArray[np.int64]:
    """Code cells that are not in the state.

    Parameters
    ----------
    coder
        Where to write to or to read from.
    codes
        (n,) Morton codes to write, ascending; None when reading.
    state
        Tree of the state before; its cells are context. Its depth is that of the new cells.

    Returns
    -------
    codes
        (n,) Morton codes.

    Raises
    ------
    CorruptStream
        If what is read cannot have been written.
    LimitExceeded
        If a level has more than 2^24 nodes.
    """
    return _code_tree(coder, codes, state, superset=None)


def code_subset(
    coder: RangeWriter | RangeReader, codes: NDArray[np.int64] | None, superset: Octree, side: Octree
) -> NDArray[np.int64]:
    """Code some cells of a set that both sides know, with the cells of `side` as context; see `code_new_cells`."""
    return _code_tree(coder, codes, side, superset=superset)


def _code_tree(
    coder: RangeWriter | RangeReader,
    codes: NDArray[np.int64] | None,
    side: Octree,
    superset: Octree | None,
) -> NDArray[np.int64]:
    depth = len(side.levels)
    target = Octree(codes, depth) if codes is not None else None
    mixer = new_mixer(GEOMETRY_MODELS, GEOMETRY_SETS, GEOMETRY_WEIGHT_ROWS)
    own, beside = Neighborhood(True), Neighborhood(len(side.codes) > 0)
    inside = Neighborhood(superset is not None)
    found = np.zeros(1, dtype=np.int64)
    parents, parent_masks = np.zeros(1, dtype=np.int32), np.zeros(1, dtype=np.uint8)
    for number in range(depth):
        nodes = len(found)
        masks = target.levels[number].masks.copy() if target is not None else np.zeros(nodes, dtype=np.uint8)
        level = Level(found, masks, np.empty(nodes, dtype=np.int32))
        around = Surroundings(
            own.near,
            parent_masks[parents],
            (found & 7).astype(np.uint8),
            _allowed(number == depth - 1, side.levels[number], beside, superset and superset.levels[number], inside),
            side.levels[number].masks,
            beside.near,
        )
        coder.reserve(BYTES_PER_NODE * nodes)
        if not code_masks(coder.coder, mixer, min(depth - 1 - number, MAX_HEIGHT), masks, around):
            raise CorruptStream("the cells of a model update end too early or contradict the state; the stream is damaged")
        found, parents = children_of(level)
        if len(found) > MAX_CELLS:
            raise LimitExceeded(f"a model update has more than {MAX_CELLS} cells")
        parent_masks = masks
        if number < depth - 1:
            own.descend(level, level, len(found))
            beside.descend(level, side.levels[number], len(found))
            if superset is not None:
                inside.descend(level, superset.levels[number], len(found))
    return found


def _allowed(
    leaf: bool, side: Level, beside: Neighborhood, superset: Level | None, inside: Neighborhood
) -> NDArray[np.uint8]:
    """Return which children a node may have: those of the superset, or those not occupied in the state."""
    if superset is not None:
        return superset.masks[inside.near[:, 13]]
    if not leaf or not len(side.masks):
        return np.full(len(beside.near), ALL_CHILDREN, dtype=np.uint8)
    here = beside.near[:, 13]
    return np.where(here >= 0, ALL_CHILDREN ^ side.masks[here], ALL_CHILDREN).astype(np.uint8)
