# SPDX-License-Identifier: MIT
"""Camera poses for the frames of a recording that lack one: between their neighbors', or by registration with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from threedvc.encoder.tracking.pair_registration import PairRegistration
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sequence import FrameFacts, FrameSequence, facts_of
from threedvc.geometry.pose import Pose, compose, identity, interpolated, inverse
from threedvc.units import NANOSECONDS

__all__ = ["CompletedPoses", "SequenceWithPoses", "complete_poses"]

MAX_INTERPOLATED = 3
"""Frames of a gap that is interpolated: at 15 frames a second, as many as a fifth of one has."""
MAX_INTERPOLATED_NS = NANOSECONDS // 5
"""A camera in a hand hardly turns within a fifth of a second: its pose lies on the way between two that are known."""


@dataclass(frozen=True, eq=False)
class CompletedPoses:
    """T_world_camera of every frame.

    Attributes
    ----------
    poses
        One for each frame; None where it could not be found.
    interpolated, registered
        Number of those that were interpolated, and that were found by registration.
    """

    poses: Sequence[Pose | None]
    interpolated: int
    registered: int

    @property
    def missing(self) -> int:
        """Number of frames that still have none."""
        return sum(pose is None for pose in self.poses)


class SequenceWithPoses:
    """A sequence with other camera poses.

    Parameters
    ----------
    frames
        The sequence.
    poses
        T_world_camera of every frame; None: no frame has one.
    """

    def __init__(self, frames: FrameSequence, poses: Sequence[Pose | None] | None) -> None:
        self._frames = frames
        self._poses = [None] * len(frames) if poses is None else list(poses)
        self._info = replace(frames.info, has_camera_poses=poses is not None)

    @property
    def info(self) -> SequenceInfo:
        """What holds for every frame."""
        return self._info

    def facts(self) -> Sequence[FrameFacts]:
        """Return what is known of each frame without a look at its pictures."""
        return [
            _Facts(facts.timestamp_ns, pose, dict(facts.T_camera_object))
            for facts, pose in zip(facts_of(self._frames), self._poses, strict=True)
        ]

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        return replace(self._frames[index], T_world_camera=self._poses[index])

    def __iter__(self) -> Iterator[Frame]:
        for frame, pose in zip(self._frames, self._poses, strict=True):
            yield replace(frame, T_world_camera=pose)


@dataclass(frozen=True, eq=False)
class _Facts:
    """What is known of a frame."""

    timestamp_ns: int
    T_world_camera: Pose | None
    T_camera_object: dict[int, Pose]


def complete_poses(frames: FrameSequence, poses: Sequence[Pose | None], threads: int = 1) -> CompletedPoses:
    """Find the poses of frames that lack one.

    Short gaps are interpolated. Longer ones are crossed from frame to frame by registration, and what this is off by at
    the other end is spread over the gap; before the first known pose and after the last there is only one end.

    Parameters
    ----------
    frames
        A sequence of one sensor.
    poses
        T_world_camera of every frame, None where it is not known; at least one is.
    threads
        Number of threads.
    """
    known = [index for index, pose in enumerate(poses) if pose is not None]
    times = [facts.timestamp_ns for facts in facts_of(frames)]
    found = list(poses)
    between, crossed = 0, 0
    registrar = PairRegistration(frames.info.rig, threads)
    for first, last in zip([None, *known], [*known, None], strict=True):
        start, stop = 0 if first is None else first + 1, len(poses) if last is None else last
        if start == stop:
            continue
        before, after = None if first is None else poses[first], None if last is None else poses[last]
        span = times[max(start - 1, 0) : stop + 1]
        short = stop - start <= MAX_INTERPOLATED and span[-1] - span[0] <= MAX_INTERPOLATED_NS
        if before is not None and after is not None and short:
            found[start:stop] = _between(before, after, span)
            between += stop - start
        else:
            _cross(frames, found, first, last, registrar)
            crossed += sum(pose is not None for pose in found[start:stop])
    return CompletedPoses(found, between, crossed)


def _between(before: Pose, after: Pose, times: Sequence[int]) -> list[Pose]:
    """Return the poses between two known ones, by the times of all of them."""
    duration, count = times[-1] - times[0], len(times) - 1
    shares = [(times[k] - times[0]) / duration if duration else k / count for k in range(1, count)]
    return [interpolated(before, after, share) for share in shares]


def _cross(
    frames: FrameSequence, poses: list[Pose | None], first: int | None, last: int | None, registrar: PairRegistration
) -> None:
    """Fill the poses of a gap by registration from its ends, as far as that goes."""
    if first is not None:
        reached = _chain(frames, poses, range(first, len(poses) if last is None else last + 1), registrar)
        end = None if last is None else poses[last]
        if last is not None and end is not None and reached is not None:
            residual = compose(inverse(reached), end)
            for index in range(first + 1, last):
                here, share = poses[index], (index - first) / (last - first)
                poses[index] = None if here is None else compose(here, interpolated(identity(), residual, share))
    if last is not None and (first is None or any(pose is None for pose in poses[first:last])):
        _chain(frames, poses, range(last, -1 if first is None else first, -1), registrar)


def _chain(frames: FrameSequence, poses: list[Pose | None], path: range, registrar: PairRegistration) -> Pose | None:
    """Fill poses one after the other from the first of a path; return what the last comes to, None if it is lost."""
    pose = poses[path[0]]
    before = frames[path[0]]
    for index in path[1:]:
        frame = frames[index]
        motion = registrar.motion(before, frame)
        if motion is None or pose is None:
            return None
        pose = compose(pose, inverse(motion))
        if poses[index] is None:
            poses[index] = pose
        before = frame
    return pose
