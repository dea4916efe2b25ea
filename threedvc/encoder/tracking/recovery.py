# SPDX-License-Identifier: MIT
"""Where registration fails: go on, wait, look by keyframes, or begin a new submap (decision 0017)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.registration.frame_resolutions import ObjectView
from threedvc.encoder.registration.model_view import predicted_and_measured_depth, raycast_model
from threedvc.encoder.registration.registration import ModelView, Registration, register
from threedvc.encoder.tracking.joint_registration import RegistrationSettings
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.encoder.tracking.track_state import TrackState
from threedvc.frames.frame import Frame
from threedvc.stream.pose_status import PoseStatus

__all__ = ["begin_submap", "coast", "pose_without_registration", "recognize_submap", "relocalize"]

MIN_KNOWN = 0.3
"""Where a view of the model has less than this part of a frame's pixels, the frame shows something new."""
MAX_DIFFERENCE = 0.015
"""Part of its depth by which a pixel may differ from the model where the object rests: what sensors scatter by."""
MIN_ALIKE_PIXELS, MIN_ALIKE = 20, 0.7
"""An object rests where so many pixels at least, and this part of those known, are alike: some always differ at its
outline."""
COAST_FRAMES = 5
"""A lost object goes on as it went for so many frames, then stays: its motion may have changed by then."""


def pose_without_registration(
    state: TrackState,
    seen: Sequence[ObjectView],
    views: Sequence[ModelView],
    model: EvidenceModel,
    *,
    threads: int,
    in_background: bool,
) -> TrackedPose | None:
    """Return the pose of an object that registration does not find but that is known by other means; None if it is not.

    It goes on as other sensors saw it, where the model knows nothing of what the frames show; it rests in the
    background which it was carried along with, where nothing speaks against that.
    """
    if state.found_by_others(seen[0].frame) and not any(map(_overlap, seen, views)):
        return _extrapolate(state, seen)
    if in_background and _fits_at_rest(state, seen, model, threads):
        return _hold_pose(state, seen)
    return None


def _overlap(seen: ObjectView, view: ModelView) -> bool:
    """Tell whether a view of the model shows enough where a frame shows something that they can be compared."""
    shown = seen.object_depth > 0
    return bool(np.count_nonzero(view.depth[shown] > 0) >= MIN_KNOWN * np.count_nonzero(shown))


def _extrapolate(state: TrackState, seen: Sequence[ObjectView]) -> TrackedPose:
    pose = state.extrapolated(seen[0].frame.timestamp_ns)
    for each in seen:
        state.remember_view(each, pose)
    return TrackedPose(T_camera_object=pose, status=PoseStatus.WEAK, submap=state.submaps.current)


def _fits_at_rest(state: TrackState, seen: Sequence[ObjectView], model: EvidenceModel, threads: int) -> bool:
    """Tell whether nothing speaks against the last pose: the depth is as shown there, or the model knows little."""
    count = known = alike = 0
    for each in seen:
        there = each.rig.at_sensor(state.pose)
        shown, measured = predicted_and_measured_depth(model, each.views, each.mask, there, threads)
        both = (shown > 0) & (measured > 0)
        count, known = count + int(np.count_nonzero(measured)), known + int(np.count_nonzero(both))
        alike += int(np.count_nonzero(np.abs(shown - measured)[both] < MAX_DIFFERENCE * measured[both]))
    if known < MIN_KNOWN * count:
        return not state.lost_frames
    return known >= MIN_ALIKE_PIXELS and alike >= MIN_ALIKE * known


def _hold_pose(state: TrackState, seen: Sequence[ObjectView]) -> TrackedPose:
    state.lost_frames = 0
    state.jump_to(state.pose, seen[0].frame)
    for each in seen:
        state.remember_view(each)
    state.note_found(seen[0].frame, state.pose)
    return TrackedPose(T_camera_object=state.pose, status=PoseStatus.WEAK, submap=state.submaps.current)


def relocalize(
    state: TrackState,
    found: Registration,
    seen: Sequence[ObjectView],
    model: EvidenceModel,
    settings: RegistrationSettings,
) -> Registration:
    """Look for the object by its keyframes; return that if it agrees better, else what was found.

    A poor fit elsewhere than expected is no find for an object that was lost.
    """
    if state.keyframes is not None:
        state.forget_views()
    again = _best_by_keyframes(state, seen, model, settings)
    if again is not None and again.agreement > found.agreement * (found.status is not PoseStatus.LOST):
        return replace(again, status=PoseStatus.RELOCALIZED)
    return replace(found, status=PoseStatus.LOST) if state.lost_frames else found


def recognize_submap(
    state: TrackState,
    found: Registration,
    seen: Sequence[ObjectView],
    model: EvidenceModel,
    settings: RegistrationSettings,
) -> Registration:
    """Look now and then whether a frame shows another submap, if the present one is not the first."""
    if not state.submaps.check_is_due():
        return found
    here = state.submaps.containing(found.T_camera_object)
    elsewhere = _best_by_keyframes(state, seen, model, settings, outside=here)
    if elsewhere is None:
        return found
    state.submaps.link(found.T_camera_object, elsewhere.T_camera_object)
    return replace(elsewhere, status=PoseStatus.RELOCALIZED)


def _best_by_keyframes(
    state: TrackState,
    seen: Sequence[ObjectView],
    model: EvidenceModel,
    settings: RegistrationSettings,
    outside: int | None = None,
) -> Registration | None:
    """Return the best registration of a moment's frames from poses that keyframes speak for, if it can be trusted.

    With a submap to be `outside` of, only poses in others count.
    """
    if state.keyframes is None:
        return None
    trusted = []
    for each in seen:
        poses = [hypothesis.T_camera_object for hypothesis in state.keyframes.query(each.frame, each.mask)]
        for pose in poses:
            if outside is not None and state.submaps.containing(pose) == outside:
                continue
            T_camera_object = each.rig.at_sensor(pose)
            view = raycast_model(model, each.resolution, T_camera_object, settings.threads)
            found = register(settings.problem(each, view), T_camera_object)
            if found.status is PoseStatus.TRACKED:
                trusted.append(replace(found, T_camera_object=each.rig.at_rig(found.T_camera_object)))
    return max(trusted, key=lambda found: found.agreement, default=None)


def coast(state: TrackState, frame: Frame) -> TrackedPose:
    """Let a lost object go on for a moment, then stay where it was; one that is not looked for waits at once."""
    if state.keyframes is None:
        return TrackedPose(T_camera_object=state.pose, status=PoseStatus.LOST)
    state.lost_frames += 1
    if state.moves and state.lost_frames <= COAST_FRAMES:
        state.go_to(state.predicted(frame.timestamp_ns), frame)
    else:
        state.jump_to(state.pose, frame)
    state.interrupt()
    return TrackedPose(T_camera_object=state.pose, status=PoseStatus.LOST, submap=state.submaps.current)


def begin_submap(state: TrackState, seen: Sequence[ObjectView], model: EvidenceModel) -> TrackedPose:
    """Begin a new submap with a moment, where the object is thought to be but far from the others."""
    pose = state.pose @ state.submaps.begin(model.voxel_size_m)
    state.stationary, state.usual_agreement, state.lost_frames = False, 0.0, 0
    state.jump_to(pose, seen[0].frame)
    for each in seen:
        state.remember_view(each)
        state.add_keyframe(each)
    return TrackedPose(T_camera_object=pose, status=PoseStatus.WEAK, submap=state.submaps.current)
