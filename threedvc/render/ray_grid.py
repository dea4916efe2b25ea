# SPDX-License-Identifier: MIT
"""The rays of a camera, and the tiles of the slope plane that bound how near and far they can hit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse
from threedvc.kernels.render.raycast import FAR
from threedvc.kernels.render.tiles import tile_ranges
from threedvc.model.block_index import BlockIndex

__all__ = ["RayGrid", "cells_from_camera"]

TILES = 64
"""Tiles along each side of the slope plane: ten pixels of 640, about as wide as a block is seen."""
PACKET_SIDE = 16
"""Rays along each side of what is cast one after another: they meet the same blocks (decision 0006)."""
TILE_SLACK = 1e-9
"""Added to the extent of a tile in slopes, so that rounding puts no ray beyond the last."""


class RayGrid:
    """One ray through every pixel, or several.

    Parameters
    ----------
    camera
        The camera.
    supersample
        Rays along each side of a pixel.
    apart
        Whether rays are too far apart to tell of what is between them: then all of them are of the first level.

    Attributes
    ----------
    width, height
        Number of rays along each side.
    slopes
        (n, 2) float64 undistorted slopes, row by row.
    order
        Numbers of all rays, packet by packet: neighbors meet the same blocks while these are at hand.
    levels
        The same numbers, by the step in which they are cast or interpolated: of those at multiples of 4 half, like
        one color of a chessboard, then the other half; half and half of the rest of those at multiples of 2; others.
    origin, size
        (2,) first corner and extent of a tile.
    """

    def __init__(self, camera: Camera, supersample: int = 1, *, apart: bool = False) -> None:
        fine = camera.resized(camera.width * supersample, camera.height * supersample) if supersample > 1 else camera
        self.width, self.height = fine.width, fine.height
        rows, columns = np.divmod(np.arange(fine.width * fine.height), fine.width)
        self.order = np.lexsort((columns, rows, columns // PACKET_SIDE, rows // PACKET_SIDE))
        level = np.full(len(rows), 4)
        for step, stage in ((2, 2), (4, 0)):
            on = (rows | columns) % step == 0
            level[on] = stage + (((rows ^ columns)[on] & step) != 0)
        self.levels = [self.order] if apart else [self.order[level[self.order] == stage] for stage in range(5)]
        self.slopes = np.ascontiguousarray(fine.rays().reshape(-1, 2))
        low, high = self.slopes.min(axis=0), self.slopes.max(axis=0)
        self.origin = low
        self.size = (high - low) / TILES + TILE_SLACK

    def ranges(
        self, index: BlockIndex, T_camera_object: Pose, voxel_size_m: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return nearest and furthest depth (TILES, TILES) at which a block can be met; near > far: none."""
        near, far = np.full((TILES, TILES), FAR), np.zeros((TILES, TILES))
        T = T_camera_object[:3].copy()
        T[:, 3] += (T[:, 0] + T[:, 1] + T[:, 2]) * (0.5 * voxel_size_m)
        T[:, :3] *= voxel_size_m
        tile_ranges(index.coords, index.count, T, self.origin, self.size, near, far)
        return near, far


def cells_from_camera(T_camera_object: Pose, voxel_size_m: float) -> NDArray[np.float64]:
    """Return the (3, 4) map from camera coordinates in meters to cells whose centers are integers."""
    T = inverse(T_camera_object)[:3] / voxel_size_m
    T[:, 3] -= 0.5
    return T
