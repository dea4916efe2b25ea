# SPDX-License-Identifier: MIT
"""Whether a tracked camera moves at all, or only trembles by the noise of its depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, inverse, rotation_angle

__all__ = ["hardly_moves"]

MAX_REST_PIXELS = 0.5
"""A camera that is tracked and never goes further than this stands still, and trembles by the noise of its depth."""
MIN_DISTANCE_M = 1e-6
"""Keeps the division finite where no distance is known."""


def hardly_moves(found: Sequence[TrackedPose | None], rigs: Sequence[CameraRig], distance_m: float) -> bool:
    """Tell whether all poses at which an object was tracked lie within half a pixel of the first one."""
    tracked = [at.T_camera_object for at in found if at is not None and at.usable]
    focal = max(rig.depth.fx for rig in rigs)
    return bool(tracked) and all(
        _displacement(inverse(tracked[0]) @ pose, distance_m) * focal < MAX_REST_PIXELS for pose in tracked
    )


def _displacement(T: Pose, distance_m: float) -> float:
    """Return by how much a motion displaces what lies at a distance at most, in slopes."""
    return rotation_angle(T) + float(np.linalg.norm(T[:3, 3])) / max(distance_m, MIN_DISTANCE_M)
