# SPDX-License-Identifier: MIT
"""The evidence as seen from a pose: what frames are registered with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats, Mask
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.registration.frame_resolutions import Downsampled, FrameResolutions, ObjectView
from threedvc.encoder.registration.registration_types import ModelView
from threedvc.geometry.pose import Pose
from threedvc.kernels.encoder.raycast_evidence import EvidenceCells, ViewRays, cast_evidence, fill_between
from threedvc.kernels.render.tiles import Tiles
from threedvc.parallel import for_ranges
from threedvc.render.ray_grid import cells_from_camera

__all__ = ["predicted_and_measured_depth", "raycast_model"]


def raycast_model(
    model: EvidenceModel, resolution: Downsampled, T_camera_object: Pose, threads: int, *, exact: bool = False
) -> ModelView:
    """Cast the evidence at a pose into the depth camera of a resolution.

    If the resolution is sparse and the view need not be exact, every other ray of every other row is cast first;
    between four that meet one even surface the rest are interpolated.
    """
    camera, grid = resolution.camera, resolution.grid
    count = camera.width * camera.height
    view = ViewRays(np.zeros(count, np.float32), np.zeros((count, 3), np.float32), np.zeros(count, np.float32))
    done = np.zeros(count, np.uint8)
    T = cells_from_camera(T_camera_object, model.voxel_size_m)
    tiles = Tiles(grid.origin, grid.size, *grid.ranges(model.index, T_camera_object, model.voxel_size_m))
    cells = EvidenceCells(
        model.voxel_size_m, model.index.tables, model.distance.reshape(-1), model.distance_weight.reshape(-1),
        model.color.reshape(-1, 3), model.color_weight.reshape(-1),
    )  # fmt: skip

    def cast(numbers: NDArray[np.int64]) -> None:
        def rays(start: int, stop: int) -> None:
            cast_evidence(grid.slopes, numbers, start, stop, T, tiles, cells, resolution.flat, view)

        for_ranges(rays, len(numbers), threads)

    def squares(start: int, stop: int) -> None:
        fill_between(start, stop, camera.width, *view, done)

    cast(grid.order if exact else resolution.even)
    if len(resolution.between) and not exact:
        for_ranges(squares, (camera.height - 1) // 2, threads)
        cast(resolution.between[done[resolution.between] == 0])
    shape = (camera.height, camera.width)
    return ModelView(
        camera=camera,
        T_camera_object=T_camera_object,
        depth=view.depth.reshape(shape),
        normals=view.normal.reshape(*shape, 3),
        intensity=view.intensity.reshape(shape),
    )


def predicted_and_measured_depth(
    model: EvidenceModel,
    views: FrameResolutions,
    mask: Mask,
    T_camera_object: Pose,
    threads: int,
    *,
    exact: bool = False,
) -> tuple[Floats, Floats]:
    """Return the depths in meters that the evidence shows at a pose, and what a frame measured within `mask` (h, w).

    Both are of the resolution that suits the mask; 0 = nothing.
    """
    predicted = raycast_model(model, views.resolution(mask), T_camera_object, threads, exact=exact).depth
    return predicted, ObjectView(views, mask).object_depth
