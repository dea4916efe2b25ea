# SPDX-License-Identifier: MIT
"""Colors of rays that met a surface, of cells, background image and light; and pixels out of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, compose, identity, inverse
from threedvc.kernels.render.shading import SurfaceCells, relight, round_colors, shade, shade_from_picture
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.texture import ColorGrid
from threedvc.parallel import for_ranges
from threedvc.render.hole_filling import fill_unknown
from threedvc.render.picture import BackgroundImage, Light
from threedvc.render.ray_grid import RayGrid, cells_from_camera
from threedvc.render.render_model import RenderModel

__all__ = ["Gain", "Hits", "first_rays", "pixel_colors", "shaded_rays"]

Scalar = TypeVar("Scalar", np.float32, np.uint8)
Hits: TypeAlias = tuple[NDArray[np.float32], NDArray[np.uint8]]
"""Depth (rays,) meters along z, 0 where nothing is met, and number (rays,) of the object met."""
Gain: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Gain and offset (3,) of each channel."""
SAME_PLACE = 1e-9
"""A camera as near as this to that of the background image sees exactly its pixels, beyond all surfaces as well.
Every reader must use it."""


def shaded_rays(
    rays: RayGrid,
    hits: Hits,
    models: Mapping[int, RenderModel],
    poses: Mapping[int, Pose],
    backdrop: BackgroundImage | None,
    lights: Mapping[int, Light],
    threads: int,
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return colors (rays, 3) and which of them are known (rays,): those of rays that met a colored cell."""
    depth, labels = hits
    color, known = np.zeros((len(depth), 3), dtype=np.float32), np.zeros(len(depth), dtype=np.uint8)
    if backdrop is not None:
        _shade_background(rays, hits, poses.get(0, identity()), backdrop, color, known, threads)
    for number in sorted(poses):
        for grid in models[number].color_grids():
            T = cells_from_camera(poses[number], grid.cell_size_m)

            def ray_range(start: int, stop: int, grid: ColorGrid = grid, T: Pose = T, number: int = number) -> None:
                shade(
                    start, stop, rays.slopes, depth, labels, number, T, grid.tables, grid.colored, grid.colors,
                    color, known,
                )  # fmt: skip

            for_ranges(ray_range, len(depth), threads)
        if number in lights:
            _relight(rays, hits, models[number].model, number, poses[number], lights[number], color, threads)
    return color, known


def first_rays(values: NDArray[Scalar], camera: Camera, supersample: int) -> NDArray[Scalar]:
    """Return of values of the color rays (rays,) those of every pixel's first one (h, w)."""
    s = supersample
    return np.ascontiguousarray(values.reshape(camera.height, s, camera.width, s)[:, 0, :, 0])


def pixel_colors(
    color: NDArray[np.float32],
    known: NDArray[np.uint8],
    camera: Camera,
    supersample: int,
    gain: Gain | None,
    threads: int,
) -> NDArray[np.uint8]:
    """Average the rays of each pixel and fill what none of them hit; return the picture (h, w, 3)."""
    s = supersample
    if s == 1:
        value: NDArray[np.float32] = color.reshape(camera.height, camera.width, 3)
        known = known.reshape(camera.height, camera.width)
    else:
        value, known = _averaged(color, known, camera, s)
    fill_unknown(value, known)
    factor, offset = gain or (np.ones(3, np.float32), np.zeros(3, np.float32))
    picture = np.empty(value.shape, dtype=np.uint8)

    def row_range(start: int, stop: int) -> None:
        round_colors(start, stop, value, factor, offset, picture)

    for_ranges(row_range, len(value), threads)
    return picture


def _shade_background(
    rays: RayGrid,
    hits: Hits,
    T_camera_world: Pose,
    backdrop: BackgroundImage,
    color: NDArray[np.float32],
    known: NDArray[np.uint8],
    threads: int,
) -> None:
    """Color the rays that met the background, where its image shows it."""
    depth, labels = hits
    T_picture_camera = compose(backdrop.T_camera_world, inverse(T_camera_world))
    beyond = bool(np.abs(T_picture_camera - np.eye(4)).max() < SAME_PLACE)

    def ray_range(start: int, stop: int) -> None:
        shade_from_picture(
            start, stop, rays.slopes, depth, labels, T_picture_camera[:3], backdrop.camera.parameters(),
            backdrop.picture, beyond, color, known,
        )  # fmt: skip

    for_ranges(ray_range, len(depth), threads)


def _relight(
    rays: RayGrid,
    hits: Hits,
    model: DecodedModel,
    number: int,
    pose: Pose,
    light: Light,
    color: NDArray[np.float32],
    threads: int,
) -> None:
    depth, labels = hits
    T = cells_from_camera(pose, model.voxel_size_m)
    cells = SurfaceCells(model.index.tables, model.occupied.reshape(-1), model.planes.reshape(-1, 4))

    def ray_range(start: int, stop: int) -> None:
        relight(start, stop, rays.slopes, depth, labels, number, T, light.R_world_object, light.factors, cells, color)

    for_ranges(ray_range, len(depth), threads)


def _averaged(
    color: NDArray[np.float32], known: NDArray[np.uint8], camera: Camera, s: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return the mean color (h, w, 3) of the known rays of each pixel, and where there is any (h, w)."""
    shades = color.reshape(camera.height, s, camera.width, s, 3)
    hits = known.astype(np.float32).reshape(camera.height, s, camera.width, s, 1)
    weight = np.zeros((camera.height, camera.width, 1), np.float32)
    total = np.zeros((camera.height, camera.width, 3), np.float32)
    for i in range(s):
        for j in range(s):
            weight += hits[:, i, :, j]
            total += shades[:, i, :, j]
    value = np.asarray(total / np.maximum(weight, np.float32(1)), dtype=np.float32)
    return value, (weight[..., 0] > 0).astype(np.uint8)
