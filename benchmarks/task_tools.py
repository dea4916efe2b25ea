# SPDX-License-Identifier: MIT
"""The programs that do tasks with RGB-D frames: odometry of Open3D and of OpenCV, fusion of Open3D."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Sequence
from itertools import pairwise
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.frames.frame import Frame
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse

__all__ = ["MissingTool", "distances", "fused", "open3d", "open3d_steps", "opencv_steps"]

FARTHEST_M = 10.0
"""Depth beyond is not used, in all tasks: it is further than any of the sensors tells well."""
CELL_M = 0.006
"""Of the fused distance field: well below the 1 cm by which surfaces are judged."""
BAND_CELLS = 5.0
"""Around surfaces, in which the field is known: wider than the noise of a Kinect at 3 m."""
SEEN = 2.5
"""Frames that must have told a point of a surface: the default of the program, 3, as a bound below it."""
EXPECTED_BLOCKS = 20_000
"""Of 16 cells a side; more are added as they are needed."""


class MissingTool(RuntimeError):
    """A program that does a task is not installed, or cannot be loaded."""


def open3d() -> ModuleType:
    """Return Open3D.

    Raises
    ------
    MissingTool
        If it is not installed, or cannot be loaded.
    """
    try:
        return importlib.import_module("open3d")
    except ModuleNotFoundError:
        raise MissingTool("tasks need Open3D; install the extra [bench]: pip install '.[bench]'") from None
    except ImportError as error:
        raise MissingTool(f"Open3D cannot be loaded ({error}); install that library of the system") from None


def open3d_steps(frames: Iterable[Frame], camera: Camera) -> list[Pose]:
    """Return T_camera_next of all frames but the last, by Open3D's odometry of color and depth.

    A step that it cannot tell is none.
    """
    odometry = open3d().pipelines.odometry
    options = odometry.OdometryOption(depth_max=FARTHEST_M)
    jacobian = odometry.RGBDOdometryJacobianFromHybridTerm()
    pictures = [_rgbd(frame) for frame in frames]
    steps = []
    for this, following in pairwise(pictures):
        told, T, _ = odometry.compute_rgbd_odometry(following, this, _intrinsic(camera), np.eye(4), jacobian, options)
        steps.append(np.array(T) if told else np.eye(4))
    return steps


def opencv_steps(frames: Sequence[Frame], camera: Camera) -> list[Pose]:
    """Return T_camera_next of all frames but the last, by `cv2.Odometry` of color and depth.

    A step that it cannot tell is none.
    """
    settings = cv2.OdometrySettings()
    settings.setCameraMatrix(camera_matrix(camera))
    settings.setMaxDepth(FARTHEST_M)
    odometry = cv2.Odometry(cv2.ODOMETRY_TYPE_RGB_DEPTH, settings, cv2.ODOMETRY_ALGO_TYPE_COMMON)
    steps = []
    for this, following in pairwise(frames):
        told, T = odometry.compute(following.depth, following.color, this.depth, this.color)
        steps.append(np.array(T, dtype=np.float64) if told and np.isfinite(T).all() else np.eye(4))
    return steps


def camera_matrix(camera: Camera) -> NDArray[np.float32]:
    """Return the matrix (3, 3) of a camera without distortion."""
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=np.float32)


def fused(depths: Iterable[NDArray[np.float32]], poses: Sequence[Pose], camera: Camera) -> Any:
    """Return the points of the surface that depth pictures (h, w) in meters come to at their T_world_camera."""
    tools = open3d().t.geometry
    tensor, number = open3d().core.Tensor, open3d().core.float32
    grid = tools.VoxelBlockGrid(
        ("tsdf", "weight"), (number, number), ((1), (1)), voxel_size=CELL_M, block_count=EXPECTED_BLOCKS
    )
    matrix = tensor(camera_matrix(camera).astype(np.float64))
    for depth, pose in zip(depths, poses, strict=True):
        picture, placed = tools.Image(tensor(np.ascontiguousarray(depth))), tensor(inverse(pose))
        blocks = grid.compute_unique_block_coordinates(picture, matrix, placed, 1.0, FARTHEST_M, BAND_CELLS)
        grid.integrate(blocks, picture, matrix, placed, 1.0, FARTHEST_M, BAND_CELLS)
    return grid.extract_point_cloud(weight_threshold=SEEN).to_legacy()


def distances(points: Any, others: Any) -> NDArray[np.float64]:
    """Return the distance (n,) of each point of a surface in meters from the nearest one of another."""
    return np.asarray(points.compute_point_cloud_distance(others), dtype=np.float64)


def _rgbd(frame: Frame) -> Any:
    """Return luma and depth as Open3D takes them."""
    geometry = open3d().geometry
    pictures = [geometry.Image(np.ascontiguousarray(picture)) for picture in (frame.color, frame.depth)]
    return geometry.RGBDImage.create_from_color_and_depth(
        *pictures, depth_scale=1.0, depth_trunc=FARTHEST_M, convert_rgb_to_intensity=True
    )


def _intrinsic(camera: Camera) -> Any:
    return open3d().camera.PinholeCameraIntrinsic(
        camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    )
