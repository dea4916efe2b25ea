# SPDX-License-Identifier: MIT
"""Cameras, mountings and clocks of sensors as the stream tells them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from threedvc.errors import ConfigError, CorruptStream
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, identity, make_pose
from threedvc.stream.headers import (
    SensorHeader,
    StreamHeader,
)
from threedvc.units import NANOSECONDS

__all__ = ["camera_record", "clock_record", "nearest_multiple", "rig_of", "transform_record"]


def rig_of(header: StreamHeader | SensorHeader) -> CameraRig:
    """Return the cameras of a stream's first sensor, or of a further one.

    Raises
    ------
    CorruptStream
        If they are impossible.
    """
    try:
        color = _camera(header.color_camera)
        depth = _camera(header.depth_camera) if header.depth_camera else color
        mount = header.T_depth_rig if isinstance(header, SensorHeader) else ()
        return CameraRig(
            color=color, depth=depth, T_color_depth=_transform(header.T_color_depth), T_depth_rig=_transform(mount)
        )
    except ConfigError as error:
        raise CorruptStream(f"{header.packet_type.name} header: {error}") from None


def _transform(rows: tuple[float, ...]) -> Pose:
    """Return the transform of three rows, row by row; the identity if there are none."""
    if not rows:
        return identity()
    matrix = np.array(rows, dtype=np.float64).reshape(3, 4)
    return make_pose(matrix[:, :3], matrix[:, 3])


def nearest_multiple(frame: int, period_num: int, period_den: int) -> int:
    """Return ``frame * period_num / period_den`` rounded to the nearest integer, halves up."""
    return (2 * frame * period_num + period_den) // (2 * period_den)


def _camera(values: tuple[float, ...]) -> Camera:
    width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3 = values
    return Camera(
        width=int(width), height=int(height), fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3)
    )  # fmt: skip


def camera_record(camera: Camera) -> tuple[float, ...]:
    """Return a camera as the stream tells it; see `rig_of`."""
    return (camera.width, camera.height, *camera.parameters().tolist())


def transform_record(T: Pose) -> tuple[float, ...]:
    """Return the upper three rows of a transform, nothing for the identity."""
    return () if np.array_equal(T, np.eye(4)) else tuple(T[:3].ravel().tolist())


def clock_record(fps: float) -> tuple[int, int]:
    """Return the frame period in nanoseconds as a fraction."""
    period = NANOSECONDS / Fraction(fps).limit_denominator(100_000)
    return period.numerator, period.denominator
