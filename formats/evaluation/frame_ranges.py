# SPDX-License-Identifier: MIT
"""Frames in a row, by their first and their last one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

__all__ = ["Span", "spans_of"]


class Span(NamedTuple):
    """Consecutive frames; as text ``7`` or ``7-9``."""

    first: int
    last: int

    def __str__(self) -> str:
        return f"{self.first}-{self.last}" if self.last > self.first else str(self.first)


def spans_of(frames: Iterable[int]) -> tuple[Span, ...]:
    """Divide rising frame numbers where one is missing."""
    spans: list[Span] = []
    for frame in frames:
        if spans and spans[-1].last == frame - 1:
            spans[-1] = Span(spans[-1].first, frame)
        else:
            spans.append(Span(frame, frame))
    return tuple(spans)
