# SPDX-License-Identifier: MIT
"""Straightening of signed distances, and where a surface passes in its cells."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.kernels.encoder.surface import BEND, MAX_JUMP, REACH, find_crossings, smooth_distances
from threedvc.model.block_index import BlockIndex

CELL = 0.02
SIDE = 16
TRUST = 4.0
MIN_WEIGHT = 0.5
Distances = NDArray[np.float32]

DIRECTIONS = [
    step for step in product((-1, 0, 1), repeat=3) if step > (0, 0, 0)
]  # one of each two opposite ways: 13 of them


class Grid:
    """A cube of blocks with a signed distance and a weight in every cell."""

    def __init__(self, distance: NDArray[np.float64], weight: NDArray[np.float64] | float = 1.0) -> None:
        coords = np.array(list(product(range(SIDE // 8), repeat=3)), dtype=np.int32)
        self.index = BlockIndex()
        self.index.insert(coords)
        self.cells = np.array(list(product(range(SIDE), repeat=3)), dtype=np.int32)
        self.positions = self.index.locate(self.cells)
        self.distance = self._blocks(distance)
        self.weight = self._blocks(np.broadcast_to(weight, distance.shape))

    def _blocks(self, values: NDArray[np.float64]) -> Distances:
        blocks = np.zeros(self.index.count * 512, dtype=np.float32)
        blocks[self.positions] = values[tuple(self.cells.T)]
        return blocks.reshape(-1, 512)

    def smoothed(self, trust: float = TRUST) -> NDArray[np.float32]:
        after = np.empty_like(self.distance)
        smooth_distances(
            0, self.index.count, self.index.coords, self.index.tables, CELL, self.distance, self.weight, MIN_WEIGHT,
            trust, after,
        )  # fmt: skip
        cube: NDArray[np.float32] = after.reshape(-1)[self.positions].reshape(SIDE, SIDE, SIDE)
        return cube

    def subvoxel_offsets(self, cells: NDArray[np.int32]) -> NDArray[np.float32]:
        found = np.empty((len(cells), 3), dtype=np.float32)
        positions = self.index.locate(cells)
        find_crossings(cells, positions, self.index.tables, self.distance.reshape(-1), self.weight.reshape(-1), found)
        return found


def plane(normal: tuple[float, float, float], offset: float) -> NDArray[np.float64]:
    """Return signed distances in meters, positive before the plane."""
    unit = np.array(normal) / np.linalg.norm(normal)
    centers = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1) - (SIDE - 1) / 2
    return (centers @ unit - offset) * CELL


def slowly_smoothed(distance: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """The definition, cell by cell."""
    smooth = distance.copy()
    inside = range(SIDE)
    for cell in product(inside, repeat=3):
        here = distance[cell]
        if weight[cell] < MIN_WEIGHT or abs(here) > REACH * CELL:
            continue
        total, mean = 0.0, 0.0
        for step in DIRECTIONS:
            one, two = (tuple(np.add(cell, np.multiply(way, step)).tolist()) for way in (1, -1))
            if not all(k in inside for k in one + two) or min(weight[one], weight[two]) < MIN_WEIGHT:
                continue
            if abs(distance[one] - distance[two]) > MAX_JUMP * CELL:
                continue
            between = 0.5 * (distance[one] + distance[two])
            share = min(weight[one], weight[two]) / (1 + ((between - here) / (BEND * CELL)) ** 2)
            total, mean = total + share, mean + share * between
        if total > 0:
            smooth[cell] = here + TRUST / (TRUST + weight[cell]) * (mean / total - here)
    return smooth


def test_smoothing_follows_its_definition() -> None:
    rng = np.random.default_rng(3)
    distance = plane((0.3, 0.5, 1.0), 0.2) + rng.normal(0, 0.4 * CELL, (SIDE,) * 3)
    distance[4:7] += 5 * CELL
    weight = rng.choice([0.0, 0.6, 3.0, 40.0], (SIDE,) * 3)
    np.testing.assert_allclose(Grid(distance, weight).smoothed(), slowly_smoothed(distance, weight), atol=1e-6)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (1.0, 2.0, -0.5)])
def test_a_plane_is_left_alone(normal: tuple[float, float, float]) -> None:
    exact = plane(normal, 0.3)
    np.testing.assert_allclose(Grid(exact).smoothed(), exact, atol=1e-6)


def test_noise_is_taken_off_what_was_measured_seldom() -> None:
    exact = plane((0.2, -0.4, 1.0), 0.1)
    noise = np.random.default_rng(5).normal(0, 0.2 * CELL, exact.shape)
    inner = (slice(2, -2),) * 3
    near = np.abs(exact[inner]) < 2 * CELL
    left = {weight: np.std((Grid(exact + noise, weight).smoothed() - exact)[inner][near]) for weight in (1.0, 400.0)}
    assert left[1.0] < 0.5 * np.std(noise)
    assert left[400.0] > 0.95 * np.std(noise)


def test_what_is_far_from_the_surface_is_left_alone() -> None:
    rng = np.random.default_rng(7)
    distance = (REACH + 0.5) * CELL + rng.uniform(0, CELL, (SIDE,) * 3)
    np.testing.assert_array_equal(Grid(distance).smoothed(), distance.astype(np.float32))


@pytest.mark.parametrize("offset", [-0.4, 0.3, 0.7])
@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.6, 0.0, 0.8), (1.0, 1.2, 0.9)])
def test_crossings_of_a_plane_are_where_it_cuts_the_axes(normal: tuple[float, float, float], offset: float) -> None:
    distance = plane(normal, offset)
    cells = np.argwhere(np.abs(distance) < 0.3 * CELL).astype(np.int32)
    cells = cells[((cells > 0) & (cells < SIDE - 1)).all(axis=1)]
    here = distance[tuple(cells.T)] / CELL
    unit = np.array(normal) / np.linalg.norm(normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = -here[:, None] / unit
    found = Grid(distance).subvoxel_offsets(cells)
    cut = np.abs(expected) <= 0.99
    assert cut.any()
    np.testing.assert_allclose(found[cut], expected[cut], atol=1e-3)
    # Along an axis that the plane does not cut nearby, the end of the cell that is nearer to it.
    towards = -np.sign(here[:, None] * unit)
    missed = (np.abs(expected) > 1.01) & (np.abs(unit) > 1e-9)
    np.testing.assert_array_equal(found[missed], 0.5 * towards[missed])


def test_a_crossing_needs_a_neighbor_that_was_measured() -> None:
    distance = plane((0.0, 0.0, 1.0), 0.2)
    weight = np.ones_like(distance)
    middle = SIDE // 2
    weight[:, :, middle] = 0.0  # the cells just behind the plane
    cell = np.array([[5, 5, middle - 1]], dtype=np.int32)
    assert Grid(distance).subvoxel_offsets(cell)[0, 2] == pytest.approx(0.7)
    assert Grid(distance, weight).subvoxel_offsets(cell)[0, 2] == 0.5
