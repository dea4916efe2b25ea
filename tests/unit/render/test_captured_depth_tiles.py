# SPDX-License-Identifier: MIT
"""Tiles of a depth video: where it is shown and where the models are."""

from __future__ import annotations

import numpy as np
import pytest

from threedvc.errors import CorruptStream
from threedvc.render.captured_depth import (
    TILE,
    CapturedDepth,
    depth_levels,
    pack_tiles,
    tile_grid,
    tiles_of_pixels,
    unpack_tiles,
)

ROWS, COLUMNS = 20, 30


@pytest.fixture
def tiles() -> np.ndarray:
    tiles = np.zeros(tile_grid(ROWS, COLUMNS), np.bool_)
    tiles[1, 2] = tiles[0, 0] = True
    return tiles


def test_tiles_come_back(tiles: np.ndarray) -> None:
    np.testing.assert_array_equal(unpack_tiles(pack_tiles(tiles), ROWS, COLUMNS), tiles)


def test_all_tiles_take_no_bytes() -> None:
    assert pack_tiles(np.ones(tile_grid(ROWS, COLUMNS), np.bool_)) == b""
    assert unpack_tiles(b"", ROWS, COLUMNS) is None


@pytest.mark.parametrize("packed", [b"\x80", b"\x80\x00\x00", b"\x80\x01"])
def test_bits_that_are_no_tiles_are_damage(packed: bytes) -> None:
    with pytest.raises(CorruptStream, match="has 12 tiles"):
        unpack_tiles(packed, ROWS, COLUMNS)


def test_every_pixel_lies_in_the_tile_of_its_sample() -> None:
    down, across = tiles_of_pixels((ROWS, COLUMNS), (40, 45))
    assert down.tolist() == [y // 2 // TILE for y in range(40)]
    assert across.tolist() == [int((x + 0.5) * COLUMNS / 45) // TILE for x in range(45)]


def test_outside_of_the_tiles_the_models_are_shown(tiles: np.ndarray) -> None:
    samples = np.full((ROWS, COLUMNS), 100, np.uint16)
    drawn = np.full((2 * ROWS, 2 * COLUMNS), 5.0, np.float32)
    video = CapturedDepth(samples=samples, levels=depth_levels(1.0, 1.001, 10), complete=True, tiles=tiles)
    shown = video.shown(drawn, 1)
    everywhere = CapturedDepth(samples=samples, levels=video.levels, complete=True).shown(drawn, 1)
    down, across = tiles_of_pixels(samples.shape, drawn.shape)
    inside = tiles[down][:, across]
    assert 0 < np.count_nonzero(inside) < inside.size
    np.testing.assert_array_equal(shown, np.where(inside, everywhere, drawn))
