# SPDX-License-Identifier: MIT
"""What makes an object of a body: that it moved as one, for long and far enough, through what was seen to be empty."""

from __future__ import annotations

import numpy as np

from threedvc.encoder.segmentation.motion.moving_body import MotionHypothesis
from threedvc.encoder.segmentation.motion.segmenter_state import SegmenterState
from threedvc.geometry.pose import inverse, rotation_angle

__all__ = ["displacement_m", "is_object"]

MIN_FRAMES = 10
"""Frames that a body must be tracked in, and seen to be transient in: a third of a second."""
MIN_OBJECT_TRANSIENCE, MIN_FAR_TRANSIENCE = 0.5, 0.4
"""Share of the frames that must have seen through it in these, and that of what went far. Measured: the share of edges
that slide along with the camera stays below a half, that of things that move is above it (decision 0016)."""
FAR_RADII, FAR_SHARE = 2.0, 0.1
"""What went farther than so many times its radius and such a part of its distance went far."""
MIN_EXPLAINED = 0.6
"""Part of its surfaces that its model must show on an average: what changes its shape does not move as one."""
MIN_DISPLACEMENT_M, MIN_DISPLACEMENT = 0.02, 0.03
"""Meters, and part of its distance, that it must have gone: more than errors of poses and of calibration."""


def is_object(state: SegmenterState, body: MotionHypothesis) -> bool:
    """Tell whether a body is an object; it stays one from the first time on that it turns out to be."""
    if body.confirmed_in is not None:
        return True
    frames = [k for k in body.found if body.pose_of(k) is not None]
    shares = sorted(body.transience.values(), reverse=True)
    if min(len(frames), len(shares)) < MIN_FRAMES or shares[MIN_FRAMES - 1] <= MIN_FAR_TRANSIENCE:
        return False
    if np.mean([body.explained.get(k, 1.0) for k in frames]) < MIN_EXPLAINED:
        return False
    moved_m, distance_m = displacement_m(state, body), float(body.found[frames[0]].T_camera_object[2, 3])
    far = moved_m > max(FAR_RADII * body.radius_m, FAR_SHARE * distance_m)
    enough = far or shares[MIN_FRAMES - 1] > MIN_OBJECT_TRANSIENCE
    if enough and moved_m > max(MIN_DISPLACEMENT_M, MIN_DISPLACEMENT * distance_m):
        body.confirmed_in = max(frames)
    return body.confirmed_in is not None


def displacement_m(state: SegmenterState, body: MotionHypothesis) -> float:
    """Return how far the points of a body went from where it was first, on an average."""
    places = []
    for k in sorted(body.found):
        at, camera = body.pose_of(k), state.pose_of(k)
        if at is not None and camera is not None:
            places.append(inverse(camera) @ at)
    moves = [inverse(places[0]) @ place for place in places]
    return max((float(np.hypot(np.linalg.norm(T[:3, 3]), body.radius_m * rotation_angle(T))) for T in moves), default=0)
