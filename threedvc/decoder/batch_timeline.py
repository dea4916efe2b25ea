# SPDX-License-Identifier: MIT
"""Which frames the packets of a batch belong to."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

from threedvc.stream.headers import RunHeader

__all__ = ["FrameRun"]


class FrameRun:
    """Frames of one BATCH that runs count: those of one sensor, or the first ones of all moments.

    Parameters
    ----------
    before
        How many such frames there were before the BATCH.
    frames
        Those in it.
    """

    def __init__(self, before: int, frames: Sequence[int]) -> None:
        self._before, self._frames = before, frames

    def of(self, header: RunHeader) -> tuple[int, Sequence[int]] | None:
        """Return the number of the first frame of a header, and all its frames; None if they are not there."""
        place = bisect_left(self._frames, header.frame)
        frames = self._frames[place : place + header.count]
        if len(frames) < header.count or frames[0] != header.frame:
            return None
        return self._before + place, frames
