# SPDX-License-Identifier: MIT
"""How far decoded depth may lie from the filmed, and the tables of values that keep within it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import ConfigError

__all__ = ["MAX_RAW", "BoundKind", "DepthBound", "ValueTable", "distinct_depths"]

MAX_RAW = 65535
"""Largest raw depth; 0 is no measurement."""
FINE_PARTS = 3
"""Values of a fine table that lie within the bound of a depth: what a prediction misses by one costs nothing. Six
gave 1 to 40 % more bytes, and two have no middle."""
FINE_MEMORY, COARSE_MEMORY, EXACT_MEMORY = 24, 8, 12
"""How much of a prediction, in 64ths of a step, outlasts a value. Measured on three sensors: most where values follow
predictions, little where they are rounded to what was filmed."""


class BoundKind(Enum):
    """What a bound is measured in."""

    ABSOLUTE = "absolute"
    RELATIVE = "relative"
    LEVEL = "level"
    LOSSLESS = "lossless"


@dataclass(frozen=True, kw_only=True)
class DepthBound:
    """How far decoded depth may lie from the filmed.

    Attributes
    ----------
    kind
        See `BoundKind`.
    size
        Raw units of an absolute bound, a part of the depth of a relative one; the others have none.

    Raises
    ------
    ConfigError
        If the size is negative or not finite, or a relative one is 1 or more.
    """

    kind: BoundKind
    size: float = 0.0

    def __post_init__(self) -> None:
        largest = 1.0 if self.kind is BoundKind.RELATIVE else np.inf
        if not 0 <= self.size < largest:
            raise ConfigError(
                f"a {self.kind.value} depth bound of {self.size} is impossible; give one within 0..1 or more"
            )

    def limits(self, levels: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return least and greatest value that may stand for each of the sorted distinct depths of a sensor."""
        if self.kind is BoundKind.LEVEL:
            return np.append(levels[:1], levels[:-1]), np.append(levels[1:], levels[-1:])
        if self.kind is BoundKind.RELATIVE:
            # Rounded in decimals first: 0.07 * 100 is 7, not a little more.
            room = np.floor(np.round(levels * self.size, 9)).astype(np.int64)
        else:
            size = 0.0 if self.kind is BoundKind.LOSSLESS else min(self.size, float(MAX_RAW))
            room = np.full(len(levels), int(np.floor(round(size, 9))), dtype=np.int64)
        return np.maximum(levels - room, 1), np.minimum(levels + room, MAX_RAW)


@dataclass(frozen=True, kw_only=True, eq=False)
class ValueTable:
    """Values that are coded, and how a writer uses them.

    Attributes
    ----------
    values
        (n,) int64, rising.
    memory, stride
        See `kernels.coding.bounded_depth.DepthTable`.
    """

    values: NDArray[np.int64]
    memory: int
    stride: int


def distinct_depths(frames: Iterator[NDArray[np.uint16]]) -> NDArray[np.int64]:
    """Return the sorted distinct depths of frames, without 0."""
    seen = np.zeros(MAX_RAW + 1, dtype=bool)
    for frame in frames:
        seen[frame] = True
    seen[0] = False
    return np.flatnonzero(seen)


def fine_values(depths: NDArray[np.int64], low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return values about a third of what is allowed apart, each depth among them or between two that are allowed."""
    values = [int(depths[0])]
    at = 0
    while at < len(depths) - 1:
        value, room = int(depths[at]), int(high[at] - low[at])
        step = max(1, (room + 1) // FINE_PARTS)
        onward = int(np.searchsorted(depths, value + step, side="right")) - 1
        if onward == at:
            onward = at + 1
            gap = int(depths[onward]) - value
            parts = max(1, round(gap / step)) if gap <= room else 1
            values += [value + gap * part // parts for part in range(1, parts)]
        at = onward
        values.append(int(depths[at]))
    return np.array(values, dtype=np.int64)


def coarse_values(low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the fewest values of which one is allowed for every depth."""
    values: list[int] = []
    at = 0
    while at < len(low):
        # Both ends rise with the depth, so what the first and the last allow, all between them do.
        last = int(np.searchsorted(low, high[at], side="right")) - 1
        values.append(int(low[last] + high[at]) // 2)
        at = last + 1
    return np.array(values, dtype=np.int64)


def candidate_tables(
    bound: DepthBound, levels: NDArray[np.int64], depths: NDArray[np.int64]
) -> list[tuple[ValueTable, NDArray[np.int64], NDArray[np.int64]]]:
    """Return tables worth trying, each with least and greatest value allowed for each of `depths`."""
    low, high = (ends[np.searchsorted(levels, depths)] for ends in bound.limits(levels))
    if (low == high).all():
        return [(ValueTable(values=depths, memory=EXACT_MEMORY, stride=1), low, high)]
    if bound.kind is BoundKind.LEVEL:
        fine = np.unique(np.concatenate([low, depths, high]))
    else:
        fine = fine_values(depths, low, high)
    return [
        (ValueTable(values=coarse_values(low, high), memory=COARSE_MEMORY, stride=1), low, high),
        (ValueTable(values=fine, memory=FINE_MEMORY, stride=FINE_PARTS), low, high),
        (ValueTable(values=fine, memory=FINE_MEMORY, stride=1), low, high),
    ]
