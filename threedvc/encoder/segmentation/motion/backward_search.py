# SPDX-License-Identifier: MIT
"""Where an object is, by its finished model, in frames before it was known to be one."""

from __future__ import annotations

import numpy as np

from threedvc.arrays import Mask
from threedvc.encoder.registration.frame_resolutions import FrameResolutions, ObjectView
from threedvc.encoder.segmentation.motion.moving_body import MotionHypothesis
from threedvc.encoder.segmentation.motion.prepared_frame import AGREEMENT, FINE_GATE, GATE_SIGMAS, MIN_PIXELS
from threedvc.encoder.segmentation.motion.segmenter_state import SegmenterState
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import Pose, inverse
from threedvc.stream.pose_status import PoseStatus

__all__ = ["find_among", "visible_pixels"]


def visible_pixels(state: SegmenterState, body: MotionHypothesis, frame: Frame) -> Mask | None:
    """Return the pixels (h, w) of a frame that show a body where it was found, or before that where it was first.

    None if it was not there: most of what is not hidden by something must be seen. No pixel if all of it is hidden.
    """
    small, pose = state.downsampled(frame), body.pose_of(frame.index)
    if pose is None:
        pose = _first_pose_seen_from(state, body, frame.index)
    if pose is None:
        return None
    shown, depth = state.predicted_depth(body, pose), small.depth
    sigma_m = state.sensor.sigma_m(depth.astype(np.float64))
    gate_m = (GATE_SIGMAS * sigma_m + FINE_GATE * depth).astype(np.float32)
    known = (shown > 0) & (depth > 0)
    on, hidden = known & (np.abs(depth - shown) < gate_m), known & (depth < shown - gate_m)
    open_to_view = np.count_nonzero(known & ~hidden)
    if open_to_view < MIN_PIXELS:
        return np.zeros(depth.shape, dtype=np.bool_)
    return np.asarray(on, dtype=np.bool_) if np.count_nonzero(on) >= AGREEMENT * open_to_view else None


def _first_pose_seen_from(state: SegmenterState, body: MotionHypothesis, frame: int) -> Pose | None:
    """Return T_camera_object in a frame of a body at rest where it was found first, None if the camera was lost."""
    first = min(body.found)
    camera, camera_then = state.pose_of(frame), state.pose_of(first)
    if camera is None or camera_then is None:
        return None
    return camera @ inverse(camera_then) @ body.found[first].T_camera_object


def find_among(state: SegmenterState, body: MotionHypothesis, frame: Frame, free: Mask) -> Mask | None:
    """Find a body in a frame before it was first found, among free pixels (h, w); return its pixels, or None."""
    if np.count_nonzero(free) < MIN_PIXELS:
        return None
    body.tracker.resume(body.found[min(body.found)].T_camera_object)
    views = FrameResolutions(state.downsampled(frame), state.full, state.full)
    at = body.tracker.locate([ObjectView(views, free)], body.model)
    if at.status is not PoseStatus.TRACKED:
        return None
    body.found[frame.index] = at
    mask = visible_pixels(state, body, frame)
    if mask is None or not np.any(mask):
        del body.found[frame.index]
        return None
    return mask
