# SPDX-License-Identifier: MIT
"""Samples of all frames, if wanted after moving objects or color pictures to where they fit the colors so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum, auto

from threedvc.encoder.appearance.color_solver import solve_gain
from threedvc.encoder.appearance.fit_state import FitState
from threedvc.encoder.appearance.photometric_alignment import aligned_pose, aligned_shift
from threedvc.encoder.appearance.samples import FrameSamples
from threedvc.frames.frame import Frame
from threedvc.frames.sequence import frame_sets
from threedvc.geometry.pose import interpolated

__all__ = ["Alignment", "take_samples"]


class Alignment(Enum):
    """What is moved in a frame before it is sampled."""

    NONE = auto()
    POSES = auto()
    """Objects whose poses are not given, to where they fit color and depth."""
    SHIFTS = auto()
    """The color picture, to where it fits the background; poses stay."""


def take_samples(state: FitState, alignment: Alignment) -> None:
    """Sample all frames anew after aligning them with the colors so far, and find their gains."""
    state.samples.clear()
    for moment in frame_sets(state.drawn_frames(), state.scene.info):
        fresh = []
        for frame in moment:
            if state.is_repeated(frame.index):
                _repeat(state, frame.index)
            elif not state.draws_lost_object(frame.index):
                fresh.append(frame)
        for sample in _aligned_samples(state, fresh, alignment):
            state.gains[sample.frame] = solve_gain(sample, sample.shown(state.colors), state.gray)
            state.keep(sample)


def _repeat(state: FitState, frame: int) -> None:
    """Let a frame that repeats the sensor's one before be as that one, but for poses that are given."""
    scene, last = state.scene, state.scene.frame_before(frame)
    if last is None:
        return
    state.gains[frame], state.shifts[frame] = state.gains[last], state.shifts[last]
    for number, item in scene.objects.items():
        at, before = state.tracks[number][frame], state.tracks[number][last]
        if at is not None and before is not None and not item.is_given(at):
            state.tracks[number][frame] = replace(at, T_camera_object=before.T_camera_object)


def _aligned_samples(state: FitState, moment: Sequence[Frame], alignment: Alignment) -> list[FrameSamples]:
    """Sample the frames of a moment, and once more if anything has moved."""
    samples = list(map(state.sample, moment))
    if alignment is Alignment.NONE:
        return samples
    moved = [_align(state, frame, sample, alignment) for frame, sample in zip(moment, samples, strict=True)]
    if not any(moved):
        return samples
    if len(moment) > 1:
        _unite(state, [frame.index for frame in moment])
    return list(map(state.sample, moment))


def _align(state: FitState, frame: Frame, sample: FrameSamples, alignment: Alignment) -> bool:
    """Align the objects that may move in a frame, or its shift alone; tell whether there are any."""
    scene, index, rig = state.scene, frame.index, state.scene.info.rigs[frame.sensor]
    luma, moved = sample.luma(state.colors), False
    for number, item in scene.objects.items():
        at = state.tracks[number][index]
        if at is None or not at.usable or item.is_given(at):
            continue
        moved, here = True, sample.labels == number
        view = frame, rig, rig.at_sensor(at.T_camera_object), sample.points[here], luma[here]
        if alignment is Alignment.POSES:
            pose = rig.at_rig(aligned_pose(*view, sensor=scene.sensor_of(frame.sensor)))
            state.tracks[number][index] = replace(at, T_camera_object=pose)
        elif number == 0:
            state.shifts[index] = aligned_shift(*view, state.shifts[index])
    return moved


def _unite(state: FitState, frames: Sequence[int]) -> None:
    """Give the frames of a moment the same poses, those in the middle of their own."""
    for track in state.tracks.values():
        at = track[frames[0]]
        if at is None:
            continue
        pose = at.T_camera_object
        for count, frame in enumerate(frames[1:], 2):
            other = track[frame]
            pose = pose if other is None else interpolated(pose, other.T_camera_object, 1 / count)
        for frame in frames:
            track[frame] = replace(at, T_camera_object=pose)
