# SPDX-License-Identifier: MIT
"""Numbers of transient things, such as hands: bodies that are no objects, each shown for a moment."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threedvc.encoder.segmentation.motion.motion_segmenter import MIN_CERTAIN_TRANSIENCE
from threedvc.encoder.segmentation.motion.moving_body import MotionHypothesis
from threedvc.geometry.camera import Camera

__all__ = ["MAX_SEGMENT_FRAMES", "TRANSIENT_NUMBERS", "TransientNumbers", "TransientSegment"]

TRANSIENT_NUMBERS = range(240, 255)
"""Numbers of objects that stand for transient things, one after the other: those below the void label, and more than
ever are in sight at once."""
MIN_SEGMENT_FRAMES, MAX_SEGMENT_FRAMES = 3, 30
"""Frames that such a thing must be followed in a row, and after which it begins anew: it may have changed its shape."""
MIN_PICTURE_SHARE = 0.002
"""Part of the picture that it must cover on an average: smaller ones are hardly seen, and cost as many packets."""


class TransientSegment(NamedTuple):
    """A run of frames in which a transient thing has a number, and which one of those with this number it is."""

    number: int
    order: int


class TransientNumbers:
    """Gives numbers to transient bodies, and takes them back when these are over.

    Parameters
    ----------
    camera
        The camera that bodies are seen by, downsampled.
    """

    def __init__(self, camera: Camera) -> None:
        self._min_pixels = MIN_PICTURE_SHARE * camera.width * camera.height
        self._segments: dict[tuple[MotionHypothesis, int], TransientSegment] = {}

    def segment_of(self, body: MotionHypothesis, frame: int) -> TransientSegment | None:
        """Return the segment of a body that a frame is in, if it has a number then."""
        return self._segments.get((body, _period(body, frame)))

    def assign(self, body: MotionHypothesis, frame: int, *, ahead: bool = False) -> None:
        """Give a body that is transient, and seen well in a frame, a number that is free for as long as it lasts.

        With what comes `ahead` it has it from its first frame on, else once it was followed for some frames.
        """
        key = body, _period(body, frame)
        if key in self._segments or body.pose_of(frame) is None:
            return
        run = range(frame, frame + MIN_SEGMENT_FRAMES) if ahead else range(frame, frame - MIN_SEGMENT_FRAMES, -1)
        if any(body.transience.get(k, 0.0) <= MIN_CERTAIN_TRANSIENCE or body.pose_of(k) is None for k in run):
            return
        if np.mean([body.pixels[k] for k in run]) < self._min_pixels:
            return
        used = {segment.number for held, segment in self._segments.items() if _last_frame(*held) >= frame - 1}
        free = next((number for number in TRANSIENT_NUMBERS if number not in used), None)
        if free is not None:
            order = sum(segment.number == free for segment in self._segments.values())
            self._segments[key] = TransientSegment(free, order)


def _period(body: MotionHypothesis, frame: int) -> int:
    """Return which one of the longest segments, one after the other from its birth, a frame is in."""
    return (frame - body.born) // MAX_SEGMENT_FRAMES


def _last_frame(body: MotionHypothesis, period: int) -> int:
    """Return the last frame in which a body is there in a period."""
    return min(body.born + (period + 1) * MAX_SEGMENT_FRAMES - 1, body.last)
