# SPDX-License-Identifier: MIT
"""Sequences of frames: what every one has, and what can be known of one beforehand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.pose import Pose

__all__ = [
    "DownsampledSequence",
    "FactualSequence",
    "FrameFacts",
    "FrameSequence",
    "facts_of",
    "frame_sets",
    "sampling_stride",
]

MIN_UNEVEN_STEP = 7
"""A prime, longer than usual cycles of sensors."""


class FrameSequence(Protocol):
    """A source of frames; it can be read more than once."""

    @property
    def info(self) -> SequenceInfo:
        """What holds for every frame."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...

    def __iter__(self) -> Iterator[Frame]: ...


def frame_sets(frames: Iterable[Frame], info: SequenceInfo) -> Iterator[list[Frame]]:
    """Yield the frames of each moment: one, or those that several sensors took together."""
    if not info.sensors:
        yield from ([frame] for frame in frames)
        return
    frame_set: list[Frame] = []
    for frame in frames:
        if frame_set and not frame.synchronized:
            yield frame_set
            frame_set = []
        frame_set.append(frame)
    if frame_set:
        yield frame_set


def sampling_stride(count: int, most: int, info: SequenceInfo) -> int:
    """Return n such that every n-th of `count` frames is at most `most` of them, and all sensors are among them.

    Sensors take turns in some short cycle; a prime that is longer than usual cycles meets all of them.
    """
    step = max(1, -(-count // most))
    if step == 1 or not info.sensors:
        return step
    step = max(step, MIN_UNEVEN_STEP)
    while any(step % divisor == 0 for divisor in range(2, int(step**0.5) + 1)):
        step += 1
    return step


class FrameFacts(Protocol):
    """What is known of a frame without a look at its pictures; see `Frame`."""

    @property
    def timestamp_ns(self) -> int:
        """Time of the depth picture."""
        ...

    @property
    def T_world_camera(self) -> Pose | None:
        """Known pose of the depth camera, or None."""
        ...

    @property
    def T_camera_object(self) -> Mapping[int, Pose]:
        """Known poses of labeled objects."""
        ...


@runtime_checkable
class FactualSequence(Protocol):
    """A source of frames that knows facts about all of them beforehand."""

    def facts(self) -> Sequence[FrameFacts]:
        """Return what is known of each frame."""
        ...


def facts_of(frames: FrameSequence) -> Sequence[FrameFacts]:
    """Return what is known of each frame; a source that does not know it beforehand is read once."""
    if isinstance(frames, FactualSequence):
        return frames.facts()
    unseen = np.zeros((0, 0), np.uint8)
    return [replace(frame, color=unseen, depth=unseen.astype(np.float32), mask=None) for frame in frames]


class DownsampledSequence:
    """Every n-th frame of a sequence, numbered through.

    Parameters
    ----------
    frames
        The sequence.
    step
        n.
    """

    def __init__(self, frames: FrameSequence, step: int) -> None:
        self._frames, self._step = frames, step

    @property
    def info(self) -> SequenceInfo:
        """What holds for every frame."""
        return self._frames.info

    def __len__(self) -> int:
        return -(-len(self._frames) // self._step)

    def __getitem__(self, index: int) -> Frame:
        frame = self._frames[index * self._step]
        return replace(frame, index=index, synchronized=frame.synchronized and self._step == 1)

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))
