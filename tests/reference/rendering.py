# SPDX-License-Identifier: MIT
"""Slow reference of ray casting, and decoded models of analytic shapes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.pose import Pose, inverse
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate

__all__ = ["first_occupied", "model_of_cells", "model_of_shape", "surface_cells"]

Floats = NDArray[np.float64]
Cells = NDArray[np.int32]
Shape = Callable[[Floats], Floats]
FACES = [(axis, way) for axis in range(3) for way in (-1, 1)]


def surface_cells(shape: Shape, voxel_size: float, reach: float) -> Cells:
    """Return the cells nearest to the zero of a signed distance (n, 3) -> (n,), within `reach` meters of the origin."""
    side = int(np.ceil(reach / voxel_size))
    axis = np.arange(-side, side + 1)
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    distance = shape(((cells + 0.5) * voxel_size).reshape(-1, 3)).reshape(cells.shape[:3])
    marked = np.zeros(distance.shape, dtype=bool)
    for axis_number, way in FACES:
        other = np.roll(distance, -way, axis=axis_number)
        marked |= ((distance > 0) != (other > 0)) & (np.abs(distance) <= np.abs(other))
    inner = marked[1:-1, 1:-1, 1:-1]
    return cells[1:-1, 1:-1, 1:-1][inner].astype(np.int32)


def model_of_cells(cells: Cells, voxel_size: float, colors: NDArray[np.int16] | None = None) -> DecodedModel:
    """Return a model with these cells, gray unless told otherwise."""
    model = DecodedModel(voxel_size)
    colors = np.full((len(cells), 3), 128, dtype=np.int16) if colors is None else colors
    model.apply(ModelUpdate.adding(cells, colors))
    return model


def model_of_shape(shape: Shape, voxel_size: float, reach: float) -> DecodedModel:
    """Return the model of a signed distance."""
    return model_of_cells(surface_cells(shape, voxel_size, reach), voxel_size)


def first_occupied(model: DecodedModel, slopes: Floats, T_camera_object: Pose, near: float, far: float) -> Floats:
    """Return the depth (n,) at which rays (n, 2) enter their first occupied cell, 0 without; in small steps."""
    T = inverse(T_camera_object)
    depth = np.zeros(len(slopes))
    directions = np.column_stack([slopes, np.ones(len(slopes))])
    step = 0.1 * model.voxel_size_m / np.linalg.norm(directions, axis=1).max()
    for t in np.arange(near, far, step):
        open_rays = np.flatnonzero(depth == 0)
        points = (directions[open_rays] * t) @ T[:3, :3].T + T[:3, 3]
        positions = model.index.locate(np.floor(points / model.voxel_size_m).astype(np.int32))
        stopped = positions >= 0
        stopped[stopped] = model.occupied.reshape(-1)[positions[stopped]] != 0
        depth[open_rays[stopped]] = t
    return depth
