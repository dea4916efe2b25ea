# SPDX-License-Identifier: MIT
"""Morton order, cubes, octrees and neighborhoods against dictionaries of cells."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.coding import Cell, around, morton_code, nodes_at
from threedvc.coding.morton import Cube, cells_of_codes, morton_codes, morton_order
from threedvc.coding.octree import Octree, TreeWalk


def as_set(cells: NDArray[np.int32]) -> set[Cell]:
    """Return cells as tuples."""
    return {(x, y, z) for x, y, z in cells.tolist()}


def random_tree(rng: np.random.Generator, count: int, depth: int) -> tuple[Octree, set[Cell]]:
    """Return a tree of random cells and the cells."""
    cells = np.unique(rng.integers(1 << depth, size=(count, 3)), axis=0).astype(np.int32)
    return Octree(np.sort(morton_codes(cells, (0, 0, 0))), depth), as_set(cells)


def test_codes_match_interleaved_bits(rng: np.random.Generator) -> None:
    cells = rng.integers(-(1 << 20), 1 << 20, size=(50, 3)).astype(np.int32)
    offset = cells.astype(np.int64) + (1 << 20)
    assert morton_codes(cells).tolist() == [morton_code((x, y, z)) for x, y, z in offset.tolist()]
    assert np.array_equal(cells_of_codes(morton_codes(cells), (-(1 << 20),) * 3), cells)


def test_order_has_x_lowest() -> None:
    cells = np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 0]], dtype=np.int32)
    assert cells[morton_order(cells)].tolist() == [[-1, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("cells", "depth"), [([[5, 5, 5]], 1), ([[-1, 0, 0], [0, 0, 0]], 2), ([[-5, 7, 0], [90, 0, 0]], 8)]
)
def test_cube_holds_its_cells_and_is_shallow(cells: list[list[int]], depth: int) -> None:
    array = np.array(cells, dtype=np.int32)
    cube = Cube.around(array, np.empty((0, 3), dtype=np.int32))
    assert cube.contains(array)
    assert cube.depth == depth
    assert not cube.contains(array + (1 << depth))


def test_levels_hold_masks_and_first_children(rng: np.random.Generator) -> None:
    tree, cells = random_tree(rng, 300, 5)
    for number, level in enumerate(tree.levels):
        nodes, children = nodes_at(cells, 5 - number), nodes_at(cells, 4 - number)
        ordered, below = sorted(nodes, key=morton_code), sorted(children, key=morton_code)
        assert level.codes.tolist() == [morton_code(node) for node in ordered]
        for node, mask, first in zip(ordered, level.masks.tolist(), level.first.tolist(), strict=True):
            own = [child for child in below if tuple(v >> 1 for v in child) == node]
            assert mask == sum(1 << (morton_code(child) & 7) for child in own)
            assert below[first] == own[0]


@pytest.mark.parametrize("same", [True, False])
def test_walk_finds_all_places_around_every_node(rng: np.random.Generator, same: bool) -> None:
    tree, cells = random_tree(rng, 200, 4)
    side, side_cells = (tree, cells) if same else random_tree(rng, 200, 4)
    walk = TreeWalk(side)
    for number, level in enumerate(tree.levels):
        surroundings = walk.surroundings()
        for group, near in ((cells, surroundings.near), (side_cells, surroundings.side_near)):
            rows = {node: k for k, node in enumerate(sorted(nodes_at(group, 4 - number), key=morton_code))}
            for k, node in enumerate(sorted(nodes_at(cells, 4 - number), key=morton_code)):
                assert near[k].tolist() == [rows.get(place, -1) for _, place in around(node, 1)]
        walk.descend(level.masks)
    assert np.array_equal(walk.codes, tree.codes)


def leaf_allowed(walk: TreeWalk, tree: Octree) -> set[Cell]:
    """Return the cells that a walk allows below the leaf nodes of a tree."""
    for level in tree.levels[:-1]:
        assert np.all(level.masks & ~walk.surroundings().allowed == 0)
        walk.descend(level.masks)
    codes = [8 * code + o for code in walk.codes.tolist() for o in range(8)]
    there = np.unpackbits(walk.surroundings().allowed[:, None], axis=1, bitorder="little").ravel() == 1
    return as_set(cells_of_codes(np.array(codes)[there], (0, 0, 0)))


def test_walk_allows_what_can_be_there(rng: np.random.Generator) -> None:
    tree, cells = random_tree(rng, 150, 3)
    side, side_cells = random_tree(rng, 150, 3)
    fresh = Octree(np.setdiff1d(tree.codes, side.codes), 3)
    parents = nodes_at(cells - side_cells, 1)
    everything = as_set(np.indices((8, 8, 8)).reshape(3, -1).T.astype(np.int32))
    candidates = {c for c in everything if (c[0] >> 1, c[1] >> 1, c[2] >> 1) in parents}
    assert leaf_allowed(TreeWalk(side), fresh) == candidates - side_cells
    assert leaf_allowed(TreeWalk(side, superset=tree), fresh) == candidates & cells
