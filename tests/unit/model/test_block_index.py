# SPDX-License-Identifier: MIT
"""The block index against a dictionary."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from threedvc.errors import LimitExceeded
from threedvc.model.block_index import BLOCK_CELLS, BLOCK_SIDE, BlockIndex, morton_keys

FARTHEST = (1 << 17) - 1


def blocks_of(*rows: tuple[int, int, int]) -> NDArray[np.int32]:
    return np.array(rows, dtype=np.int32).reshape(-1, 3)


def interleaved(cell: NDArray[np.int32]) -> int:
    """Return the Morton key of one cell, bit by bit."""
    places = [int(value) + (1 << 20) for value in cell]
    return sum((place >> bit & 1) << (3 * bit + axis) for axis, place in enumerate(places) for bit in range(21))


def place_in_block(cell: NDArray[np.int32]) -> int:
    x, y, z = (int(value) % BLOCK_SIDE for value in cell)
    return x + BLOCK_SIDE * (y + BLOCK_SIDE * z)


coordinates = st.one_of(st.integers(-3, 3), st.integers(-200, 200))
block_lists = st.lists(st.lists(st.tuples(coordinates, coordinates, coordinates), max_size=20), max_size=5)


@given(block_lists)
def test_numbers_blocks_like_a_dictionary(rounds: list[list[tuple[int, int, int]]]) -> None:
    index, known = BlockIndex(), set[tuple[int, int, int]]()
    positions: dict[tuple[int, int, int], int] = {}
    for rows in rounds:
        assert index.insert(blocks_of(*rows)) == len(set(rows) - known)
        known |= set(rows)
        assert index.count == len(known)
        # A block keeps its number when others come.
        for block in sorted(known):
            (position,) = index.locate(blocks_of(block) * BLOCK_SIDE)
            assert positions.setdefault(block, position) == position
            assert tuple(index.coords[position // BLOCK_CELLS]) == block
    assert sorted(positions.values()) == [BLOCK_CELLS * number for number in range(len(known))]


def test_every_cell_has_its_place(rng: np.random.Generator) -> None:
    index = BlockIndex()
    index.insert(blocks_of((0, 0, 0), (-1, 2, -70), (500, -3, 9)))
    cells = (index.coords[rng.integers(0, 3, 200)] * BLOCK_SIDE + rng.integers(0, 8, (200, 3))).astype(np.int32)
    positions = index.locate(cells)
    assert [position % BLOCK_CELLS for position in positions] == [place_in_block(cell) for cell in cells]
    np.testing.assert_array_equal(index.coords[positions // BLOCK_CELLS], cells // BLOCK_SIDE)


@pytest.mark.parametrize("far", [0, 8, -1, 64, 10_000, -(1 << 31), (1 << 31) - 1])
def test_absent_cells_have_no_position(far: int) -> None:
    index = BlockIndex()
    assert index.locate(blocks_of((far, 0, 0))).tolist() == [-1]
    index.insert(blocks_of((1, 1, 1)))
    assert index.locate(blocks_of((far, 0, 0), (8, 8, far), (9, 10, 11)))[:2].tolist() == [-1, -1 if far != 8 else 0]


def test_takes_views_and_other_integers(rng: np.random.Generator) -> None:
    index = BlockIndex()
    wide = rng.integers(-50, 50, (40, 6))
    index.insert(wide[::2, ::2].astype(np.int32))
    cells = wide[::2, ::2] * BLOCK_SIDE
    expected = index.locate(np.ascontiguousarray(cells, dtype=np.int32))
    assert np.all(expected >= 0)
    np.testing.assert_array_equal(index.locate(cells), expected)
    np.testing.assert_array_equal(index.locate(cells.astype(np.int32)[::-1]), expected[::-1])


def test_nothing_is_inserted_for_no_blocks() -> None:
    index = BlockIndex()
    assert index.insert(blocks_of()) == 0
    assert index.count == 0
    assert len(index.locate(blocks_of())) == 0


@pytest.mark.parametrize("block", [(FARTHEST + 1, 0, 0), (0, -FARTHEST - 1, 0), (0, 0, -(1 << 31))])
def test_blocks_out_of_range_are_refused(block: tuple[int, int, int]) -> None:
    index = BlockIndex()
    index.insert(blocks_of((1, 2, 3)))
    with pytest.raises(LimitExceeded, match=r"further than 2\^20 cells from the origin; use larger cells"):
        index.insert(blocks_of((0, 0, 0), block))
    assert (index.count, index.locate(blocks_of((0, 0, 0))).tolist()) == (1, [-1])


def test_blocks_too_far_apart_are_refused_before_memory_is_taken() -> None:
    index = BlockIndex()
    index.insert(blocks_of((-FARTHEST, 0, 0), (FARTHEST, 0, 0)))
    with pytest.raises(LimitExceeded, match="cells lie 2097152 cells apart; use larger cells or a maximum depth"):
        index.insert(blocks_of((0, -FARTHEST, -FARTHEST), (0, FARTHEST, FARTHEST)))
    assert index.count == 2
    assert np.all(index.locate(blocks_of((-FARTHEST, 0, 0), (FARTHEST, 0, 0)) * BLOCK_SIDE) >= 0)


def test_too_many_blocks_are_refused() -> None:
    index = BlockIndex()
    index.insert(blocks_of((-1, -1, -1)))
    side = np.arange(64, dtype=np.int32)
    every = np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3)
    with pytest.raises(LimitExceeded, match="more than 262144 blocks of 8x8x8 cells is too large; use larger cells"):
        index.insert(every)
    assert index.count == 1


def test_storage_of_a_sparse_room_stays_small() -> None:
    index = BlockIndex()
    x, y = np.mgrid[0:60, 0:60]
    walls = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    index.insert(np.concatenate([walls, walls + np.array([0, 0, 40])]).astype(np.int32))
    assert index.count == 7200
    assert sum(table.nbytes for table in index.tables) + index.coords.nbytes < 100 * index.count


@given(st.lists(st.tuples(*[st.integers(-(1 << 20), (1 << 20) - 1)] * 3), min_size=1, max_size=20))
def test_morton_keys_interleave_bits(rows: list[tuple[int, int, int]]) -> None:
    cells = blocks_of(*rows)
    assert morton_keys(cells).tolist() == [interleaved(cell) for cell in cells]


def test_flagged_cells_come_in_morton_order(rng: np.random.Generator) -> None:
    index = BlockIndex()
    for _ in range(3):
        index.insert(rng.integers(-9, 9, (10, 3)).astype(np.int32))
    flags = (rng.random((index.count, BLOCK_CELLS)) < 0.01).astype(np.uint8) * 7
    cells, positions = index.flagged(flags)
    assert len(cells) == np.count_nonzero(flags)
    assert np.all(flags.reshape(-1)[positions] == 7)
    np.testing.assert_array_equal(index.locate(cells), positions)
    keys = [interleaved(cell) for cell in cells]
    assert keys == sorted(keys)


def test_no_flags_no_cells() -> None:
    index = BlockIndex()
    cells, positions = index.flagged(np.zeros((0, BLOCK_CELLS), dtype=np.uint8))
    assert (cells.shape, positions.shape) == ((0, 3), (0,))
