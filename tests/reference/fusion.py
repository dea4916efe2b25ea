# SPDX-License-Identifier: MIT
"""Slow reference of fusion: one cell at a time, written as the method is told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.config import FusionConfig
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import Observation, free_space_log_odds
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, inverse

__all__ = ["CellEvidence", "cells_of", "expected_color", "expected_depth", "ray_sum"]

REACH = 30
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CellEvidence:
    """What a frame makes of one cell; `log_odds` is the change."""

    log_odds: float
    distance: float
    distance_weight: float
    first_seen: int


def cells_of(model: EvidenceModel) -> NDArray[np.int32]:
    """Return the coordinates (blocks * 512, 3) of all cells, in the order of the model's arrays."""
    z, y, x = np.mgrid[0:8, 0:8, 0:8]
    local = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    blocks = model.index.coords[: model.index.count]
    return (blocks[:, None] * 8 + local).reshape(-1, 3).astype(np.int32)


def ray_sum(log_odds: Floats, likelihood: Floats, none_likelihood: float, cell: int) -> float:
    """Return the change of one cell's log-odds by the closed form of eq. (6)-(7)."""
    p = 1 / (1 + np.exp(-log_odds))
    reach = np.concatenate([[1.0], np.cumprod(1 - p)])
    stopped = p * reach[:-1] * likelihood
    before = stopped[:cell].sum()
    beyond = (stopped[cell + 1 :].sum() + reach[-1] * none_likelihood) / (1 - p[cell])
    return float(np.log(before + reach[cell] * likelihood[cell]) - np.log(before + beyond))


def expected_depth(
    model: EvidenceModel,
    cell: NDArray[np.int32],
    seen: Observation,
    mask: NDArray[np.bool_],
    T_camera_object: Pose,
    sensor: SensorModel,
    config: FusionConfig,
) -> CellEvidence:
    """Return the evidence of a cell after a frame, from the model before it."""
    h = model.voxel_size_m
    position = _position(model, cell)
    old = CellEvidence(
        log_odds=0.0,
        distance=float(model.distance.flat[position]),
        distance_weight=float(model.distance_weight.flat[position]),
        first_seen=int(model.first_seen.flat[position]),
    )
    point = _in_camera(cell, h, T_camera_object)
    pixel, share = _pixel(seen.rig.depth, point), 1.0
    if pixel is None:
        pixel, share = _border_pixel(seen.rig.depth, point, h), 0.02
    if pixel is None or seen.depth[pixel] <= 0:
        return old
    reading = float(seen.depth[pixel])
    sigma = float(sensor.sigma_m(reading))
    band = max(config.band_sigmas * sigma, 2 * h)
    away = reading - point[2]
    if away < -band or (not mask[pixel] and away < band):
        return old
    precision = share * (0.0022 / (0.001 + sigma)) ** 2
    weight = old.distance_weight + precision
    free = away > band
    change = free_space_log_odds(sensor) if free else _in_window(model, point, reading, T_camera_object, sensor)
    return CellEvidence(
        log_odds=share * change,
        distance=old.distance + (min(away, band) - old.distance) * precision / weight,
        distance_weight=min(weight, 200.0),
        first_seen=old.first_seen if free else min(old.first_seen, seen.frame),
    )


def expected_color(
    model: EvidenceModel,
    cell: NDArray[np.int32],
    seen: Observation,
    mask: NDArray[np.bool_],
    T_camera_object: Pose,
    sensor: SensorModel,
) -> tuple[Floats, float]:
    """Return color and weight of a cell after a frame, from the model before it."""
    h = model.voxel_size_m
    position = _position(model, cell)
    color = model.color.reshape(-1, 3)[position].astype(np.float64)
    weight = float(model.color_weight.flat[position])
    point = _in_camera(cell, h, T_camera_object)
    pixel = _pixel(seen.rig.depth, point)
    if pixel is None or not mask[pixel] or seen.confidence[pixel] <= 0:
        return color, weight
    reading = float(seen.depth[pixel])
    if abs(reading - point[2]) > max(2 * float(sensor.sigma_m(reading)), 1.5 * h):
        return color, weight
    shade = _look_up(seen, seen.rig, point, h)
    if shade is None:
        return color, weight
    gain = float(seen.confidence[pixel]) / point[2] ** 2
    return color + (shade - color) * gain / (weight + gain), min(weight + gain, 1e4)


def _position(model: EvidenceModel, cell: NDArray[np.int32]) -> int:
    return int(model.index.locate(cell[None])[0])


def _in_camera(cell: NDArray[np.int32], voxel_size: float, T_camera_object: Pose) -> Floats:
    center = (cell + 0.5) * voxel_size
    return T_camera_object[:3, :3] @ center + T_camera_object[:3, 3]


def _pixel(camera: Camera, point: Floats) -> tuple[int, int] | None:
    """Return row and column of the pixel that shows a point."""
    if point[2] <= 0.01:
        return None
    u, v = np.floor(camera.project(point) + 0.5)
    inside = 0 <= u < camera.width and 0 <= v < camera.height
    return (int(v), int(u)) if inside else None


def _border_pixel(camera: Camera, point: Floats, voxel_size: float) -> tuple[int, int] | None:
    """Return the pixel of the border beside which a point lies, if a cell there reaches it."""
    if point[2] <= 0.01:
        return None
    place = camera.project(point)
    border = np.clip(np.floor(place + 0.5), 0, [camera.width - 1, camera.height - 1])
    if np.abs(place - border).max() > voxel_size * camera.fx / point[2]:
        return None
    return int(border[1]), int(border[0])


def _in_window(
    model: EvidenceModel, point: Floats, reading: float, T_camera_object: Pose, sensor: SensorModel
) -> float:
    """Sum over the cells of the ray through a point, near the point and the reading."""
    h = model.voxel_size_m
    spread = np.sqrt(float(sensor.sigma_m(reading)) ** 2 + h**2 / 12)
    slopes = point / point[2]
    step = h / np.linalg.norm(slopes)
    ahead = int(np.clip(np.ceil((point[2] - (reading - 3 * spread - step)) / step), 0, REACH))
    behind = int(np.clip(np.ceil((reading + 3 * spread + step - point[2]) / step), 0, REACH))
    depths = point[2] + np.arange(-ahead, behind + 1) * step
    T = inverse(T_camera_object)
    cells = np.floor((depths[:, None] * slopes @ T[:3, :3].T + T[:3, 3]) / h).astype(np.int32)
    positions = model.index.locate(cells)
    log_odds = np.where(positions >= 0, model.log_odds.reshape(-1)[positions], 0).astype(np.float64)
    likelihood = (1 - sensor.outlier) * np.exp(-0.5 * ((reading - depths) / spread) ** 2) + sensor.outlier
    return ray_sum(log_odds, likelihood, sensor.outlier, ahead)


def _look_up(seen: Observation, rig: CameraRig, point: Floats, voxel_size: float) -> Floats | None:
    """Return the color of a point in the level of the pyramid whose pixels are just finer than a cell."""
    T = rig.T_color_depth
    there = T[:3, :3] @ point + T[:3, 3]
    if there[2] <= 0.01:
        return None
    u, v = rig.color.project(there)
    if not (-0.5 <= u <= rig.color.width - 0.5 and -0.5 <= v <= rig.color.height - 0.5):
        return None
    pixels_per_cell = voxel_size * rig.color.fx / there[2]
    level = int(np.clip(np.floor(np.log2(pixels_per_cell)), 0, len(seen.levels) - 1))
    return _bilinear(seen.levels[level], (u + 0.5) / 2**level - 0.5, (v + 0.5) / 2**level - 0.5)


def _bilinear(picture: NDArray[np.float32], u: float, v: float) -> Floats:
    height, width = picture.shape[:2]
    u, v = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
    shade = np.zeros(3)
    for row in (int(np.floor(v)), int(np.floor(v)) + 1):
        for column in (int(np.floor(u)), int(np.floor(u)) + 1):
            share = max(0.0, 1 - abs(v - row)) * max(0.0, 1 - abs(u - column))
            shade += share * picture[min(row, height - 1), min(column, width - 1)]
    return shade
