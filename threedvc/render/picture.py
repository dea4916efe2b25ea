# SPDX-License-Identifier: MIT
"""What a renderer draws, and what it draws with: background images, light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose

__all__ = ["BackgroundImage", "Light", "Picture"]


@dataclass(frozen=True, kw_only=True, eq=False)
class BackgroundImage:
    """A picture that colors the background.

    Attributes
    ----------
    picture
        (h, w, 3) uint8 RGB.
    camera
        The camera that sees it.
    T_camera_world
        Pose of that camera.
    """

    picture: NDArray[np.uint8]
    camera: Camera
    T_camera_world: Pose


@dataclass(frozen=True, kw_only=True, eq=False)
class Light:
    """Light on an object.

    Attributes
    ----------
    factors
        (8,) float64, see `threedvc.kernels.render.shading.light_basis`.
    R_world_object
        (3, 3) turn of the object in the world, where the light stands still.
    """

    factors: NDArray[np.float64]
    R_world_object: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A drawn frame.

    Attributes
    ----------
    color
        (h, w, 3) uint8 RGB in the color camera.
    depth
        (h, w) float32 meters in the depth camera, 0 = nothing there.
    labels
        (h, w) uint8 object numbers in the depth camera, 0 = background or nothing.
    pixel_classes
        (h, w) uint8 classes of the color picture's pixels, see `threedvc.model.post_filter`; None without a filter.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    labels: NDArray[np.uint8]
    pixel_classes: NDArray[np.uint8] | None = None
