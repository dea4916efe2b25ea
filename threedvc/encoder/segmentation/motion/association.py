# SPDX-License-Identifier: MIT
"""Which pixels of a frame belong to the bodies that are followed."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats, Labels, Mask
from threedvc.encoder.registration.frame_resolutions import ObjectView
from threedvc.encoder.segmentation.motion.morphology import opened, square
from threedvc.encoder.segmentation.motion.moving_body import MAX_LOST_FRAMES, MotionHypothesis
from threedvc.encoder.segmentation.motion.object_evidence import is_object
from threedvc.encoder.segmentation.motion.prepared_frame import (
    COARSE_GATE,
    FINE_GATE,
    MIN_PIXELS,
    MIN_VOTES,
    PreparedFrame,
)
from threedvc.encoder.segmentation.motion.segmenter_state import SegmenterState

__all__ = ["depth_residual", "label_followed", "label_remnants", "locate_followed"]

VIEW_WINDOW = 5
"""Side in pixels of the surroundings in which a model may show a depth: poses and edges are not exact."""
OWN_OFFSETS = (2, 4, 7, 11, 16, 22, 30, 40)
"""Frames back of those that are asked in a body's own frame: gaps grow, so that slow and fast turns both show; eight
do, for only pixels connected with the body are asked for."""
YOUNG_FRAMES = 10
"""Age in frames below which a body has little patience: most that are lost so soon are noise."""
YOUNG_PATIENCE = 1
"""Frames in a row that such a body may be lost in."""
MIN_GATE_M = 1e-6
"""Keeps the ratio to a gate finite where there is no depth."""


def locate_followed(state: SegmenterState, prepared: PreparedFrame, bodies: Sequence[MotionHypothesis]) -> None:
    """Find bodies that are followed where the frame shows them."""
    predicted = [(body, state.coarse_predicted_depth(body, body.predicted(prepared.index))) for body in bodies]
    owner = _nearest_bodies(state, prepared, predicted, prepared.gate_m(COARSE_GATE))
    for body in bodies:
        mask = (owner == body.number) | _unowned_remnants(prepared, owner, body.number)
        _locate(state, prepared, body, mask)


def _locate(state: SegmenterState, prepared: PreparedFrame, body: MotionHypothesis, mask: Mask) -> None:
    """Register what a body may be seen at, `mask` (h, w), with its model; drop it if it is lost for too long."""
    at = None
    if np.count_nonzero(mask) >= MIN_PIXELS:
        at = body.tracker.locate([ObjectView(prepared.views, mask)], body.model, near=not is_object(state, body))
    if at is not None and at.usable:
        body.find(prepared.index, at)
        return
    body.lost_frames += 1
    patience = MAX_LOST_FRAMES if prepared.index - body.born >= YOUNG_FRAMES else YOUNG_PATIENCE
    body.dropped = body.lost_frames > patience and not is_object(state, body)


def label_followed(state: SegmenterState, prepared: PreparedFrame, bodies: Sequence[MotionHypothesis]) -> None:
    """Label the pixels of bodies that were found."""
    found = [body for body in bodies if prepared.index in body.found]
    shown = [(body, state.predicted_depth(body, body.found[prepared.index].T_camera_object)) for body in found]
    prepared.labels = _nearest_bodies(state, prepared, shown, prepared.gate_m(FINE_GATE))
    for body in found:
        _label_connected(state, prepared, body)


def _label_connected(state: SegmenterState, prepared: PreparedFrame, body: MotionHypothesis) -> None:
    """Let a body have the pixels connected with it that nothing tells against."""
    index = prepared.index
    free = _unowned_remnants(prepared, prepared.labels, body.number)
    shown = int(np.count_nonzero(prepared.pixels_of(body)))
    body.explained[index] = shown / max(shown + int(np.count_nonzero(free)), 1)
    if not free.any():
        return
    pose, earlier = body.found[index].T_camera_object, [index - k for k in OWN_OFFSETS]
    through, _ = state.history.count_free_space_votes(prepared.depth, free, pose, earlier, body.pose_of, whole=False)
    prepared.labels[free & ~opened(through >= MIN_VOTES)] = body.number


def label_remnants(prepared: PreparedFrame) -> None:
    """Give what is too small to be a body to the one that it is connected with."""
    for number in np.unique(prepared.labels[prepared.moving]).tolist():
        if number:
            prepared.labels[_unowned_remnants(prepared, prepared.labels, number)] = number


def _nearest_bodies(
    state: SegmenterState,
    prepared: PreparedFrame,
    predicted: Sequence[tuple[MotionHypothesis, Floats]],
    gate_m: Floats,
) -> Labels:
    """Return for each moving pixel (h, w) the number of the body whose predicted depth is next to it within a gate."""
    depth = prepared.depth
    least = np.ones(depth.shape, np.float32)
    owner, known = np.zeros(depth.shape, np.uint16), depth > 0
    for body, shown in predicted:
        residual = depth_residual(depth, shown) / np.maximum(gate_m, MIN_GATE_M)
        mine = prepared.moving
        if is_object(state, body):
            # What stands still for long is no longer seen to move.
            mine = mine | (known & (shown > 0) & (np.abs(depth - shown) < prepared.gate_m(FINE_GATE)))
        mine = mine & (residual < least)
        owner[mine], least[mine] = body.number, residual[mine]
    return owner


def depth_residual(depth: Floats, shown: Floats) -> Floats:
    """Return how far (h, w) depths are from those that a model shows about them; infinite where it shows none."""
    low = cv2.erode(np.where(shown > 0, shown, np.float32(np.inf)), square(VIEW_WINDOW))
    high = cv2.dilate(shown, square(VIEW_WINDOW))
    residual = np.maximum(np.maximum(low - depth, depth - high), 0)
    return np.where(high > 0, residual, np.float32(np.inf)).astype(np.float32)


def _unowned_remnants(prepared: PreparedFrame, owner: Labels, number: int) -> Mask:
    """Return the pixels (h, w) that nobody owns of the surfaces of which a body owns most."""
    free = np.zeros_like(prepared.moving)
    for surface in _surfaces_owned(prepared.surfaces, owner, number):
        free |= (prepared.surfaces == surface) & (owner == 0)
    return free


def _surfaces_owned(surfaces: NDArray[np.int32], owner: Labels, number: int) -> list[int]:
    """Return the surfaces of which a body has more pixels than any other body."""
    mine = np.bincount(surfaces[owner == number], minlength=surfaces.max() + 1)
    chosen = []
    for surface in np.flatnonzero(mine).tolist():
        owners = np.bincount(owner[surfaces == surface], minlength=number + 1)
        if surface and owners[1:].max() == owners[number]:
            chosen.append(surface)
    return chosen
