# SPDX-License-Identifier: MIT
"""Whether an object moves at all."""

from __future__ import annotations

import numpy as np

from threedvc.geometry.pose import Pose, rotation_angle

__all__ = ["REST_PIXELS", "displacement"]

REST_PIXELS = 0.5
"""A camera that is tracked and never goes further than this stands still, and trembles by the noise of its depth."""


def displacement(T: Pose, distance_m: float) -> float:
    """Return by how much a motion displaces what lies at a distance at most, in slopes."""
    return rotation_angle(T) + float(np.linalg.norm(T[:3, 3])) / max(distance_m, 1e-6)
