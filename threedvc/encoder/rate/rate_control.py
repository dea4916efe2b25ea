# SPDX-License-Identifier: MIT
"""Choice of cells and quantization steps for a quality or a bit rate.

A file's rate is met in two steps: the size of the cells follows from what the first pass would take at a middling
step, the quantization step of colors, and with it the quality of a backdrop, from the size of the finished stream
itself. A live encoder keeps a leaky bucket: what does not fit waits, poses first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf

import numpy as np

from threedvc.stream.framing_sizes import FILE_HEAD_BYTES, INDEX_ENTRY_BYTES, PACKET_FRAMING_BYTES
from threedvc.stream.packets import Packet
from threedvc.stream.wire import pack_map

__all__ = [
    "CLOSE",
    "DEPTH_SHARE",
    "MAX_STEP_RATIO",
    "MIDDLE_STEP",
    "MIN_STEP",
    "SHARE_PER_BYTE",
    "LeakyBucket",
    "besides_surfaces",
    "best_cells",
    "bisect_step",
    "cell_factor",
    "error_at",
    "live_cell_factor",
    "stream_bytes",
    "surface_budget",
]

MIDDLE_STEP = 16.0
"""Luma step by which cells are chosen before colors are fitted. Measured on the kitchen: narrow cells at a middling
step show more of the depth than wide ones at a fine step, and the same colors (decision 0010)."""
MIN_STEP, MAX_STEP = 0.5, 160.0
"""Luma steps between which that of a rate is sought: half a level, which rounding hides, to most of the 256 levels."""
MAX_TRIALS = 9
"""Streams that a search for a step makes at most: nine halvings of that range leave steps 1.1 % apart."""
CLOSE = 0.985
"""Share of a target from which a size is close enough: what is missing is worth less than another trial."""
MAX_STEP_RATIO = 8.0
"""How many times as fine as the step of a background image that of the cells may be, to fill what is left of a rate:
three halvings, beyond which their bits buy little."""

FRAME_BYTES = 9.0
"""About what a frame takes besides surfaces: a pose, 4 to 5 bytes, a gain, 1, and what a shift may take."""
HEAD_BYTES = 700.0
"""About what a file takes besides surfaces and frames: head, framing, INDEX, filter; by hand."""
MIN_SURFACE_SHARE = 0.1
"""Share of a file that surfaces get in any case: without them nothing is drawn."""

MAX_CELL_FACTOR = 4.0
"""Cells are made so many times as wide, or narrow, at most: how bytes go with them is extrapolated."""
MIN_CHANGE = 1.08
"""Cells wider or narrower by less than this are not worth fusing all frames again."""
NARROWER, MAX_NARROWINGS = 0.8, 3
"""Cells are tried in steps of this factor of their edge, and so often narrower: 1.56 times the bytes each time."""
MIN_RISE, MAX_RISE = 0.4, 1.0
"""Rise of the logarithm of an error as that of the bytes falls, within which two sizes are believed; by hand."""

BITS_PER_LIVE_CELL = 6.0
"""What a live stream sends in its first second over the cells that the surface of the first frame covers; measured: 3.5
bits where the camera stands still, 7 where it turns fast."""
MIN_LIVE_FACTOR = 0.8
"""Live cells are no narrower than so many times the default: how fast the camera will move is not known. Measured on
fr1_rpy at 128 kbit/s: with narrower ones more of the depth is lost (decision 0010)."""

SHARE_PER_BYTE = 0.4
"""A share of the bytes of a stream is worth this share of its squared error, as steps of quantization trade them."""
DEPTH_SHARE = 0.5
"""A tenth off the depth error counts as much as about a fifth of a decibel of colors."""


def stream_bytes(packets: Sequence[Packet]) -> int:
    """Return about how many bytes packets take in a file, their INDEX included."""
    bodies = sum(PACKET_FRAMING_BYTES + len(pack_map(packet.header)) + len(packet.payload) for packet in packets)
    return FILE_HEAD_BYTES + bodies + PACKET_FRAMING_BYTES + INDEX_ENTRY_BYTES * len(packets)


def besides_surfaces(frames: int) -> float:
    """Return about how many bytes a file takes besides surfaces: each frame takes poses."""
    return FRAME_BYTES * frames + HEAD_BYTES


def surface_budget(frames: int, target_bytes: float) -> float:
    """Return how many of the bytes of a file are left for surfaces."""
    return max(target_bytes - besides_surfaces(frames), MIN_SURFACE_SHARE * target_bytes)


def cell_factor(surface_bytes: int, budget_bytes: float) -> float:
    """Return by how much wider cells must be for surfaces to take a number of bytes.

    Parameters
    ----------
    surface_bytes
        What the surfaces take with the present cells at `MIDDLE_STEP`; they go with the inverse square of the edge.
    budget_bytes
        What they may take.
    """
    factor = float(np.clip(np.sqrt(surface_bytes / budget_bytes), 1 / MAX_CELL_FACTOR, MAX_CELL_FACTOR))
    return factor if max(factor, 1 / factor) > MIN_CHANGE else 1.0


def live_cell_factor(cells: float, bytes_per_second: float) -> float:
    """Return by how much wider cells must be for what the first frame shows to be sent within a second.

    Parameters
    ----------
    cells
        How many of the present cells its surface would cover if it faced the camera.
    bytes_per_second
        The rate.
    """
    factor = np.sqrt(cells * BITS_PER_LIVE_CELL / 8 / bytes_per_second)
    return float(np.clip(factor, MIN_LIVE_FACTOR, MAX_CELL_FACTOR))


def best_cells(error_of: Callable[[float], float], *, max_widenings: int = 1) -> float:
    """Find by how much wider cells should be, first trying narrower ones, and if they are no better wider ones.

    Parameters
    ----------
    error_of
        Gives the error with cells wider by a factor.
    max_widenings
        How often wider ones are tried.

    Returns
    -------
    float
        The factor of the least error; between those tried, where a parabola through the best and its neighbors has
        its least value.
    """
    errors = {0: error_of(1.0), 1: error_of(NARROWER)}
    while min(errors, key=errors.__getitem__) == max(errors) < MAX_NARROWINGS:
        power = max(errors) + 1
        errors[power] = error_of(NARROWER**power)
    while min(errors, key=errors.__getitem__) == min(errors) > -max_widenings:
        power = min(errors) - 1
        errors[power] = error_of(NARROWER**power)
    best = min(errors, key=errors.__getitem__)
    wider, narrower = errors.get(best - 1, inf), errors.get(best + 1, inf)
    bend = wider + narrower - 2 * errors[best]
    beside = 0.5 * (wider - narrower) / bend if 0 < bend < inf else 0.0
    factor = float(NARROWER ** (best + beside))
    return factor if max(factor, 1 / factor) > MIN_CHANGE**0.5 else 1.0


def error_at(budget_bytes: float, sizes: Sequence[int], errors: Sequence[float]) -> float:
    """Return the error at a number of bytes, linear in their logarithm between given sizes, which ascend.

    Below the least size it rises about as between the first two, which say little where they hardly differ; beyond
    the greatest it stays.
    """
    logs = np.maximum.accumulate(np.log(sizes))
    if budget_bytes < sizes[0]:
        apart = logs[1] - logs[0]
        rise = (errors[0] - errors[1]) / apart if apart > 0 else 0.0
        return float(errors[0] + np.clip(rise, MIN_RISE, MAX_RISE) * (logs[0] - np.log(budget_bytes)))
    return float(np.interp(np.log(budget_bytes), logs, errors))


def bisect_step(
    size_of: Callable[[float], int],
    target_bytes: float,
    steps: tuple[float, float] = (MIN_STEP, MAX_STEP),
) -> tuple[float, int]:
    """Find the largest size of at most `target_bytes`, or the smallest there is, by bisection of the step.

    Parameters
    ----------
    size_of
        Gives the size for a quantization step; sizes fall as steps rise.
    target_bytes
        Wanted size.
    steps
        Least and greatest step.

    Returns
    -------
    step, size
        The step chosen, and the size it gives.
    """
    low, high = np.log2(steps)
    step = np.log2(MIDDLE_STEP) if low < np.log2(MIDDLE_STEP) < high else (low + high) / 2
    tried: list[tuple[float, int]] = []
    for _ in range(MAX_TRIALS):
        size = size_of(float(2**step))
        tried.append((float(2**step), size))
        if size > target_bytes:
            low = step
        else:
            high = step
            if size > CLOSE * target_bytes:
                break
        step = (low + high) / 2
    fitting = [each for each in tried if each[1] <= target_bytes]
    return max(fitting, key=lambda each: each[1]) if fitting else min(tried, key=lambda each: each[1])


class LeakyBucket:
    """How many bytes a live stream may still take.

    Parameters
    ----------
    bytes_per_second
        The rate.
    buffer_s
        So many seconds' worth may be sent at once; the stream starts with a full buffer.

    Attributes
    ----------
    available
        Bytes that may be sent now; below 0 where more was sent than was to be.
    """

    def __init__(self, bytes_per_second: float, buffer_s: float) -> None:
        self._rate = bytes_per_second
        self._size = bytes_per_second * buffer_s
        self.available = self._size

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.available = min(self.available + self.refill(seconds), self._size)

    def refill(self, seconds: float) -> float:
        """Return how many bytes a time adds while the buffer is not full."""
        return self._rate * seconds

    def take(self, count: int) -> None:
        """Note that bytes were sent."""
        self.available -= count
