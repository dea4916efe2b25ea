# SPDX-License-Identifier: MIT
"""Lossless coding of sets of cells as octrees, breadth first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.entropy.mixer import new_mixer
from threedvc.coding.entropy.range_coder import RangeCoder
from threedvc.coding.geometry_prior import geometry_prior
from threedvc.coding.octree import Octree, TreeWalk
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.kernels.coding.geometry_coding import (
    GEOMETRY_MODELS,
    GEOMETRY_SETS,
    GEOMETRY_WEIGHT_ROWS,
    code_masks,
)
from threedvc.kernels.coding.octree import BIT_COUNTS

__all__ = ["MAX_NODES", "code_new_cells", "code_subset"]

MAX_NODES = 1 << 23
"""Of a tree, cells included: some gigabytes of a reader's memory. Part of the format, as the weights below."""
BYTES_PER_NODE = 16
"""Room for one: eight children of at most 11 bits each take 11."""
ADDED_WEIGHTS = (0.1, 0.0, 0.6)
"""First weights of contexts, of the constant, of the network: it knows new surfaces, contexts have to learn them."""
SUBSET_WEIGHTS = (0.3, 0.0, 0.0)
"""The same for parts of what is known, of which the network knows nothing."""


def code_new_cells(coder: RangeCoder, codes: NDArray[np.int64] | None, state: Octree) -> NDArray[np.int64]:
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
        If the tree has more than 2^23 nodes, cells included.
    """
    return _code_tree(coder, codes, state, None, ADDED_WEIGHTS)


def code_subset(
    coder: RangeCoder, codes: NDArray[np.int64] | None, superset: Octree, side: Octree
) -> NDArray[np.int64]:
    """Code some cells of a set that both sides know, with the cells of `side` as context; see `code_new_cells`."""
    return _code_tree(coder, codes, side, superset, SUBSET_WEIGHTS)


def _code_tree(
    coder: RangeCoder,
    codes: NDArray[np.int64] | None,
    side: Octree,
    superset: Octree | None,
    first_weights: tuple[float, ...],
) -> NDArray[np.int64]:
    target = Octree(codes, len(side.levels)) if codes is not None else None
    mixer = new_mixer(GEOMETRY_MODELS, GEOMETRY_SETS, GEOMETRY_WEIGHT_ROWS, first_weights=first_weights)
    walk = TreeWalk(side, superset)
    nodes = 1
    for number in range(len(side.levels)):
        masks = target.levels[number].masks.copy() if target is not None else np.zeros(len(walk.codes), dtype=np.uint8)
        coder.reserve(BYTES_PER_NODE * len(masks))
        if not code_masks(coder.coder, mixer, geometry_prior(), walk.height, masks, walk.surroundings()):
            raise CorruptStream("cells of a model update end too early or contradict the state; the stream is damaged")
        nodes += int(BIT_COUNTS[masks].sum())
        if nodes > MAX_NODES:
            raise LimitExceeded(f"a model update has more than {MAX_NODES} nodes; use larger cells or smaller groups")
        walk.descend(masks)
    return walk.codes
