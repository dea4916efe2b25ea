# SPDX-License-Identifier: MIT
"""Places and directions from which a scene or an object could be recorded; the same ones in every run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.pose import Pose, make_pose
from threedvc.kernels.encoder.exploration import flood_cells
from threedvc.view_planning.occupancy_field import OccupancyField, widened

__all__ = ["look_along", "reachable_places", "reachable_views", "upward", "views_around"]

SEED = 1995
"""Any does; a fixed one gives the same proposals in every run. (The year of the paper.)"""
MAX_PITCH_RAD = np.pi / 4
"""From level, up or down, of views that aim at nothing in particular: few things of a room are above or below it."""
GOLDEN_ANGLE_RAD = np.pi * (3 - np.sqrt(5))
"""From point to point of a spiral that covers a sphere evenly."""
MIN_UP = 0.1
"""Length of the mean of unit vectors below which they have no direction in common."""


def look_along(eye: NDArray[np.float64], direction: NDArray[np.float64], up: NDArray[np.float64]) -> Pose:
    """Return T_field_camera of an upright camera.

    Parameters
    ----------
    eye
        (3,) its place in meters.
    direction
        (3,) unit vector along which it looks.
    up
        (3,) unit vector that its pictures show upright, as far as they can.
    """
    right = np.cross(direction, up)
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(direction, np.roll(up, 1) + np.array([1e-3, 0, 0]))
    right /= np.linalg.norm(right)
    return make_pose(np.stack([right, np.cross(direction, right), direction], axis=1), eye)


def upward(recorded: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean direction (3,) that views (n, 4, 4), poses T_field_camera, show as up; the last one's if none."""
    up = -recorded[:, :3, 1].mean(axis=0)
    length = float(np.linalg.norm(up))
    return np.asarray(up / length if length > MIN_UP else -recorded[-1, :3, 1])


def views_around(
    center: NDArray[np.float64], distance_m: float, up: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Return views (count, 4, 4) of a point (3,) from one distance and evenly spread directions (a spiral)."""
    steps = np.arange(count)
    height = 1 - (2 * steps + 1) / count
    azimuth, radius = GOLDEN_ANGLE_RAD * steps, np.sqrt(1 - height * height)
    directions = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height], axis=1)
    return np.stack([look_along(center + distance_m * each, -each, up) for each in directions])


def reachable_views(
    field: OccupancyField, recorded: NDArray[np.float64], clearance_m: float, count: int
) -> NDArray[np.float64]:
    """Return views from where a camera can go, every second one of a border of what was seen, the others any way.

    Parameters
    ----------
    field
        What is known of the place.
    recorded
        (n, 4, 4) poses T_field_camera of the views so far.
    clearance_m
        How far the camera keeps from what is occupied.
    count
        Number of views.

    Returns
    -------
    (count, 4, 4) poses T_field_camera
    """
    rng = np.random.default_rng(SEED)
    places, up = reachable_places(field, recorded[:, :3, 3], clearance_m), upward(recorded)
    eyes = places[rng.choice(len(places), count, replace=len(places) < count)]
    yaw, pitch = rng.uniform(-np.pi, np.pi, count), rng.uniform(-MAX_PITCH_RAD, MAX_PITCH_RAD, count)
    R = look_along(np.zeros(3), recorded[-1, :3, 2], up)[:3, :3]
    level = np.cross(up, R[:, 0])
    flat = np.sin(yaw)[:, None] * R[:, 0] - np.cos(yaw)[:, None] * level
    directions = np.cos(pitch)[:, None] * flat + np.sin(pitch)[:, None] * up
    borders = field.centers(field.border())
    if len(borders):
        aims = borders[rng.choice(len(borders), count)] - eyes
        distances = np.linalg.norm(aims, axis=1)
        aimed = (np.arange(count) % 2 == 0) & (distances > 0)
        directions[aimed] = aims[aimed] / distances[aimed, None]
    return np.stack([look_along(eye, direction, up) for eye, direction in zip(eyes, directions, strict=True)])


def reachable_places(field: OccupancyField, recorded: NDArray[np.float64], clearance_m: float) -> NDArray[np.float64]:
    """Return places (m, 3) in meters: those where the camera was (n, 3), and where it could go from there.

    The way leads through cells known to be free, away from what is occupied.
    """
    passable = field.free & ~widened(field.occupied, int(np.ceil(clearance_m / field.cell_m)))
    queue, reached = np.empty(passable.size, dtype=np.int64), np.zeros(passable.shape, dtype=np.uint8)
    starts = field.cells_at(recorded)
    queue[: len(starts)] = starts
    reached.reshape(-1)[starts] = 1
    count = flood_cells(passable, queue, len(starts), reached)
    return np.concatenate([recorded, field.centers(queue[len(starts) : count])])
