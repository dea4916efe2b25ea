# SPDX-License-Identifier: MIT
"""Settle which camera poses of a recording are used: those that agree with its depth, and how the rest is found."""

from __future__ import annotations

from dataclasses import dataclass, replace

from threedvc.config import EncoderConfig, Motion
from threedvc.encoder.tracking.pose_agreement import measure_agreement
from threedvc.encoder.tracking.pose_completion import SequenceWithPoses, complete_poses
from threedvc.errors import SequenceError
from threedvc.formats.sources.notices import Notice
from threedvc.frames.sequence import FactualSequence, FrameSequence

__all__ = ["SettledPoses", "settle_poses"]

MIN_POSED = 0.5
"""Where fewer frames have a pose, tracking against the model drifts less than registration from frame to frame."""
TRACK = "use --motion track"


@dataclass(frozen=True, eq=False)
class SettledPoses:
    """A recording with the camera poses that are to be used.

    Attributes
    ----------
    frames, config
        The sequence and the choices to encode it with.
    notices
        What was decided.
    """

    frames: FrameSequence
    config: EncoderConfig
    notices: tuple[Notice, ...] = ()


def settle_poses(frames: FrameSequence, config: EncoderConfig) -> SettledPoses:
    """Check the camera poses that a recording gives against its depth, and complete them.

    Poses that contradict the depth are set aside, and the camera is tracked; they are never repaired. Of a recording
    where some frames lack a pose, the others' are used.

    Parameters
    ----------
    frames
        A sequence; one whose facts are not known beforehand is taken to have poses everywhere or nowhere.
    config
        Choices; nothing is done for ``Motion.TRACK``.

    Raises
    ------
    SequenceError
        If the poses are asked for (``Motion.KNOWN``) and cannot be right, or most frames have none.
    """
    poses = [each.T_world_camera for each in frames.facts()] if isinstance(frames, FactualSequence) else None
    posed = frames.info.has_camera_poses if poses is None else any(pose is not None for pose in poses)
    if config.motion is Motion.TRACK or not posed:
        return SettledPoses(frames, config)
    agreement = measure_agreement(frames, config.threads)
    if agreement is not None and agreement.contradicts:
        return _without_poses(frames, config, f"{_source(frames)}: {agreement.explanation}", warning=True)
    if poses is None or all(pose is not None for pose in poses):
        return SettledPoses(frames, config)
    known = sum(pose is not None for pose in poses)
    told = f"{_source(frames)}: {known} of {len(poses)} frames have a pose"
    if known < MIN_POSED * len(poses):
        return _without_poses(frames, config, told)
    completed = complete_poses(frames, poses, config.threads)
    if completed.missing:
        return _without_poses(frames, config, f"{told} and {completed.missing} cannot be placed beside their neighbors")
    ways = [
        f"{count} {'is' if count == 1 else 'are'} {way}"
        for count, way in ((completed.interpolated, "interpolated"), (completed.registered, "found by registration"))
        if count
    ]
    notice = Notice(f"{told}; {' and '.join(ways)} ({TRACK} to find all)")
    return SettledPoses(SequenceWithPoses(frames, completed.poses), config, (notice,))


def _without_poses(frames: FrameSequence, config: EncoderConfig, why: str, *, warning: bool = False) -> SettledPoses:
    """Set the poses aside, unless they are asked for."""
    if config.motion is Motion.KNOWN:
        raise SequenceError(f"{why}; correct them, or {TRACK}")
    notice = Notice(f"{why}; the camera is tracked instead", warning=warning)
    return SettledPoses(SequenceWithPoses(frames, None), replace(config, motion=Motion.TRACK), (notice,))


def _source(frames: FrameSequence) -> str:
    """Return the name of the poses' file where it is known, else that of the recording."""
    source = getattr(frames, "poses_from", None)
    return frames.info.name if source is None else str(source)
