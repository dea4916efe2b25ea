# SPDX-License-Identifier: MIT
"""The labels of all frames of a sequence that was divided by motion."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from threedvc.config import EncoderConfig
from threedvc.encoder.segmentation.motion_segmenter import PASSING, TRANSIENT, Divider
from threedvc.encoder.segmentation.moving_body import Body
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import Pose, inverse

__all__ = ["MOST_LOST", "NOTHING", "PASSING_NUMBERS", "Division", "Passing"]

NOTHING = 255
"""Label of pixels that belong neither to the background nor to an object, such as of hands."""
MAX_OBJECTS = 200
MOST_LOST = 0.05
"""Part of the frames in which the camera, or an object, may be lost; else what seems to move may not be rigid."""
PASSING_NUMBERS = range(240, 255)
"""Numbers of objects that stand for things which are there for a moment, one after the other."""
LEAST_LIFE, MOST_LIFE = 3, 30
"""Frames that such a thing must be followed in a row, and after which it begins anew: it may have changed its shape."""
LEAST_AREA = 0.002
"""Part of the picture that it must cover on an average."""
LEAST_PASSING_BPS = 24_000
"""Below this rate what passes is left out: its cells would take more than a tenth from all others."""
Whole = TypeVar("Whole", np.uint8, np.uint16)


class Passing(NamedTuple):
    """A passing thing in a frame: which one of those with its number it is, and its T_camera_object."""

    life: int
    T_camera_object: Pose


class _Life(NamedTuple):
    number: int
    life: int


class Division:
    """Labels of frames by their time, and which objects are there.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.

    Attributes
    ----------
    camera_rests
        Whether the camera stands still in a sequence that was taken as a whole.

    Frames that are not known yet are divided when they are asked for, in order, as a live encoder needs it.
    """

    def __init__(self, info: SequenceInfo, config: EncoderConfig) -> None:
        self._divider = Divider(info, config)
        self._threads = config.threads
        self._labels: dict[int, bytes] = {}
        self._numbers: dict[int, int] = {}
        self._gone: dict[int, set[int]] = {}
        self._seen: dict[int, set[int]] = {}
        self.camera_rests = False
        self._lives: dict[tuple[int, int], _Life] = {}
        self._passing: dict[int, dict[int, Passing]] = {}
        self._holds_passing = config.bitrate_bps is None or config.bitrate_bps >= LEAST_PASSING_BPS

    @property
    def is_sure(self) -> bool:
        """Whether it found objects in a sequence that was taken as a whole, and never lost the camera for long."""
        lost = sum(pose is None for pose in self._divider.poses)
        return bool(self._numbers) and lost <= MOST_LOST * len(self._divider.poses)

    def labels(self, frame: Frame) -> NDArray[np.uint8]:
        """Return the labels (h, w) of a frame's depth picture: 0 the background, objects, or `NOTHING`."""
        if frame.timestamp_ns not in self._labels:
            self._divider.look(frame)
            raw = self._divider.divide(frame)
            for body in self._divider.bodies:
                self._number(body)
                self._hold(body, frame.index)
            gone = {body.number for body in self._divider.bodies if body.gone}
            self._keep(frame.timestamp_ns, frame.index, raw, gone)
            self._divider.forget(frame.index)
        small = self._unpacked(self._labels[frame.timestamp_ns], np.uint8)
        return self._divider.reduction.spread(small, frame.depth, self._threads)

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
        """Give a body a number once it is an object of its own."""
        known = body.number in self._numbers or body.same_as is not None
        if not known and len(self._numbers) < MAX_OBJECTS and self._divider.is_object(body):
            self._numbers[body.number] = len(self._numbers) + 1

    def passing(self, number: int, frame: Frame) -> Passing | None:
        """Return which passing thing has a number in a frame and where it is, or None."""
        return self._passing[frame.timestamp_ns].get(number)

    @staticmethod
    def _stage(body: Body, frame: int) -> tuple[int, int]:
        return body.number, (frame - body.born) // MOST_LIFE

    def _hold(self, body: Body, frame: int, *, ahead: bool = False) -> None:
        """Give a body that passes, and is seen well in a frame, a number that is free for as long as it lives.

        With what comes `ahead` it has it from its first frame on, else once it was followed for some frames.
        """
        stage = self._stage(body, frame)
        kept = (body.same_as or body).number in self._numbers
        if not self._holds_passing or kept or stage in self._lives or body.pose_of(frame) is None:
            return
        run = range(frame, frame + LEAST_LIFE) if ahead else range(frame, frame - LEAST_LIFE, -1)
        if any(body.passing.get(k, 0.0) <= TRANSIENT or body.pose_of(k) is None for k in run):
            return
        camera = self._divider.rig.depth
        if np.mean([body.pixels[k] for k in run]) < LEAST_AREA * camera.width * camera.height:
            return
        used = [life.number for (other, age), life in self._lives.items() if self._lives_on(other, age, frame)]
        free = [number for number in PASSING_NUMBERS if number not in used]
        if free:
            before = sum(life.number == free[0] for life in self._lives.values())
            self._lives[stage] = _Life(free[0], before)

    def _lives_on(self, number: int, age: int, frame: int) -> bool:
        """Tell whether a body, at an age, has its number still in a frame."""
        body = self._divider.bodies[number - 1]
        until = min(body.born + (age + 1) * MOST_LIFE - 1, body.last)
        return until >= frame - 1

    def _keep(self, time_ns: int, index: int, raw: NDArray[np.uint16], gone: set[int]) -> None:
        """Keep the labels of a frame, given the bodies' numbers (h, w), and which objects are in it."""
        table = np.zeros(PASSING + 1, dtype=np.uint8)
        table[PASSING] = NOTHING
        passing = self._passing.setdefault(time_ns, {})
        for body in self._divider.bodies:
            passes = body.passing.get(index, 0) > TRANSIENT
            table[body.number] = self._numbers.get((body.same_as or body).number, NOTHING if passes else 0)
            life, pose = self._lives.get(self._stage(body, index)), body.pose_of(index)
            if life is not None and pose is not None and body.number not in self._numbers:
                table[body.number] = life.number
                passing[life.number] = Passing(life.life, pose)
        self._labels[time_ns] = zlib.compress(table[raw].tobytes(), 1)
        found = {body.number for body in self._divider.bodies if body.pose_of(index) is not None}
        self._seen[time_ns], self._gone[time_ns] = self._public(found), self._public(gone)

    def _public(self, bodies: set[int]) -> set[int]:
        return {self._numbers[body] for body in bodies if body in self._numbers}

    def take(self, frames: FrameSequence) -> None:
        """Divide a sequence as a whole: every frame with what all others saw."""
        divider = self._divider
        for frame in frames:
            divider.look(frame)
        first = divider.poses[0]
        self.camera_rests = first is not None and all(
            pose is not None and np.array_equal(pose, first) for pose in divider.poses
        )
        raw: list[tuple[int, bytes, set[int]]] = []
        for frame in frames:
            packed = zlib.compress(divider.divide(frame).tobytes(), 1)
            raw.append((frame.timestamp_ns, packed, {body.number for body in divider.bodies if body.gone}))
        for body in divider.bodies:
            self._number(body)
        for index in range(len(raw)):
            for body in divider.bodies:
                self._hold(body, index, ahead=True)
        for index, (time_ns, packed, gone) in enumerate(raw):
            self._keep(time_ns, index, self._unpacked(packed, np.uint16), gone)
        for body in divider.bodies:
            if body.number in self._numbers:
                self._extend_back(body, frames, [packed for _, packed, _ in raw])

    def _extend_back(self, body: Body, frames: FrameSequence, raw: Sequence[bytes]) -> None:
        """Label an object by its finished model before it was known as one, back to where it stood still at first.

        Pixels that were given to no object, as the `raw` numbers of the bodies (h, w) have it, may turn out to be its.
        """
        number = self._numbers[body.number]
        for index in range(body.proved or 0, -1, -1):
            if index > body.born and body.pose_of(index) is None:
                continue
            frame = frames[index]
            labels = self._unpacked(self._labels[frame.timestamp_ns], np.uint8)
            mask = self._divider.shown(body, frame)
            if mask is None and index < body.born:
                others = self._unpacked(raw[index], np.uint16)
                mask = self._divider.caught(
                    body, frame, (others > 0) & ((labels == 0) | (labels >= PASSING_NUMBERS.start))
                )
                if mask is None:
                    return
            if mask is None or not mask.any():
                continue
            free = (labels == 0) | (labels >= PASSING_NUMBERS.start)
            self._labels[frame.timestamp_ns] = zlib.compress(np.where(mask & free, np.uint8(number), labels).tobytes())
            self._seen[frame.timestamp_ns].add(number)

    def _unpacked(self, packed: bytes, kind: type[Whole]) -> NDArray[Whole]:
        camera = self._divider.rig.depth
        return np.frombuffer(zlib.decompress(packed), kind).reshape(camera.height, camera.width)
