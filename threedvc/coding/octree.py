# SPDX-License-Identifier: MIT
"""Octrees of cells and the places around their nodes in another tree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.coding.geometry_prior import CENTER, Surroundings
from threedvc.kernels.coding.octree import BIT_COUNTS, Level, expand_children, find_neighbors, group_children

__all__ = ["Neighborhood", "Octree", "TreeWalk", "children_of"]

ALL_CHILDREN = 255
"""A mask of eight ones."""


def _empty_level(count: int = 0) -> Level:
    """Return a level with room for `count` nodes."""
    return Level(np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.uint8), np.zeros(count, dtype=np.int32))


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
            level = _empty_level(len(codes))
            count = group_children(codes, level)
            level = Level(level.codes[:count].copy(), level.masks[:count].copy(), level.first[:count].copy())
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
            self.near[0, CENTER] = 0

    def descend(self, level: Level, target: Level, count: int) -> None:
        """Go from the nodes of `level` to their `count` children."""
        child_near = np.empty((count, 27), dtype=np.int32)
        find_neighbors(level, self.near, target, child_near)
        self.near = child_near


class TreeWalk:
    """Goes down a tree whose masks become known level by level, and tells what is known before each level.

    Parameters
    ----------
    side
        Another tree of the same cube, known to both sides.
    superset
        Tree of the only cells there may be; None: all but those of `side`.

    Attributes
    ----------
    height
        Levels left below the children of the nodes at hand.
    codes
        (n,) Morton codes of the nodes at hand; of the cells, when the walk is over.
    """

    def __init__(self, side: Octree, superset: Octree | None = None) -> None:
        self.codes = np.zeros(1, dtype=np.int64)
        self.height = len(side.levels) - 1
        self._side, self._superset = side, superset
        self._own, self._beside = Neighborhood(True), Neighborhood(len(side.codes) > 0)
        self._inside = Neighborhood(superset is not None)
        self._parent_masks = np.zeros(1, dtype=np.uint8)

    def surroundings(self) -> Surroundings:
        """Return what is known about the nodes at hand."""
        return Surroundings(
            near=self._own.near,
            parent_masks=self._parent_masks,
            octants=(self.codes & 7).astype(np.uint8),
            allowed=self._allowed(),
            side_masks=self._level_of(self._side).masks,
            side_near=self._beside.near,
        )

    def descend(self, masks: NDArray[np.uint8]) -> None:
        """Go to the children that `masks` (n,) name."""
        level = Level(self.codes, masks, np.empty(len(masks), dtype=np.int32))
        codes, parents = children_of(level)
        if self.height > 0:
            self._own.descend(level, level, len(codes))
            self._beside.descend(level, self._level_of(self._side), len(codes))
            if self._superset is not None:
                self._inside.descend(level, self._level_of(self._superset), len(codes))
        self.codes, self._parent_masks = codes, masks[parents]
        self.height -= 1

    def _level_of(self, tree: Octree) -> Level:
        return tree.levels[len(tree.levels) - 1 - self.height]

    def _allowed(self) -> NDArray[np.uint8]:
        if self._superset is not None:
            return self._level_of(self._superset).masks[self._inside.near[:, CENTER]]
        allowed = np.full(len(self.codes), ALL_CHILDREN, dtype=np.uint8)
        here = self._beside.near[:, CENTER]
        if self.height == 0:
            allowed[here >= 0] ^= self._level_of(self._side).masks[here[here >= 0]]
        return allowed
