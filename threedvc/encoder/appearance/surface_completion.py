# SPDX-License-Identifier: MIT
"""Guess where surfaces are that colour pictures show and no depth was measured of.

Shining, dark and far things, and what only the colour camera sees, leave holes. Each hole gets cells where the depth
around it suggests a surface; they form an object that is drawn in colour only, behind all others, with wide cells, for
their place is a guess.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.morton import morton_order
from threedvc.config import RenderConfig
from threedvc.encoder.fusion.surface_extraction import Surface
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.render.hole_filling import fill_unknown
from threedvc.render.ray_grid import RayGrid
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer

__all__ = ["Guess", "guess_surfaces"]

RAYS = 20_000
MIN_RAYS = 3
WIDTH = 2.5
"""Edge of a guessed cell in cells of the background."""
RAYS_PER_CELL = 2.0
"""Least edge of a guessed cell in rays, so that enough of them fall into it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Guess:
    """Guessed cells of the background.

    Attributes
    ----------
    surface
        The cells; their colours are grey.
    voxel_size_m
        Edge of a cell.
    """

    surface: Surface
    voxel_size_m: float


class _Rays:
    """The rays of a colour camera that look for holes."""

    def __init__(self, rig: CameraRig, threads: int) -> None:
        self.stride = max(1, round(np.sqrt(rig.color.width * rig.color.height / RAYS)))
        self.T_color_depth = rig.T_color_depth
        self.grid = RayGrid(rig.color.every(self.stride), apart=True)
        self.renderer = Renderer(rig, RenderConfig(supersample=1, threads=threads))


def guess_surfaces(
    rigs: Sequence[CameraRig],
    views: Iterable[tuple[int, int, Mapping[int, Pose], Pose]],
    models: Mapping[int, RenderModel],
    distance_m: float,
    threads: int,
) -> Guess:
    """Fill the holes of colour pictures, frame by frame, with cells that earlier frames have not put there yet.

    Parameters
    ----------
    rigs
        Cameras of every sensor.
    views
        Numbers of a frame and of its sensor, poses T_camera_object of the objects (that of 0 among them) before the
        sensor, and T_shifted_camera.
    models
        The objects, by number.
    distance_m
        How far away the scene is.
    threads
        Number of threads.
    """
    each_rays = [_Rays(rig, threads) for rig in rigs]
    ray_m = max(rays.stride * distance_m / rig.color.fx for rays, rig in zip(each_rays, rigs, strict=True))
    size = max(WIDTH * models[0].model.voxel_size_m, RAYS_PER_CELL * ray_m)
    guessed = RenderModel(DecodedModel(size, guessed=True))
    seen: list[NDArray[np.int32]] = [np.empty(0, dtype=np.int32)]
    number = max(models) + 1
    for frame, sensor, poses, T_shifted_camera in views:
        rays, renderer = each_rays[sensor].grid, each_rays[sensor].renderer
        T_color_camera = compose(each_rays[sensor].T_color_depth, T_shifted_camera)
        moved = {each: compose(T_color_camera, pose) for each, pose in poses.items()}
        depth, labels = renderer.cast(rays, models, moved)
        if not depth.any():
            continue
        filled = _filled(depth.reshape(rays.height, rays.width)).ravel()
        behind = {**moved, number: moved[0]}
        known, _ = renderer.cast_guessed(rays, {**models, number: guessed}, behind, depth, labels)
        holes = np.flatnonzero(known == 0)
        points = np.concatenate([rays.slopes[holes], np.ones((len(holes), 1))], axis=1) * filled[holes, None]
        T = inverse(moved[0])
        cells = np.floor((points @ T[:3, :3].T + T[:3, 3]) / size).astype(np.int32)
        cells, counts = np.unique(cells, axis=0, return_counts=True)
        cells = cells[counts >= MIN_RAYS]
        positions = guessed.model.index.locate(cells)
        fresh = positions < 0
        fresh[~fresh] = guessed.model.occupied.reshape(-1)[positions[~fresh]] == 0
        cells = cells[fresh]
        if len(cells):
            cells = cells[morton_order(cells)]
            guessed.model.apply(ModelUpdate.adding(cells, np.full((len(cells), 3), 128, dtype=np.int16)))
            guessed.refresh(threads)
            seen.append(np.full(len(cells), frame, dtype=np.int32))
    return _guess(guessed.model, seen)


def _filled(depth: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return a depth picture (h, w) whose holes are interpolated in inverse depth."""
    known = (depth > 0).astype(np.uint8)
    inverse_depth = np.where(depth > 0, 1 / np.maximum(depth, np.float32(1e-3)), np.float32(0))
    value = np.repeat(inverse_depth[..., None].astype(np.float32), 3, axis=2)
    fill_unknown(value, known)
    return 1 / np.maximum(value[..., 0].astype(np.float64), 1e-3)


def _guess(model: DecodedModel, seen: list[NDArray[np.int32]]) -> Guess:
    """Return all cells in Morton order; one is due when the first of all is, as they are few."""
    cells, colors = model.cells()
    first = int(np.concatenate(seen).min()) if len(cells) else 0
    return Guess(
        surface=Surface(
            cells=cells,
            colors=colors,
            first_seen=np.full(len(cells), first, dtype=np.int32),
            crossings=np.zeros((len(cells), 3), dtype=np.float32),
        ),
        voxel_size_m=model.voxel_size_m,
    )
