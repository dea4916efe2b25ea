# SPDX-License-Identifier: MIT
"""Slow reference of exploration: one cell and one ray at a time, written as the method is told."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from reference.fusion import ray_sum
from threedvc.encoder.fusion.integration import confidence_of, free_space_log_odds
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse
from threedvc.view_planning.occupancy_field import OccupancyField

__all__ = ["best_visibility", "flooded", "observed"]

REACH = 30
Floats = NDArray[np.float64]


def observed(
    field: OccupancyField,
    depth: NDArray[np.float32],
    mask: NDArray[np.bool_],
    camera: Camera,
    T_camera_field: Pose,
    sensor: SensorModel,
) -> Floats:
    """Return how the log-odds of all cells move by a depth picture."""
    trust = confidence_of(depth, camera)
    change = np.zeros(field.log_odds.shape)
    for cell in np.ndindex(change.shape):
        point = (
            T_camera_field[:3, :3] @ (field.origin_m + (np.array(cell) + 0.5) * field.cell_m) + T_camera_field[:3, 3]
        )
        if point[2] <= 0.01:
            continue
        u, v = np.floor(camera.project(point) + 0.5).astype(int)
        if not (0 <= u < camera.width and 0 <= v < camera.height) or depth[v, u] <= 0:
            continue
        reading = float(depth[v, u])
        sigma = float(sensor.sigma_m(np.array(reading)))
        band = max(3 * sigma, 2 * field.cell_m)
        if reading - point[2] > band:
            change[cell] = free_space_log_odds(sensor)
        elif reading - point[2] >= -band and mask[v, u]:
            change[cell] = trust[v, u] * _near_reading(field, point, reading, sigma, T_camera_field, sensor)
    return change


def _near_reading(
    field: OccupancyField, point: Floats, reading: float, sigma: float, T_camera_field: Pose, sensor: SensorModel
) -> float:
    spread = np.sqrt(sigma**2 + field.cell_m**2 / 12)
    slopes = point / point[2]
    step = field.cell_m / np.linalg.norm(slopes)
    ahead = int(np.clip(np.ceil((point[2] - (reading - 3 * spread - step)) / step), 0, REACH))
    behind = int(np.clip(np.ceil((reading + 3 * spread + step - point[2]) / step), 0, REACH))
    depths = point[2] + np.arange(-ahead, behind + 1) * step
    T = inverse(T_camera_field)
    places = depths[:, None] * slopes @ T[:3, :3].T + T[:3, 3]
    odds = np.array([_log_odds_at(field, place) for place in places])
    likelihood = (1 - sensor.outlier) * np.exp(-0.5 * ((reading - depths) / spread) ** 2) + sensor.outlier
    return ray_sum(odds, likelihood, sensor.outlier, ahead)


def _log_odds_at(field: OccupancyField, place: Floats) -> float:
    cell = np.floor((place - field.origin_m) / field.cell_m).astype(int)
    inside = np.all((cell >= 0) & (cell < field.log_odds.shape))
    return float(field.log_odds[tuple(cell)]) if inside else 0.0


def flooded(passable: NDArray[np.bool_], starts: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells that can be reached from `starts` by steps between faces through passable cells."""
    reached = starts.copy()
    while True:
        wider = reached.copy()
        for axis in range(3):
            source, target = np.moveaxis(reached, axis, 0), np.moveaxis(wider, axis, 0)
            target[1:] |= source[:-1]
            target[:-1] |= source[1:]
        wider = reached | (wider & passable)
        if np.array_equal(wider, reached):
            return reached
        reached = wider


def best_visibility(
    view: Floats, slopes: Floats, cell_m: float, opacity: Floats, sensor: SensorModel, reach_m: float
) -> Floats:
    """Return the best look of a view's rays at each cell; `view` is its (3, 4) map from meters to cells."""
    looks = np.zeros(opacity.shape)
    for slope in slopes:
        along = view[:, :2] @ slope + view[:, 2]
        subvoxel_offsets = [0.0, reach_m]
        for axis in range(3):
            if along[axis] != 0:
                subvoxel_offsets += list((np.arange(opacity.shape[axis] + 1) - view[axis, 3]) / along[axis])
        depths = np.unique([depth for depth in subvoxel_offsets if 0 <= depth <= reach_m])
        left = 1.0
        for near, far in pairwise(depths):
            cell = tuple(np.floor(view[:, 3] + along * (near + far) / 2).astype(int))
            if not all(0 <= n < size for n, size in zip(cell, opacity.shape, strict=True)) or left <= 0.01:
                continue
            sigma = float(sensor.sigma_m(np.array(near)))
            looks[cell] = max(looks[cell], left * cell_m**2 / (cell_m**2 + sigma**2))
            left *= 2.0 ** (-opacity[cell] * (far - near) * np.sqrt(1 + slope @ slope))
    return looks
