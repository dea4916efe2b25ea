# SPDX-License-Identifier: MIT
"""Tiles of the slope plane, and between which depths their rays may meet the blocks of an object."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.blocks import BLOCK_RADIUS, BLOCK_SIDE

__all__ = ["Tiles", "tile_ranges"]

MIN_FRONT = 0.1
"""Radii from the camera within which a block counts for all tiles: its slopes would reach too far."""
MAX_TILE = 1e6
"""Far beyond all tiles, and an integer still."""


class Tiles(NamedTuple):
    """Tiles of the slope plane, and the depths between which each may meet something.

    Attributes
    ----------
    origin, size
        (2,) slope of the first tile's corner, and extent of a tile, along x and y.
    near, far
        (rows, columns) float64 meters.
    """

    origin: NDArray[np.float64]
    size: NDArray[np.float64]
    near: NDArray[np.float64]
    far: NDArray[np.float64]


@kernel
def tile_at(slope, origin, size):
    """Return the number of the tile, along one axis, that a slope lies in."""
    return np.int64(np.floor(max(min((slope - origin) / size, MAX_TILE), -MAX_TILE)))


@kernel
def tile_ranges(coords, count, T_camera_cells, tile_origin, tile_size, near, far):
    """Widen the depth range of every tile of the slope plane by the blocks that it can see.

    Parameters
    ----------
    coords
        (blocks, 3) block coordinates; the first `count` are in use.
    T_camera_cells
        (3, 4) from shifted cell coordinates to the camera.
    tile_origin, tile_size
        (2,) slope of the first tile's corner, and extent of a tile, along x and y.
    near, far
        (rows, columns) float64, updated.
    """
    T = T_camera_cells
    scale = np.sqrt(T[0, 0] * T[0, 0] + T[1, 0] * T[1, 0] + T[2, 0] * T[2, 0])
    radius = BLOCK_RADIUS * scale
    rows, columns = near.shape
    for b in range(count):
        bx, by, bz = coords[b, 0] + 0.5, coords[b, 1] + 0.5, coords[b, 2] + 0.5
        cx, cy, cz = bx * BLOCK_SIDE, by * BLOCK_SIDE, bz * BLOCK_SIDE
        z = T[2, 0] * cx + T[2, 1] * cy + T[2, 2] * cz + T[2, 3]
        if z < -radius:
            continue
        front, back = max(z - radius, 0.0), z + radius
        left, right, top, bottom = 0, columns - 1, 0, rows - 1
        if front > MIN_FRONT * radius:
            x = T[0, 0] * cx + T[0, 1] * cy + T[0, 2] * cz + T[0, 3]
            y = T[1, 0] * cx + T[1, 1] * cy + T[1, 2] * cz + T[1, 3]
            low_x, high_x = (
                min((x - radius) / front, (x - radius) / back),
                max((x + radius) / front, (x + radius) / back),
            )
            low_y, high_y = (
                min((y - radius) / front, (y - radius) / back),
                max((y + radius) / front, (y + radius) / back),
            )
            left = max(left, tile_at(low_x, tile_origin[0], tile_size[0]))
            right = min(right, tile_at(high_x, tile_origin[0], tile_size[0]))
            top = max(top, tile_at(low_y, tile_origin[1], tile_size[1]))
            bottom = min(bottom, tile_at(high_y, tile_origin[1], tile_size[1]))
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                near[row, column] = min(near[row, column], front)
                far[row, column] = max(far[row, column], back)
