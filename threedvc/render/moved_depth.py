# SPDX-License-Identifier: MIT
"""What depth a moving camera will measure next, from what it measured before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.kernels.render.moved_depth import CameraMotion, blend_depth, fill_gaps, refine_depth, splat_depth
from threedvc.parallel import for_ranges

__all__ = ["MovedDepth"]

MAX_RAW = 65535
"""Largest raw depth."""


class MovedDepth:
    """A prediction of the depth frames of a group, for `coding.measured_depth.bounded_depth`.

    The decoded frames are averaged along the surfaces that the poses move. It is called for the frames in order.

    Parameters
    ----------
    camera
        The depth camera.
    T_camera_scene
        The pose of the scene before the camera in every frame of the group, translations in meters.
    raw_per_meter
        Raw depth of a meter.
    threads
        Number of threads; the maps do not depend on it.
    """

    def __init__(self, camera: Camera, T_camera_scene: Sequence[Pose], raw_per_meter: float, threads: int = 1) -> None:
        self.slopes, self.parameters = camera.rays(), camera.parameters()
        self.poses, self.scale, self.threads = T_camera_scene, raw_per_meter, threads
        self.expected = np.zeros(self.slopes.shape[:2], dtype=np.float64)

    def __call__(self, number: int, decoded: NDArray[np.uint16] | None) -> NDArray[np.uint16] | None:
        """Return the raw depths (h, w) expected in a frame, 0 where nothing is known, or None for the first."""
        if decoded is None:
            return None
        motion = self._motion(number)
        mean, found, filled = np.empty_like(self.expected), np.zeros_like(self.expected), np.empty_like(self.expected)
        expected, rows = np.empty_like(self.expected), len(self.expected)
        for_ranges(lambda a, b: blend_depth(decoded, self.expected, mean, a, b), rows, self.threads)
        splat_depth(mean, motion, found)
        for_ranges(lambda a, b: fill_gaps(found, filled, a, b), rows, self.threads)
        for_ranges(lambda a, b: refine_depth(mean, motion, filled, expected, a, b), rows, self.threads)
        self.expected = expected
        return np.minimum(np.floor(expected + 0.5), MAX_RAW).astype(np.uint16)

    def _motion(self, number: int) -> CameraMotion:
        """Return the motion since the frame before, in raw units."""
        T_now_before = compose(self.poses[number], inverse(self.poses[number - 1]))
        T_now_before[:3, 3] *= self.scale
        return CameraMotion(self.slopes, self.parameters, T_now_before, inverse(T_now_before))
