# SPDX-License-Identifier: MIT
"""Pinhole cameras with lens distortion, and the pair of cameras that takes an RGB-D frame.

Camera axes are OpenCV's: x right, y down, z forward. The center of the top-left pixel is (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import ConfigError
from threedvc.geometry.pose import Pose, compose, identity, inverse, is_rigid

__all__ = ["Camera", "CameraRig"]

MAX_SIDE = 16384
"""Pixels of a picture's side in the format of the stream: more than any camera has, and pixels still fit into 32
bits."""
UNDISTORTION_STEPS = 20
"""Of the fixed-point iteration. Measured on the lenses of the TUM sensors: the last one moves no pixel by 1e-7."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """One camera: picture size in pixels, pinhole intrinsics in pixels, Brown-Conrady distortion.

    Parameters
    ----------
    width, height
        Picture size.
    fx, fy, cx, cy
        Focal lengths and principal point.
    distortion
        ``k1, k2, p1, p2, k3`` in OpenCV's order.

    Raises
    ------
    ConfigError
        If a size is not in 1..16384 or an intrinsic is not finite and positive.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (1 <= self.width <= MAX_SIDE and 1 <= self.height <= MAX_SIDE):
            raise ConfigError(f"picture size {self.width}x{self.height} is not within 1..{MAX_SIDE} pixels")
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.all(np.isfinite(values)) or self.fx <= 0 or self.fy <= 0:
            raise ConfigError(
                f"intrinsics fx={self.fx} fy={self.fy} cx={self.cx} cy={self.cy} must be finite, focal lengths positive"
            )
        if len(self.distortion) != 5:
            raise ConfigError(f"distortion needs 5 coefficients k1 k2 p1 p2 k3, got {len(self.distortion)}")

    @property
    def distorted(self) -> bool:
        """Whether any distortion coefficient differs from zero."""
        return any(self.distortion)

    def resized(self, width: int, height: int) -> Camera:
        """Return the same camera with another picture size (the same field of view)."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
        )

    def every(self, n: int, x: int = 0, y: int = 0) -> Camera:
        """Return the camera of every n-th pixel along both axes, from pixel (x, y) on."""
        return replace(
            self,
            width=-(-(self.width - x) // n),
            height=-(-(self.height - y) // n),
            fx=self.fx / n,
            fy=self.fy / n,
            cx=(self.cx - x) / n,
            cy=(self.cy - y) / n,
        )

    def parameters(self) -> NDArray[np.float64]:
        """Return ``fx, fy, cx, cy, k1, k2, p1, p2, k3`` as one (9,) array for the kernels."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion], dtype=np.float64)

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Project points (..., 3) in camera coordinates (meters, z > 0) to distorted pixels (..., 2)."""
        x = points[..., 0] / points[..., 2]
        y = points[..., 1] / points[..., 2]
        x, y = self._distort(x, y)
        return np.stack([self.fx * x + self.cx, self.fy * y + self.cy], axis=-1)

    def rays(self) -> NDArray[np.float64]:
        """Return undistorted ray slopes ``(x/z, y/z)`` of every pixel center, (height, width, 2).

        Lens distortion is inverted by fixed-point iteration with + - * / alone, so that every
        machine computes the same rays.
        """
        u, v = np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64))
        return self.unproject_pixels(np.stack([u, v], axis=-1))

    def unproject_pixels(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return undistorted ray slopes ``(x/z, y/z)`` of distorted pixels (..., 2)."""
        xd = (pixels[..., 0] - self.cx) / self.fx
        yd = (pixels[..., 1] - self.cy) / self.fy
        if not self.distorted:
            return np.stack([xd, yd], axis=-1)
        k1, k2, p1, p2, k3 = self.distortion
        x, y = xd, yd
        for _ in range(UNDISTORTION_STEPS):
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
            dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
            x, y = (xd - dx) / radial, (yd - dy) / radial
        return np.stack([x, y], axis=-1)

    def _distort(
        self, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        if not self.distorted:
            return x, y
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return xd, yd


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraRig:
    """The color and the depth camera of one sensor.

    Parameters
    ----------
    color, depth
        The two cameras. Registered input has one camera in both places.
    T_color_depth
        ``p_color = T_color_depth @ p_depth``, (4, 4). Poses of a frame belong to the depth camera.
    T_depth_rig
        ``p_depth = T_depth_rig @ p_rig``, (4, 4): how the sensor is mounted among several. Poses of a scene belong
        to the frame of the rig, which is that of the first sensor's depth camera.

    Raises
    ------
    ConfigError
        If an extrinsic is not a rigid transform.
    """

    color: Camera
    depth: Camera
    T_color_depth: Pose
    T_depth_rig: Pose = field(default_factory=identity)

    def __post_init__(self) -> None:
        for name in ("T_color_depth", "T_depth_rig"):
            if not is_rigid(getattr(self, name)):
                raise ConfigError(f"{name} is not a rigid transform; give a 4x4 matrix with an orthonormal rotation")

    @classmethod
    def registered_to(cls, camera: Camera) -> CameraRig:
        """Return the rig of input whose depth is registered to its color, pixel by pixel."""
        return cls(color=camera, depth=camera, T_color_depth=identity())

    @property
    def registered(self) -> bool:
        """Whether one ray serves both the color and the depth of a pixel."""
        return self.color == self.depth and np.array_equal(self.T_color_depth, np.eye(4))

    @property
    def mounted(self) -> bool:
        """Whether the depth camera is elsewhere than the frame of the rig."""
        return not np.array_equal(self.T_depth_rig, np.eye(4))

    def at_sensor(self, T_rig_object: Pose) -> Pose:
        """Return the pose before the depth camera of what has a pose before the rig."""
        return compose(self.T_depth_rig, T_rig_object) if self.mounted else T_rig_object

    def at_rig(self, T_camera_object: Pose) -> Pose:
        """Return the pose before the rig of what has a pose before the depth camera."""
        return compose(inverse(self.T_depth_rig), T_camera_object) if self.mounted else T_camera_object

    def resized(self, width: int, height: int) -> CameraRig:
        """Return the rig with both pictures brought to one size."""
        return replace(self, color=self.color.resized(width, height), depth=self.depth.resized(width, height))
