# SPDX-License-Identifier: MIT
"""Frames in a row, by their first and their last one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

__all__ = ["FrameSpan", "ranges_of"]


class FrameSpan(NamedTuple):
    """Consecutive frames; as text ``7`` or ``7-9``."""

    first: int
    last: int

    def __str__(self) -> str:
        return f"{self.first}-{self.last}" if self.last > self.first else str(self.first)


def ranges_of(frames: Iterable[int]) -> tuple[FrameSpan, ...]:
    """Divide rising frame numbers where one is missing."""
    spans: list[FrameSpan] = []
    for frame in frames:
        if spans and spans[-1].last == frame - 1:
            spans[-1] = FrameSpan(spans[-1].first, frame)
        else:
            spans.append(FrameSpan(frame, frame))
    return tuple(spans)
