# SPDX-License-Identifier: MIT
"""Infer where surfaces are that color pictures show and no depth was measured of.

Shining, dark and far things, and what only the color camera sees, leave holes. Each hole gets cells where the depth
around it suggests a surface; they form an object that is drawn in color only, behind all others, with wide cells, for
their place is a guess.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats
from threedvc.coding.morton import morton_order
from threedvc.config import RenderConfig
from threedvc.encoder.appearance.fit_state import CompletedSurface, FitState
from threedvc.encoder.appearance.samples import rays_at
from threedvc.encoder.fusion.surface_extraction import Surface
from threedvc.frames.sequence import sampling_stride
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.render.hole_filling import fill_unknown
from threedvc.render.ray_grid import RayGrid
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer

__all__ = ["complete_surfaces"]

MAX_FRAMES = 60
"""That are searched for holes; those of others are the same ones."""
MAX_LABEL = 255
"""Labels of pixels are bytes."""
MIN_CELLS = 32
"""Fewer are not worth an object of their own."""
RAYS = 20_000
"""About how many of a frame look for holes."""
MIN_RAYS = 3
"""That must fall into a hole where a cell is to be: fewer are the rim of a surface."""
CELL_RATIO = 2.5
"""Edge of an inferred cell in cells of the background; measured: 1.6 and 3.5 do the same."""
RAYS_PER_CELL = 2.0
"""Least edge of an inferred cell in rays, so that enough of them fall into it."""
MIN_DEPTH_M = 1e-3
"""Nothing is measured nearer."""
MIN_INVERSE_DEPTH_PER_M = 1e-3
"""What is interpolated is no further than a kilometer."""
UNKNOWN_COLOR = 128
"""Until the fit knows better."""


class _View(NamedTuple):
    """A frame, its sensor, poses T_camera_object of the objects before that, and T_shifted_camera."""

    frame: int
    sensor: int
    poses: Mapping[int, Pose]
    T_shifted_camera: Pose


def complete_surfaces(state: FitState) -> None:
    """Add surfaces where the color pictures of a moving camera show something and the model has nothing."""
    scene, count = state.scene, len(state.frames)
    free = [number for number in range(1, MAX_LABEL + 1) if number not in scene.objects]
    if scene.objects[0].at_rest or not free or not state.surfaces[0].cells.size:
        return
    views = (
        _View(frame, state.sensor_of(frame), poses, state.shifts[frame])
        for frame in range(0, count, sampling_stride(count, MAX_FRAMES, scene.info))
        if 0 in (poses := state.poses_in(frame))
    )
    models = state.colors.models
    searches = [_HoleSearch(rig, state.threads) for rig in scene.info.rigs]
    ray_m = max(search.ray_m(scene.distance_m) for search in searches)
    size = max(CELL_RATIO * models[0].model.voxel_size_m, RAYS_PER_CELL * ray_m)
    surface = _inferred_surface(searches, views, models, size, state.threads)
    if len(surface.cells) >= MIN_CELLS:
        state.complete(CompletedSurface(number=free[-1], surface=surface, voxel_size_m=size))


class _HoleSearch:
    """The rays of a color camera that look for holes."""

    def __init__(self, rig: CameraRig, threads: int) -> None:
        self._rig = rig
        self._stride: int = max(1, round(np.sqrt(rig.color.width * rig.color.height / RAYS)))
        self._grid = RayGrid(rig.color.every(self._stride), apart=True)
        self._renderer = Renderer(rig, RenderConfig(supersample=1, threads=threads))

    def ray_m(self, distance_m: float) -> float:
        """Return how far rays are apart at a distance."""
        return float(self._stride * distance_m / self._rig.color.fx)

    def points(self, view: _View, models: Mapping[int, RenderModel], inferred: RenderModel) -> Doubles:
        """Return points (n, 3) of the background, in its frame, in the holes that a frame shows.

        They are where the depth around them suggests; neither the models nor what is inferred so far is met there.
        """
        T_color_camera = compose(self._rig.T_color_depth, view.T_shifted_camera)
        poses = {number: compose(T_color_camera, pose) for number, pose in view.poses.items()}
        depth, labels = self._renderer.cast(self._grid, models, poses)
        if not depth.any():
            return np.zeros((0, 3))
        number = max(models) + 1
        everything, all_poses = {**models, number: inferred}, {**poses, number: poses[0]}
        known, _ = self._renderer.cast_guessed(self._grid, everything, all_poses, depth, labels)
        holes = np.flatnonzero(known == 0)
        filled = _filled(depth.reshape(self._grid.height, self._grid.width)).ravel()
        T = inverse(poses[0])
        return np.asarray(rays_at(self._grid.slopes[holes], filled[holes]) @ T[:3, :3].T + T[:3, 3])


def _inferred_surface(
    searches: Sequence[_HoleSearch],
    views: Iterable[_View],
    models: Mapping[int, RenderModel],
    voxel_size_m: float,
    threads: int,
) -> Surface:
    """Fill holes frame by frame with cells that earlier frames have not put there yet.

    They are in Morton order; all are due when the first of them is, as they are few.
    """
    inferred = RenderModel(DecodedModel(voxel_size_m, guessed=True))
    first_seen: list[int] = []
    for view in views:
        cells = _new_cells(searches[view.sensor].points(view, models, inferred), inferred.model)
        if len(cells):
            cells = cells[morton_order(cells)]
            gray = np.full((len(cells), 3), UNKNOWN_COLOR, dtype=np.int16)
            inferred.model.apply(ModelUpdate.adding(cells, gray))
            inferred.refresh(threads)
            first_seen.append(view.frame)
    cells, colors = inferred.model.cells()
    return Surface(
        cells=cells,
        colors=colors,
        first_seen=np.full(len(cells), min(first_seen, default=0), dtype=np.int32),
        subvoxel_offsets=np.zeros((len(cells), 3), dtype=np.float32),
    )


def _new_cells(points: Doubles, model: DecodedModel) -> NDArray[np.int32]:
    """Return the cells (n, 3) that enough of the points (n, 3) fall into, without those that a model has."""
    cells = np.floor(points / model.voxel_size_m).astype(np.int32)
    cells, counts = np.unique(cells, axis=0, return_counts=True)
    cells = cells[counts >= MIN_RAYS]
    positions = model.index.locate(cells)
    fresh = positions < 0
    fresh[~fresh] = model.occupied.reshape(-1)[positions[~fresh]] == 0
    return np.asarray(cells[fresh])


def _filled(depth: Floats) -> Doubles:
    """Return a depth picture (h, w) whose holes are interpolated in inverse depth."""
    known = (depth > 0).astype(np.uint8)
    inverse_depth = np.where(depth > 0, 1 / np.maximum(depth, np.float32(MIN_DEPTH_M)), np.float32(0))
    value = np.repeat(inverse_depth[..., None].astype(np.float32), 3, axis=2)
    fill_unknown(value, known)
    return 1 / np.maximum(value[..., 0].astype(np.float64), MIN_INVERSE_DEPTH_PER_M)
