# SPDX-License-Identifier: MIT
"""Redraw a frame: first-opacity ray casting of all objects at their poses, composited by depth.

Both sides run this on decoded models. Only + - * /, sqrt and floor are used, rays are independent of
each other, and colours are summed in a fixed order: the pictures are the same on every machine and
for any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.block_index import BLOCK_CELLS, BlockIndex
from threedvc.camera import CameraRig
from threedvc.config import RenderConfig
from threedvc.kernels.hole_filling import pull, push
from threedvc.kernels.ray_sampling import interpolate_between
from threedvc.kernels.raycast import OPACITY, cast_rays
from threedvc.kernels.render_blocks import build_block, fit_planes
from threedvc.object_model import DecodedModel
from threedvc.parallel import for_ranges
from threedvc.pose import Pose, compose
from threedvc.ray_grid import RayGrid, cells_from_camera

__all__ = ["Picture", "RenderModel", "Renderer"]

BORDERED_CELLS = 9**3
PLANE_WEIGHTS = np.array([0.25, 0.75, 1.0, 0.75, 0.25])
SMALL_PICTURE = 320 * 240
MIN_RAYS_PER_CELL = 2.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A drawn frame.

    Attributes
    ----------
    color
        (h, w, 3) uint8 RGB in the colour camera.
    depth
        (h, w) float32 metres in the depth camera, 0 = nothing there.
    labels
        (h, w) uint8 object numbers in the depth camera, 0 = background or nothing.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    labels: NDArray[np.uint8]


class RenderModel:
    """A decoded model in the form that rays walk through; kept up to date by `refresh`."""

    def __init__(self, model: DecodedModel) -> None:
        self.model = model
        self.index = BlockIndex()
        self.skip = np.zeros((0, BLOCK_CELLS), dtype=np.uint8)
        self.corners = np.zeros((0, BLOCK_CELLS), dtype=np.uint8)
        self.plane = np.zeros((0, BORDERED_CELLS, 4), dtype=np.int8)
        self.color = np.zeros((0, BORDERED_CELLS, 3), dtype=np.int16)
        self._planes = np.zeros((0, BLOCK_CELLS, 4), dtype=np.int8)
        self._version = 0

    def refresh(self, threads: int) -> None:
        """Rebuild the blocks around everything that changed since the last call."""
        model = self.model
        changed, self._version = model.changed_since(self._version), model.version
        if not len(changed):
            return
        if len(model.occupied) > len(self._planes):
            more = np.zeros((len(model.occupied) - len(self._planes), BLOCK_CELLS, 4), dtype=np.int8)
            self._planes = np.concatenate([self._planes, more])
        around = _shifted(changed, (-1, 0, 1))
        positions = model.index.locate(around * 8)
        numbers = positions[positions >= 0] // BLOCK_CELLS

        def plane_range(start: int, stop: int) -> None:
            fit_planes(
                numbers,
                start,
                stop,
                model.index.coords,
                model.index.tables,
                model.occupied,
                PLANE_WEIGHTS,
                self._planes,
            )

        for_ranges(plane_range, len(numbers), threads)
        self._build(_shifted(model.index.coords[numbers], (-1, 0)), threads)

    def _build(self, blocks: NDArray[np.int32], threads: int) -> None:
        skip = np.empty((len(blocks), BLOCK_CELLS), dtype=np.uint8)
        corners = np.empty((len(blocks), BLOCK_CELLS), dtype=np.uint8)
        plane = np.empty((len(blocks), BORDERED_CELLS, 4), dtype=np.int8)
        color = np.empty((len(blocks), BORDERED_CELLS, 3), dtype=np.int16)
        targets = np.arange(len(blocks))
        model = self.model

        def block_range(start: int, stop: int) -> None:
            build_block(
                targets, blocks, start, stop, model.index.tables, model.occupied, self._planes, model.color, skip,
                corners, plane, color,
            )  # fmt: skip

        for_ranges(block_range, len(blocks), threads)
        keep = (skip == 0).any(axis=1) | (self.index.locate(blocks * 8) >= 0)
        self.index.insert(blocks[keep])
        self._grow()
        slots = self.index.locate(blocks[keep] * 8) // BLOCK_CELLS
        self.skip[slots], self.corners[slots] = skip[keep], corners[keep]
        self.plane[slots], self.color[slots] = plane[keep], color[keep]

    def _grow(self) -> None:
        more = max(self.index.count, len(self.skip) * 3 // 2) - len(self.skip)
        if self.index.count <= len(self.skip):
            return
        for name in ("skip", "corners", "plane", "color"):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.zeros((more, *array.shape[1:]), dtype=array.dtype)]))


def _shifted(blocks: NDArray[np.int32], shifts: tuple[int, ...]) -> NDArray[np.int32]:
    """Return the distinct blocks reached from `blocks` (n, 3) by any combination of shifts."""
    offsets = np.array([(x, y, z) for x in shifts for y in shifts for z in shifts], dtype=np.int32)
    return np.unique((blocks[:, None] + offsets).reshape(-1, 3), axis=0)


class Renderer:
    """Draws models for one rig; keeps the rays of its cameras.

    Parameters
    ----------
    rig
        Cameras of the pictures to draw.
    config
        See `RenderConfig`.
    """

    def __init__(self, rig: CameraRig, config: RenderConfig | None = None) -> None:
        self.rig = rig
        self.config = config or RenderConfig()
        small = rig.color.width * rig.color.height <= SMALL_PICTURE
        self.supersample = self.config.supersample or (2 if small else 1)
        self._depth_rays = RayGrid(rig.depth, 1)
        one_cast = rig.registered and self.supersample == 1
        self._color_rays = self._depth_rays if one_cast else RayGrid(rig.color, self.supersample)

    def draw(self, models: Mapping[int, RenderModel], poses: Mapping[int, Pose], *, color: bool = True) -> Picture:
        """Draw one frame.

        Parameters
        ----------
        models
            Objects by number, refreshed.
        poses
            T_camera_object of every object to draw, for the depth camera.
        color
            False leaves the colour picture black and saves its rays.

        Returns
        -------
        Picture
            Pixels that no ray of theirs finds an object for have depth 0; their colour is interpolated
            from around.
        """
        rig, rays = self.rig, self._depth_rays
        one_cast = self._color_rays is rays
        depth, shade, labels = self._cast(rays, models, poses, color and one_cast)
        if color and not one_cast:
            moved = {number: compose(rig.T_color_depth, poses[number]) for number in poses}
            hit, shade, _ = self._cast(self._color_rays, models, moved, True)
        else:
            hit = depth
        picture = self._pixels(shade, hit) if color else np.zeros((rig.color.height, rig.color.width, 3), np.uint8)
        shape = (rig.depth.height, rig.depth.width)
        return Picture(color=picture, depth=depth.reshape(shape), labels=labels.reshape(shape))

    def _cast(
        self, rays: RayGrid, models: Mapping[int, RenderModel], poses: Mapping[int, Pose], with_color: bool
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
        """Cast every second ray of every second row, then those between that cannot be interpolated."""
        count = len(rays.slopes)
        depth = np.zeros(count, dtype=np.float32)
        color = np.zeros((count, 3), dtype=np.float32)
        labels = np.zeros(count, dtype=np.uint8)
        casts = [
            self._caster(rays, models[number], number, poses[number], with_color, depth, color, labels)
            for number in sorted(poses)
            if models[number].index.count
        ]
        for cast in casts:
            cast(rays.sparse)
        wanted = np.ones(count, dtype=np.uint8)
        wanted[rays.sparse] = 0
        shown = [models[number].model.voxel_size_m for number in poses if models[number].index.count]
        if shown and _cell_is_wide(min(shown), depth[rays.sparse], rays.fx):

            def between(start: int, stop: int) -> None:
                interpolate_between(start, stop, rays.width, rays.height, depth, color, labels, wanted)

            for_ranges(between, (rays.height + 1) // 2, self.config.threads)
        rest = rays.order[wanted[rays.order] != 0]
        for cast in casts:
            cast(rest)
        return depth, color, labels

    def _caster(
        self,
        rays: RayGrid,
        model: RenderModel,
        number: int,
        pose: Pose,
        with_color: bool,
        depth: NDArray[np.float32],
        color: NDArray[np.float32],
        labels: NDArray[np.uint8],
    ) -> Callable[[NDArray[np.int64]], None]:
        """Return a function that casts the rays of given numbers into one object."""
        T_cells_camera = cells_from_camera(pose, model.model.voxel_size_m)
        near, far = rays.ranges(model.index, pose, model.model.voxel_size_m)

        def cast(order: NDArray[np.int64]) -> None:
            def ray_range(start: int, stop: int) -> None:
                cast_rays(
                    rays.slopes, order, start, stop, T_cells_camera, rays.origin, rays.size, near, far,
                    model.index.coords, model.index.tables, model.skip, model.corners, model.plane, model.color, number,
                    with_color, OPACITY, depth, color, labels,
                )  # fmt: skip

            for_ranges(ray_range, len(order), self.config.threads)

        return cast

    def _pixels(self, color: NDArray[np.float32], depth: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Average the rays of each pixel and fill what none of them hit."""
        camera, s = self.rig.color, self.supersample
        if s == 1:
            value: NDArray[np.float32] = color.reshape(camera.height, camera.width, 3)
            known = (depth > 0).astype(np.uint8).reshape(camera.height, camera.width)
        else:
            shade = color.reshape(camera.height, s, camera.width, s, 3)
            hits = (depth > 0).astype(np.float32).reshape(camera.height, s, camera.width, s, 1)
            rays = [(i, j) for i in range(s) for j in range(s)]
            weight = np.zeros((camera.height, camera.width, 1), np.float32)
            total = np.zeros((camera.height, camera.width, 3), np.float32)
            for i, j in rays:
                weight += hits[:, i, :, j]
                total += shade[:, i, :, j]
            value = np.asarray(total / np.maximum(weight, np.float32(1)), dtype=np.float32)
            known = (weight[..., 0] > 0).astype(np.uint8)
        _fill(value, known)
        return np.asarray(np.clip(value, 0, 255) + np.float32(0.5)).astype(np.uint8)


def _cell_is_wide(voxel_size_m: float, depth: NDArray[np.float32], fx: float) -> bool:
    """Tell whether cells are wide enough against the rays that every second ray meets them all."""
    hits = depth[depth > 0]
    return len(hits) > 0 and voxel_size_m * fx >= MIN_RAYS_PER_CELL * float(np.median(hits))


def _fill(value: NDArray[np.float32], known: NDArray[np.uint8]) -> None:
    """Fill pixels (h, w, 3) where `known` (h, w) is 0 from ever coarser levels (pull-push)."""
    if known.all() or value.shape[0] * value.shape[1] == 1:
        return
    height, width = -(-value.shape[0] // 2), -(-value.shape[1] // 2)
    coarse, coarse_known = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.uint8)
    pull(value, known, coarse, coarse_known)
    _fill(coarse, coarse_known)
    push(value, known, coarse)
