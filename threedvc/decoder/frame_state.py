# SPDX-License-Identifier: MIT
"""What is known of one decoded frame: poses, gains, light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.video.planes import ShownColor
from threedvc.decoder.measured_depth import MeasuredDepth
from threedvc.geometry.pose import Pose, compose, identity
from threedvc.model.post_filter import PostFilter
from threedvc.render.captured_depth import CapturedDepth
from threedvc.render.picture import BackgroundImage, Light

__all__ = ["FrameState", "camera_poses"]


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameState:
    """Where everything is in one frame.

    Attributes
    ----------
    index, timestamp_ns
        Which frame.
    color_timestamp_ns
        Time of its color picture if that is another, else None.
    sensor, number
        The sensor that took it, and which of its own frames it is.
    synchronized
        Whether it was taken at the moment of the frame before, by another sensor.
    T_world_camera
        Pose of the sensor's depth camera.
    T_camera_object
        Pose of every object that has appeared, by number; 0 is the background.
    T_shifted_camera
        Shift of the depth camera for the color picture: ``p_color = T_color_depth @ T_shifted_camera @ p_depth``.
    gain
        (3, 2) units of the color camera's gain, see `threedvc.coding.gains`.
    backdrop
        What colors the background, or None.
    lights
        Light on objects, by number.
    filters
        Filter of the color picture as captured, or None.
    captured_depth, captured_color
        Depth and color that stand for the drawn ones in the frame as captured, or None.
    """

    index: int
    timestamp_ns: int
    sensor: int
    number: int
    synchronized: bool
    T_world_camera: Pose
    T_camera_object: Mapping[int, Pose]
    T_shifted_camera: Pose
    gain: NDArray[np.int64]
    backdrop: BackgroundImage | None
    lights: Mapping[int, Light]
    filters: PostFilter | None
    captured_depth: CapturedDepth | MeasuredDepth | None
    captured_color: ShownColor | None = None
    color_timestamp_ns: int | None = None


def camera_poses(carried: Mapping[int, Pose]) -> dict[int, Pose]:
    """Turn the poses that the stream carries into T_camera_object.

    Object 0 carries T_camera_world, every other object T_world_object, so that what rests in the room
    costs nothing while the camera moves.
    """
    T_camera_world = carried.get(0, identity())
    return {number: compose(T_camera_world, pose) if number else pose for number, pose in carried.items()}
