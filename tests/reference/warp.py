# SPDX-License-Identifier: MIT
"""Carry the depth of one frame into another with the poses that a reader gives, and compare.

Wrong axes, an inverted pose, a wrong depth scale or a wrong camera all show as large differences.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.frames.frame import Frame
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, inverse


def transformed(pose: Pose, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply a transform to points (n, 3)."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def world_points(frame: Frame, rig: CameraRig, stride: int = 1) -> NDArray[np.float64]:
    """Return the measured points of a frame in the world, (n, 3) meters, taking every `stride`-th pixel."""
    assert frame.T_world_camera is not None
    depth = frame.depth.astype(np.float64)[::stride, ::stride]
    slopes = rig.depth.rays()[::stride, ::stride]
    points = np.concatenate([slopes * depth[..., None], depth[..., None]], axis=-1)
    return transformed(frame.T_world_camera, points[depth > 0])


def nearest_pixels(camera: Camera, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the pixel (n, 2) next to where each point (n, 3) in camera coordinates falls, and which fall inside."""
    seen = points[:, 2] > 0.05
    pixels = np.full((len(points), 2), -1, dtype=np.int64)
    pixels[seen] = np.rint(camera.project(points[seen])).astype(np.int64)
    inside = np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
    return pixels, inside


def depth_differences(source: Frame, target: Frame, rig: CameraRig, stride: int = 1) -> NDArray[np.float64]:
    """Return predicted minus measured depth in `target`, meters, where points of `source` fall on a measurement."""
    assert target.T_world_camera is not None
    points = transformed(inverse(target.T_world_camera), world_points(source, rig, stride))
    pixels, inside = nearest_pixels(rig.depth, points)
    measured = target.depth[pixels[inside, 1], pixels[inside, 0]].astype(np.float64)
    return (points[inside, 2] - measured)[measured > 0]


def colors_at(frame: Frame, rig: CameraRig, points: NDArray[np.float64]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the colors (m, 3) that a frame shows of world points (n, 3), and which points it shows."""
    assert frame.T_world_camera is not None
    in_depth = transformed(inverse(frame.T_world_camera), points)
    pixels, inside = nearest_pixels(rig.color, transformed(rig.T_color_depth, in_depth))
    return frame.color[pixels[inside, 1], pixels[inside, 0]], inside
