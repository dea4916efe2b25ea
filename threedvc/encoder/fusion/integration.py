# SPDX-License-Identifier: MIT
"""Bayesian fusion of frames into an object's evidence (sec. 2.3, eq. 1-7).

Only cells near a surface that was measured at some time have storage. For each of them that the frame
sees, the exact ray sum gives the change of its log-odds when it lies within the window around the
reading; a cell in front of the window gets the bounded free-space evidence of the same model, the
limit of the ray sum for a reading far behind the cell; a cell behind it learns nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.config import FusionConfig
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.frames.frame import Frame
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, inverse
from threedvc.kernels.encoder.fusion import (
    ColorCells,
    ColorReading,
    DepthCells,
    DepthReading,
    fuse_color,
    integrate_depth,
    mark_blocks,
    visible_blocks,
)
from threedvc.parallel import for_ranges

__all__ = ["Observation", "camera_parameters", "confidence_of", "free_space_log_odds", "fuse", "observe"]

PYRAMID_LEVELS = 5
"""Of the color picture, down to a sixteenth: a cell that covers more pixels is colored by 16 x 16 of them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation:
    """A frame prepared for fusion, shared by all objects.

    Attributes
    ----------
    depth
        (h, w) float32 meters.
    rays
        (h, w, 2) float64 slopes of the depth camera's pixels.
    levels
        Pyramid of float32 RGB pictures.
    confidence
        (h, w) float32 weight of the color seen at a depth pixel.
    """

    frame: int
    rig: CameraRig
    depth: NDArray[np.float32]
    rays: NDArray[np.float64]
    levels: tuple[NDArray[np.float32], ...]
    confidence: NDArray[np.float32]


def camera_parameters(camera: Camera) -> NDArray[np.float64]:
    """Return the nine parameters of a camera and a flag for distortion, as the kernels take them."""
    return np.append(camera.parameters(), float(camera.distorted))


def free_space_log_odds(sensor: SensorModel) -> float:
    """Return the evidence that a reading gives a cell it passed through.

    The limit of the ray sum where the reading's own cell is equiprobable: the cell explains the reading
    as an outlier only, what lies beyond explains it as well as not.
    """
    return float(np.log(sensor.outlier / (sensor.outlier + 0.5 * (1 - sensor.outlier))))


def observe(frame: Frame, rig: CameraRig, rays: NDArray[np.float64]) -> Observation:
    """Prepare a frame: color pyramid, and confidence from viewing angle and depth edges."""
    levels = [frame.color.astype(np.float32)]
    while len(levels) < PYRAMID_LEVELS and min(levels[-1].shape[:2]) >= 4:
        height, width = levels[-1].shape[:2]
        half = cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, dtype=np.float32))
    return Observation(
        frame=frame.index,
        rig=rig,
        depth=frame.depth,
        rays=rays,
        levels=tuple(levels),
        confidence=confidence_of(frame.depth, rig.depth),
    )


def confidence_of(depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Weigh pixels (h, w) by the cosine of the viewing angle; pixels at depth edges count little."""
    valid = depth > 0
    near = cv2.erode(np.where(valid, depth, np.float32(1e6)), np.ones((3, 3), np.uint8))
    far = cv2.dilate(depth, np.ones((3, 3), np.uint8))
    holes = cv2.erode(valid.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (far - near) * camera.fx / (2 * depth)
        cosine = 1 / np.sqrt(1 + slope * slope)
    edge = (far - near > 0.04 * depth) | holes
    return np.where(valid, np.where(edge, 0.02, cosine), 0).astype(np.float32)


def fuse(
    model: EvidenceModel,
    seen: Observation,
    mask: NDArray[np.bool_],
    T_camera_object: Pose,
    sensor: SensorModel,
    config: FusionConfig,
    threads: int,
    *,
    in_color: bool = True,
) -> NDArray[np.int64]:
    """Fuse one frame into one object; unless `in_color` its depth alone.

    Parameters
    ----------
    mask
        (h, w) pixels that show this object; elsewhere the frame only tells what is empty.
    T_camera_object
        Pose of the object in the depth camera.

    Returns
    -------
    numpy.ndarray
        Numbers of the blocks that were in sight, int64.
    """
    parameters, noise = camera_parameters(seen.rig.depth), sensor.parameters()
    T_object_camera = inverse(T_camera_object)
    model.allocate(_touched_blocks(model, seen, mask, T_object_camera, noise, config))
    numbers = _visible(model, seen, T_camera_object, parameters, sensor, config)
    if not len(numbers):
        return numbers
    delta = np.empty((len(numbers), model.log_odds.shape[1]), dtype=np.float32)
    free = free_space_log_odds(sensor)
    index = model.index

    depth_cells = DepthCells(
        index.coords, model.voxel_size_m, index.tables, model.log_odds, model.distance, model.distance_weight,
        model.first_seen,
    )  # fmt: skip
    depth_reading = DepthReading(parameters, seen.depth, mask, noise, config.band_sigmas, free, seen.frame)
    color_cells = ColorCells(index.coords, model.voxel_size_m, model.color, model.color_weight)
    color_reading = ColorReading(
        seen.rig.T_color_depth, parameters, camera_parameters(seen.rig.color), seen.depth,
        np.where(mask, seen.confidence, np.float32(0)), noise, seen.levels,
    )  # fmt: skip

    def depth_range(start: int, stop: int) -> None:
        integrate_depth(numbers, start, stop, depth_cells, depth_reading, T_camera_object, T_object_camera, delta)

    def color_range(start: int, stop: int) -> None:
        fuse_color(numbers, start, stop, color_cells, color_reading, T_camera_object)

    for_ranges(depth_range, len(numbers), threads)
    model.log_odds[numbers] = np.clip(model.log_odds[numbers] + delta, -config.max_log_odds, config.max_log_odds)
    if in_color:
        for_ranges(color_range, len(numbers), threads)
    return numbers


def _touched_blocks(
    model: EvidenceModel,
    seen: Observation,
    mask: NDArray[np.bool_],
    T_object_camera: Pose,
    noise: NDArray[np.float64],
    config: FusionConfig,
) -> NDArray[np.int32]:
    stride = 2 if seen.depth.size > 100_000 else 1
    keys = np.empty(5 * (-(-seen.depth.shape[0] // stride)) * (-(-seen.depth.shape[1] // stride)), dtype=np.int64)
    count = mark_blocks(
        seen.depth, mask, seen.rays, stride, T_object_camera, model.voxel_size_m, noise, config.band_sigmas, keys
    )
    unique = np.unique(keys[:count])
    return np.stack([(unique >> shift & 0x1FFFFF) - (1 << 20) for shift in (0, 21, 42)], axis=1).astype(np.int32)


def _visible(
    model: EvidenceModel,
    seen: Observation,
    T_camera_object: Pose,
    parameters: NDArray[np.float64],
    sensor: SensorModel,
    config: FusionConfig,
) -> NDArray[np.int64]:
    numbers = np.empty(model.index.count, dtype=np.int64)
    camera = seen.rig.depth
    furthest = float(seen.depth.max(initial=0))
    far = furthest + max(config.band_sigmas * float(sensor.sigma_m(np.array(furthest))), 3 * model.voxel_size_m)
    count = visible_blocks(
        model.index.coords, model.index.count, model.voxel_size_m, T_camera_object, parameters, camera.width,
        camera.height, far, numbers,
    )  # fmt: skip
    return numbers[:count]
