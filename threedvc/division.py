# SPDX-License-Identifier: MIT
"""The labels of all frames of a sequence that was divided by motion."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from threedvc.config import EncoderConfig
from threedvc.frame import Frame, FrameSequence, SequenceInfo
from threedvc.pose import Pose, inverse
from threedvc.motion_segmentation import PASSING, Body, Divider

__all__ = ["NOTHING", "Division", "divided"]

NOTHING = 255
"""Label of pixels that belong neither to the background nor to an object, such as of hands."""
MAX_OBJECTS = 200


class Division:
    """Labels of frames by their time, and which objects are there.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.

    Frames that are not known yet are divided when they are asked for, in order, as a live encoder needs it.
    """

    def __init__(self, info: SequenceInfo, config: EncoderConfig) -> None:
        self._divider = Divider(info, config)
        self._threads = config.threads
        self._labels: dict[int, bytes] = {}
        self._numbers: dict[int, int] = {}
        self._gone: dict[int, set[int]] = {}
        self._seen: dict[int, set[int]] = {}

    def labels(self, frame: Frame) -> NDArray[np.uint8]:
        """Return the labels (h, w) of a frame's depth picture: 0 the background, objects, or `NOTHING`."""
        if frame.timestamp_ns not in self._labels:
            self._divider.look(frame)
            raw = self._divider.divide(frame)
            for body in self._divider.bodies:
                if body.number not in self._numbers and self._divider.is_object(body):
                    self._number(body)
            self._keep(frame, raw)
            self._divider.forget(frame.index)
        reduction = self._divider.reduction
        camera = reduction.rig.depth
        packed = zlib.decompress(self._labels[frame.timestamp_ns])
        small = np.frombuffer(packed, np.uint8).reshape(camera.height, camera.width)
        return reduction.spread(small, frame.depth, self._threads)

    def is_seen(self, number: int, frame: Frame) -> bool:
        """Tell whether an object was found in a frame."""
        return number in self._seen[frame.timestamp_ns]

    def is_gone(self, number: int, frame: Frame) -> bool:
        """Tell whether an object is no longer where it was last."""
        return number in self._gone[frame.timestamp_ns]

    def way(self, number: int, start: int, stop: int) -> Pose | None:
        """Return how an object moved before the camera from one frame to another, or None."""
        body = next(body for body in self._divider.bodies if self._numbers.get(body.number) == number)
        before, after = body.pose_of(start), body.pose_of(stop)
        return None if before is None or after is None else after @ inverse(before)

    def _number(self, body: Body) -> None:
        if len(self._numbers) < MAX_OBJECTS:
            self._numbers[body.number] = len(self._numbers) + 1

    def _keep(self, frame: Frame, raw: NDArray[np.uint16]) -> None:
        table = np.full(PASSING + 1, 0, dtype=np.uint8)
        table[1 : len(self._divider.bodies) + 1] = NOTHING
        table[PASSING] = NOTHING
        for body, number in self._numbers.items():
            table[body] = number
        key = frame.timestamp_ns
        self._labels[key] = zlib.compress(table[raw].tobytes(), 1)
        known = [body for body in self._divider.bodies if body.number in self._numbers]
        self._seen[key] = {self._numbers[body.number] for body in known if body.pose_of(frame.index) is not None}
        self._gone[key] = {self._numbers[body.number] for body in known if body.gone}

    def take(self, frames: FrameSequence) -> None:
        """Divide a sequence as a whole: every frame with what all others saw."""
        divider, raw, gone = self._divider, {}, {}
        for frame in frames:
            divider.look(frame)
        for frame in frames:
            raw[frame.index] = zlib.compress(divider.divide(frame).tobytes(), 1)
            gone[frame.index] = {body.number for body in divider.bodies if body.gone}
        objects = [body for body in divider.bodies if divider.is_object(body)]
        for body in objects:
            self._number(body)
        camera = divider.reduction.rig.depth
        resting = set(objects)
        for frame in reversed(list(range(len(frames)))):
            labels = np.frombuffer(zlib.decompress(raw[frame]), np.uint16).reshape(camera.height, camera.width).copy()
            picture = frames[frame]
            there = set()
            for body in [body for body in resting if body.born > frame]:
                mask = divider.resting(body, picture)
                if mask is None:
                    resting.remove(body)
                    continue
                labels[mask] = body.number
                there.add(self._numbers[body.number])
            self._keep(picture, labels)
            self._seen[picture.timestamp_ns] |= there
            self._gone[picture.timestamp_ns] = {self._numbers[k] for k in gone[frame] if k in self._numbers}


def divided(frames: FrameSequence, config: EncoderConfig) -> Division:
    """Divide a sequence that can be read again."""
    division = Division(frames.info, config)
    division.take(frames)
    return division
