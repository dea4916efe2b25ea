# SPDX-License-Identifier: MIT
"""Coding of cell sets, and the geometry prior against a dense evaluation of its inputs."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.coding import Cell, around, morton_code, nodes_at
from threedvc.coding.entropy.range_coder import RangeReader, RangeWriter
from threedvc.coding.geometry import code_new_cells, code_subset
from threedvc.coding.geometry_prior import geometry_prior
from threedvc.coding.morton import cells_of_codes, morton_codes
from threedvc.coding.octree import Octree, TreeWalk
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.kernels.coding.geometry_prior import FEATURES, HEIGHTS, list_features, prior_log_odds

DEPTH = 5


def sphere_codes(radius: float) -> NDArray[np.int64]:
    """Return the codes of a one-cell sphere in the middle of a cube of 32 cells."""
    cells = np.indices((32, 32, 32)).reshape(3, -1).T.astype(np.int32)
    distance = np.linalg.norm(cells - 15.5, axis=1) - radius
    return np.sort(morton_codes(cells[np.abs(distance) < 0.5], (0, 0, 0)))


def tree(codes: NDArray[np.int64]) -> Octree:
    """Return a tree of the depth of these tests."""
    return Octree(codes, DEPTH)


def clip(value: int) -> int:
    """Return the nearest of -1, 0, 1."""
    return max(-1, min(1, value))


def dense_inputs(number: int, node: Cell, child: int, own: set[Cell], side: set[Cell], mask: int) -> NDArray[np.int64]:
    """Return all inputs of the prior for one decision, from sets of cells; mirrored by coordinates."""
    height = DEPTH - 1 - number
    sign = [1 if child >> a & 1 else -1 for a in range(3)]
    nodes, side_nodes = nodes_at(own, height + 1), nodes_at(side, height + 1)
    places, side_places = nodes_at(own, height), nodes_at(side, height)
    origin = [2 * node[a] + (child >> a & 1) for a in range(3)]

    def mirrored(center: list[int], step: Cell) -> Cell:
        x, y, z = (center[a] + sign[a] * step[a] for a in range(3))
        return x, y, z

    def known(place: Cell) -> bool:
        parent = (place[0] >> 1, place[1] >> 1, place[2] >> 1)
        if parent == node:
            octant = morton_code(place) & 7
            return bool(octant < child and mask >> octant & 1)
        return place in places and morton_code(parent) < morton_code(node)

    grid = [(p & 3, p >> 2 & 3, p >> 4) for p in range(64)]
    near = [mirrored(origin, (x - 2, y - 2, z - 2)) for x, y, z in grid]
    steps = [step for _, step in around((0, 0, 0), 2)]
    wide = [mirrored(list(node), step) for step in steps]
    between = [mirrored(list(node), (clip(step[0]), clip(step[1]), clip(step[2]))) for step in steps]
    close = [mirrored(list(node), step) for _, step in around((0, 0, 0), 1)]
    uncoded = [place in nodes and morton_code(place) > morton_code(node) for place in close]
    return np.array(
        [known(place) for place in near]
        + [place in nodes and way in nodes for place, way in zip(wide, between, strict=True)]
        + uncoded
        + [place in side_places for place in near]
        + [place in side_nodes for place in close],
        dtype=np.int64,
    )


def test_prior_matches_dense_evaluation() -> None:
    added, state = sphere_codes(12.0)[200:700], sphere_codes(9.0)
    own = {(x, y, z) for x, y, z in cells_of_codes(added, (0, 0, 0)).tolist()}
    side = {(x, y, z) for x, y, z in cells_of_codes(state, (0, 0, 0)).tolist()}
    prior, walk = geometry_prior(), TreeWalk(tree(state))
    features, hidden = np.zeros(FEATURES, dtype=np.int64), np.zeros(len(prior.outputs), dtype=np.int32)
    for number, level in enumerate(tree(added).levels):
        surroundings, ordered = walk.surroundings(), sorted(nodes_at(own, DEPTH - number), key=morton_code)
        for k in range(0, len(ordered), 7):
            count = list_features(k, level.masks, surroundings, features)
            for child in range(8):
                inputs = dense_inputs(number, ordered[k], child, own, side, int(level.masks[k]))
                row = min(walk.height, HEIGHTS - 1) * 8 + child
                units = np.maximum(inputs @ prior.inputs + prior.biases[row], 0)
                expected = int(np.clip((units @ prior.outputs + prior.output_bias) >> 4, -2047, 2047))
                siblings = int(level.masks[k]) & ((1 << child) - 1)
                assert prior_log_odds(prior, walk.height, child, siblings, features, count, hidden) == expected
        walk.descend(level.masks)


def test_a_surface_costs_little_and_comes_back() -> None:
    codes, writer = sphere_codes(12.0), RangeWriter()
    code_new_cells(writer, codes, tree(codes[:0]))
    payload = writer.finish()
    assert 8 * len(payload) < 1.3 * len(codes)
    reader = RangeReader(payload)
    assert np.array_equal(code_new_cells(reader, None, tree(codes[:0])), codes)
    reader.finish()


def test_state_lowers_the_price_of_what_surrounds_it() -> None:
    codes = sphere_codes(12.0)
    hole = np.arange(len(codes)) % 8 == 3
    sizes = []
    for state in (codes[~hole], codes[:0]):
        writer = RangeWriter()
        code_new_cells(writer, codes[hole], tree(state))
        sizes.append(len(writer.finish()))
    assert sizes[0] < 0.7 * sizes[1]


@pytest.mark.parametrize("share", [0.01, 0.5, 1.0])
def test_subset_comes_back(rng: np.random.Generator, share: float) -> None:
    whole, side = sphere_codes(12.0), sphere_codes(11.0)
    part = whole[rng.random(len(whole)) < share]
    writer = RangeWriter()
    code_subset(writer, part, tree(whole), tree(side))
    payload = writer.finish()
    reader = RangeReader(payload)
    assert np.array_equal(code_subset(reader, None, tree(whole), tree(side)), part)
    reader.finish()
    assert len(payload) < 1 + len(whole) / 6


def test_too_many_nodes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    codes, writer = sphere_codes(12.0), RangeWriter()
    code_new_cells(writer, codes, tree(codes[:0]))
    reader = RangeReader(writer.finish())
    monkeypatch.setattr("threedvc.coding.geometry.MAX_NODES", 2000)
    with pytest.raises(LimitExceeded, match="more than 2000 nodes; use larger cells or smaller groups"):
        code_new_cells(reader, None, tree(codes[:0]))


def test_cells_of_the_state_cannot_be_added_again() -> None:
    codes, writer = sphere_codes(12.0), RangeWriter()
    code_new_cells(writer, codes, tree(codes[:0]))
    reader = RangeReader(writer.finish())
    full = tree(np.arange(8**DEPTH))
    with pytest.raises(CorruptStream, match="contradict the state"):
        code_new_cells(reader, None, full)
