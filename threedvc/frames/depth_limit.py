# SPDX-License-Identifier: MIT
"""How far measurements of depth are used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.frames.sensor_model import SensorModel

__all__ = ["limited_depth"]

MAX_DEPTH_M = 1e4
"""No depth camera measures farther; what says so is no measurement."""


def limited_depth(
    depth: NDArray[np.float32], asked_m: float | None, sensor: SensorModel | None = None
) -> NDArray[np.float32]:
    """Return a depth map without what is no number, and without measurements beyond the largest depth.

    Parameters
    ----------
    depth
        (h, w) float32 meters, 0 = none.
    asked_m
        The largest depth in meters; None: where the sensor is no longer good to 0.1 m.
    sensor
        The sensor that measured it; None: not known, then all that can be coded is kept.
    """
    limit = asked_m or (sensor.reach_m if sensor else MAX_DEPTH_M)
    return np.where((depth > 0) & (depth <= limit), depth, np.float32(0))
