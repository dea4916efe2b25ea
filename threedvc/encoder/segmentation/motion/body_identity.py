# SPDX-License-Identifier: MIT
"""Which body it is that moves: a new one, one that was lost and came back, or a part of another one."""

from __future__ import annotations

import numpy as np

from threedvc.arrays import Doubles, Mask
from threedvc.encoder.registration.frame_resolutions import ObjectView
from threedvc.encoder.segmentation.motion.association import depth_residual
from threedvc.encoder.segmentation.motion.moving_body import COLOR_LEVELS, MotionHypothesis
from threedvc.encoder.segmentation.motion.object_evidence import is_object
from threedvc.encoder.segmentation.motion.prepared_frame import (
    AGREEMENT,
    FINE_GATE,
    MIN_PIXELS,
    MIN_VOTES,
    PreparedFrame,
    connected_surfaces,
)
from threedvc.encoder.segmentation.motion.reference_frames import NEAR_OFFSETS
from threedvc.encoder.segmentation.motion.segmenter_state import SegmenterState, cell_size
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.encoder.tracking.tracker import Tracker
from threedvc.geometry.pose import Pose, inverse, make_pose, rotation_angle
from threedvc.stream.pose_status import PoseStatus

__all__ = ["color_histogram", "label_new_bodies", "merge_moving_together", "recognize_lost"]

MIN_BIRTH_TRANSIENCE = 0.25
"""Share of the frames that tell about a surface that must have seen through it, so that it may be a body: what has just
begun to move was seen to be at rest by most."""
MIN_AREA_M2 = 0.0006
"""Area of the smallest body: that of a square of 2.4 cm, about a thumb."""
RECOGNITION_FRAMES, RECOGNITION_STRIDE = 60, 5
"""Age up to which a new object is held against lost ones, for by then its sides have been seen, and frames from one
time to the next: each takes a registration for every lost object."""
MERGE_FRAMES = 12
"""Frames that two bodies must go the same way for to be one: what does so by chance parts sooner (decision 0016)."""
MAX_MERGE_RADII = 3.0
"""How far apart the middles of two parts of one body may be, in times of both their radii."""
MAX_RELATIVE_SHIFT, MAX_RELATIVE_ROTATION, MIN_COMMON_SHIFT = 0.01, 0.06, 4.0
"""By how much of their distance and by what angle two bodies may move against each other to be one, if they went so
many times as far."""
MAX_BLOCKING = 0.3
"""Share of a body that other frames saw through where it would have been as a part of another: then it is none."""


def label_new_bodies(state: SegmenterState, prepared: PreparedFrame) -> None:
    """Make bodies of connected surfaces that move and belong to none, or find that they are ones that were lost."""
    depth = prepared.depth
    surfaces = connected_surfaces(depth, prepared.moving & (prepared.labels == 0))
    sizes = np.bincount(surfaces.ravel())
    area_m2 = np.bincount(surfaces.ravel(), (depth.ravel() / state.rig.depth.fx) ** 2)
    for surface in np.flatnonzero((sizes >= MIN_PIXELS) & (area_m2 >= MIN_AREA_M2)).tolist():
        mask = surfaces == surface
        if surface == 0 or float(prepared.transience[mask].mean()) < MIN_BIRTH_TRANSIENCE:
            continue
        body = _lost_body_at(state, prepared, mask) or _new_body(state, prepared, mask)
        prepared.labels[mask] = body.number


def recognize_lost(state: SegmenterState, prepared: PreparedFrame) -> None:
    """See whether new objects, now that more of them is seen, are ones that were lost."""
    index = prepared.index
    for body in state.bodies:
        if index not in body.found or index < body.compared_next or not is_object(state, body):
            continue
        if index > body.born + RECOGNITION_FRAMES:
            continue
        body.compared_next = index + RECOGNITION_STRIDE
        old = _lost_body_at(state, prepared, prepared.pixels_of(body))
        if old is not None:
            body.merge_into(old, index)
            prepared.relabel(body, old)


def merge_moving_together(state: SegmenterState, prepared: PreparedFrame) -> None:
    """Make one body of two that go the same way."""
    index = prepared.index
    here = [body for body in state.bodies if index in body.found and index >= body.born + MERGE_FRAMES]
    for k, body in enumerate(here):
        for old in here[:k]:
            if old.merged_into is not None or body.merged_into is not None:
                continue
            if _move_together(state, prepared, old, body) and not _would_block(state, prepared, old, body):
                body.merge_into(old, index)
                prepared.relabel(body, old)


def color_histogram(state: SegmenterState, prepared: PreparedFrame, mask: Mask) -> Doubles:
    """Count the colors of pixels (h, w); none where the color camera is another one."""
    if not state.rig.registered:
        return np.zeros(COLOR_LEVELS**3)
    levels = prepared.frame.color[mask].astype(np.intp) * COLOR_LEVELS // 256
    bins = levels @ np.array([1, COLOR_LEVELS, COLOR_LEVELS**2])
    return np.bincount(bins, minlength=COLOR_LEVELS**3).astype(np.float64)


def _new_body(state: SegmenterState, prepared: PreparedFrame, mask: Mask) -> MotionHypothesis:
    number, frame = len(state.bodies) + 1, prepared.frame
    body = MotionHypothesis(
        number,
        frame.index,
        cell_size(frame.depth, mask, state.rig),
        float(np.sqrt(np.sum((frame.depth[mask] / state.rig.depth.fx) ** 2) / np.pi)),
        Tracker(state.sensor, state.threads, recovers=False),
    )
    body.find(frame.index, body.tracker.start(ObjectView(prepared.views, mask), number, state.rig))
    state.bodies.append(body)
    return body


def _lost_body_at(state: SegmenterState, prepared: PreparedFrame, mask: Mask) -> MotionHypothesis | None:
    """Return the object that is not found elsewhere and is what pixels (h, w) show, or None."""
    histogram = color_histogram(state, prepared, mask)
    for body in state.bodies:
        if prepared.index in body.found or body.merged_into is not None or not is_object(state, body):
            continue
        if not body.looks_like(histogram):
            continue
        at = _registered_at(state, prepared, body, mask)
        if at is not None:
            body.find(prepared.index, at)
            return body
    return None


def _registered_at(
    state: SegmenterState, prepared: PreparedFrame, body: MotionHypothesis, mask: Mask
) -> TrackedPose | None:
    """Return where a lost body is if it is what pixels (h, w) show; else its tracker stays where it was."""
    last = body.last_pose
    # Where the body is seen as a whole: at its last pose it may be half out of the picture.
    body.tracker.resume(make_pose(last[:3, :3], _median_point(state, prepared, mask)))
    at = body.tracker.locate([ObjectView(prepared.views, mask)], body.model)
    if at.status is PoseStatus.TRACKED and _agree(state, prepared, body, at.T_camera_object, mask):
        return at
    body.tracker.resume(last)
    return None


def _agree(state: SegmenterState, prepared: PreparedFrame, body: MotionHypothesis, pose: Pose, mask: Mask) -> bool:
    """Tell whether pixels (h, w) show what the model does, and the frame what the model shows unhidden."""
    depth, gate_m = prepared.depth, prepared.gate_m(FINE_GATE)
    predicted = state.predicted_depth(body, pose)
    near, shown = depth_residual(depth, predicted) < gate_m, (predicted > 0) & (depth > predicted - gate_m)
    alike = np.count_nonzero(near & mask) > AGREEMENT * np.count_nonzero(mask)
    return bool(alike and np.count_nonzero(shown & near) > AGREEMENT * np.count_nonzero(shown))


def _median_point(state: SegmenterState, prepared: PreparedFrame, mask: Mask) -> Doubles:
    z = prepared.depth[mask].astype(np.float64)
    return np.median(np.column_stack([state.rays[mask] * z[:, None], z]), axis=0)


def _move_together(
    state: SegmenterState, prepared: PreparedFrame, one: MotionHypothesis, other: MotionHypothesis
) -> bool:
    """Tell whether two bodies moved in the last frames, and not against each other."""
    frame, camera = prepared.index, prepared.T_camera_world
    here, there = one.pose_of(frame), other.pose_of(frame)
    if here is None or there is None:
        return False
    relative, shift_m = [], 0.0
    for k in range(frame - MERGE_FRAMES, frame):
        first, second, camera_then = one.pose_of(k), other.pose_of(k), state.pose_of(k)
        if first is None or second is None or camera_then is None:
            return False
        relative.append(inverse(first) @ second)
        moved = inverse(inverse(camera_then) @ first) @ inverse(camera) @ here
        shift_m = max(shift_m, float(np.linalg.norm(moved[:3, 3])))
    now = inverse(here) @ there
    slack_m = MAX_RELATIVE_SHIFT * here[2, 3]
    near = np.linalg.norm(now[:3, 3]) < MAX_MERGE_RADII * (one.radius_m + other.radius_m)
    return (
        bool(near)
        and shift_m > MIN_COMMON_SHIFT * slack_m
        and all(
            np.linalg.norm((T - now)[:3, 3]) < slack_m and rotation_angle(inverse(T) @ now) < MAX_RELATIVE_ROTATION
            for T in relative
        )
    )


def _would_block(
    state: SegmenterState, prepared: PreparedFrame, one: MotionHypothesis, other: MotionHypothesis
) -> bool:
    """Tell whether one of two bodies would have been in the way of what frames saw, had it moved with the other."""
    index = prepared.index
    for body, carrier in ((one, other), (other, one)):
        mask = prepared.pixels_of(body)
        earlier = sorted(k for k in carrier.found if k < index - MERGE_FRAMES)
        earlier = earlier[:: max(1, len(earlier) // len(NEAR_OFFSETS))]
        pose = carrier.found[index].T_camera_object
        through, _ = state.history.count_free_space_votes(
            prepared.depth, mask, pose, earlier, carrier.pose_of, whole=False
        )
        if np.count_nonzero(through >= MIN_VOTES) > MAX_BLOCKING * np.count_nonzero(mask):
            return True
    return False
