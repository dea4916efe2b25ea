# SPDX-License-Identifier: MIT
"""Octrees of cells and the places around their nodes in another tree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.octree import BIT_COUNTS, Level, expand_children, find_neighbors, group_children

__all__ = ["Neighborhood", "Octree", "children_of", "empty_level"]


def empty_level(count: int = 0) -> Level:
    """Return a level with room for `count` nodes."""
    return Level(
        np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.uint8), np.zeros(count, dtype=np.int32)
    )


def children_of(level: Level) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Set `level.first` from the masks; return the children's codes and the index of each one's parent."""
    count = int(BIT_COUNTS[level.masks].sum())
    codes, parents = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int32)
    expand_children(level, codes, parents)
    return codes, parents


class Octree:
    """The levels of a set of cells: `levels[0]` holds the root, `levels[-1]` the parents of the cells.

    Parameters
    ----------
    codes
        (n,) Morton codes of the cells, ascending and distinct.
    depth
        Number of levels; codes are below ``8 ** depth``.
    """

    def __init__(self, codes: NDArray[np.int64], depth: int) -> None:
        self.codes = codes
        self.levels: list[Level] = []
        for _ in range(depth):
            level = empty_level(len(codes))
            count = group_children(codes, level)
            level = Level(*(array[:count].copy() for array in level))
            self.levels.insert(0, level)
            codes = level.codes


class Neighborhood:
    """The 27 places around every node of a level, as indices into the same level of a target tree.

    Attributes
    ----------
    near
        (n, 27) int32, -1 where the target has no node.
    """

    def __init__(self, target_has_root: bool) -> None:
        self.near = np.full((1, 27), -1, dtype=np.int32)
        if target_has_root:
            self.near[0, 13] = 0

    def descend(self, level: Level, target: Level, count: int) -> None:
        """Go from the nodes of `level` to their `count` children."""
        child_near = np.empty((count, 27), dtype=np.int32)
        find_neighbors(level, self.near, target, child_near)
        self.near = child_near
