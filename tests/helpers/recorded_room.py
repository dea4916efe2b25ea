# SPDX-License-Identifier: MIT
"""A box-shaped room with smooth colors on its walls, recorded analytically with known poses.

Tests write it in the layout of a data set and check what a reader makes of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, make_pose, quaternion, rotation_from_vector

WALLS = np.array([[-2.0, -1.5, -2.0], [2.0, 1.5, 2.5]])
SMALL = Camera(width=64, height=48, fx=60.0, fy=61.0, cx=31.0, cy=24.5)
VGA = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)


def poses(count: int) -> list[Pose]:
    """Return T_world_camera of a camera that moves and turns about all axes, without symmetry."""
    return [
        make_pose(
            rotation_from_vector(np.array([0.10 + 0.03 * k, -0.2 + 0.05 * k, 0.04 * k])),
            np.array([0.3 - 0.04 * k, 0.1 + 0.03 * k, -0.5 + 0.05 * k]),
        )
        for k in range(count)
    ]


def wall_points(camera: Camera, pose: Pose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the point of the walls that every pixel sees, (height, width, 3), and its depth (height, width)."""
    slopes = camera.rays()
    rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1) @ pose[:3, :3].T
    ahead = np.where(rays > 0, WALLS[1], WALLS[0]) - pose[:3, 3]
    depth = np.min(ahead / np.where(rays == 0, 1e-12, rays), axis=-1)
    return pose[:3, 3] + rays * depth[..., None], depth


def wall_colors(points: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the RGB color of points on the walls; the three channels differ."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    channels = [np.sin(2.1 * x + 0.7 * z), np.sin(2.6 * y - 0.9 * x + 1), np.sin(1.9 * z + 1.3 * y + 2)]
    return np.rint(128 + 110 * np.stack(channels, axis=-1)).astype(np.uint8)


def color_picture(camera: Camera, pose: Pose) -> NDArray[np.uint8]:
    """Return what a color camera at a pose sees, RGB."""
    return wall_colors(wall_points(camera, pose)[0])


def depth_picture(camera: Camera, pose: Pose, units_per_meter: float) -> NDArray[np.uint16]:
    """Return what a depth camera at a pose measures, in units."""
    return np.rint(wall_points(camera, pose)[1] * units_per_meter).astype(np.uint16)


def write_picture(path: Path, picture: NDArray[np.generic]) -> None:
    """Write RGB, gray or depth as the PNG or JPEG that the name asks for."""
    path.parent.mkdir(parents=True, exist_ok=True)
    stored = picture[..., ::-1] if picture.ndim == 3 else picture
    quality = [cv2.IMWRITE_JPEG_QUALITY, 100] if path.suffix == ".jpg" else []
    path.write_bytes(cv2.imencode(path.suffix, np.ascontiguousarray(stored), quality)[1].tobytes())


def pose_row(key: object, pose: Pose) -> str:
    """Write a pose as ``key tx ty tz qx qy qz qw``."""
    values = [*pose[:3, 3], *quaternion(pose[:3, :3])]
    return " ".join([str(key), *(f"{value:.9f}" for value in values)])


def write_lines(path: Path, lines: Sequence[str]) -> None:
    """Write a text file."""
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
