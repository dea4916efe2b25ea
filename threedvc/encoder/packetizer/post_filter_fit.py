# SPDX-License-Identifier: MIT
"""The filter of drawn pictures that mends most of a stream's color error, by least squares."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.filters import MAX_FACTOR
from threedvc.decoder.frame_state import FrameState
from threedvc.decoder.replay import replay
from threedvc.encoder.rate.rate_control import SHARE_PER_BYTE
from threedvc.frames.sequence import FrameSequence, sampling_stride
from threedvc.kernels.render.picture_filter import add_filter_equations
from threedvc.model.post_filter import FACTOR_UNIT, PAIRS, PIXEL_CLASSES, PostFilter, planes_of
from threedvc.parallel import for_ranges
from threedvc.render.picture import Picture
from threedvc.stream.headers import StreamHeader
from threedvc.stream.packets import Packet

__all__ = ["FILTER_BYTES", "fit_post_filter"]

FILTER_BYTES = 60
"""What a filter takes in a file at most; measured: 25 to 60 (decision 0014)."""
CLASS_BYTES = {False: 9.0, True: 5.0}
"""About what the factors of one class of pixels take, by whether the stream is gray: `FILTER_BYTES` over six classes;
without chroma half of that."""
FILTER_FRAMES = 40
"""Frames that the fit draws at most: there are twelve unknowns to a class, and every frame has thousands of pixels."""
DAMPING = 1e-4
"""Share of the diagonal that is added to it: equations of a class with few or even pixels say little."""
FACTORS = 2 * PAIRS
"""Unknowns of a class: a factor for each pair of pixels, of luma and of chroma."""


def fit_post_filter(packets: Sequence[Packet], frames: FrameSequence, threads: int) -> PostFilter | None:
    """Fit a filter to what a decoder draws of packets.

    Parameters
    ----------
    packets
        All packets of a stream without a filter.
    frames
        The frames that it shows.
    threads
        Number of threads.

    Returns
    -------
    PostFilter or None
        With filters for the classes of pixels where they save more than they take; None: for none.
    """
    equations = _Equations(threads)
    every = sampling_stride(len(frames), FILTER_FRAMES, frames.info)

    def wanted(state: FrameState) -> bool:
        return state.index % every == 0 and bool(state.T_camera_object)

    for frame in replay(packets, threads, wanted):
        equations.add(frame.drawn(PostFilter.none()), frames[frame.state.index].color)
    total = sum(len(packet.payload) for packet in packets)
    return equations.solved(SHARE_PER_BYTE / total, StreamHeader.from_map(packets[0].header).gray)


class _Equations:
    """Normal equations of the factors for each class of pixels, every frame scaled to a squared error of one."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._matrix, self._side = np.zeros((PIXEL_CLASSES, FACTORS, FACTORS)), np.zeros((PIXEL_CLASSES, FACTORS))
        self._frames = 0

    def add(self, drawn: Picture, wanted: NDArray[np.uint8]) -> None:
        """Add the equations of a frame: of what is drawn, and the colors (h, w, 3) that it should have."""
        assert drawn.pixel_classes is not None
        planes, classes, height = planes_of(drawn.color), drawn.pixel_classes, len(wanted)
        starts = range(0, height, -(-height // self._threads))
        matrices = np.zeros((len(starts), PIXEL_CLASSES, FACTORS, FACTORS))
        sides, squares = np.zeros((len(starts), PIXEL_CLASSES, FACTORS)), np.zeros((len(starts), PIXEL_CLASSES))

        def part_range(first: int, last: int) -> None:
            for part in range(first, last):
                rows = starts[part], min(starts[part] + starts.step, height)
                add_filter_equations(*rows, planes, classes, wanted, matrices[part], sides[part], squares[part])

        for_ranges(part_range, len(starts), self._threads)
        scale = 1 / max(float(squares.sum()), 1.0)
        self._matrix += scale * matrices.sum(axis=0)
        self._side += scale * sides.sum(axis=0)
        self._frames += 1

    def solved(self, share_per_byte: float, gray: bool) -> PostFilter | None:
        """Return the filters that save more of the squared error than their bytes are worth, or None."""
        factors = np.zeros((PIXEL_CLASSES, FACTORS), dtype=np.int32)
        for pixel_class in range(PIXEL_CLASSES):
            found = self._factors(pixel_class, PAIRS if gray else FACTORS)
            saved = found @ (2 * self._side[pixel_class] - self._symmetric(pixel_class) @ found)
            if saved > CLASS_BYTES[gray] * share_per_byte * self._frames:
                factors[pixel_class] = np.rint(found / FACTOR_UNIT)
        luma, chroma = factors[:, :PAIRS], factors[:, PAIRS:]
        if not factors.any():
            return None
        return PostFilter(luma=np.ascontiguousarray(luma), chroma=np.ascontiguousarray(chroma))

    def _symmetric(self, pixel_class: int) -> NDArray[np.float64]:
        upper = self._matrix[pixel_class]
        return np.asarray(upper + np.triu(upper, 1).T)

    def _factors(self, pixel_class: int, count: int) -> NDArray[np.float64]:
        """Return the best factors (12,) that are multiples of a unit, rounded one by one while the rest follow."""
        matrix, side = self._symmetric(pixel_class)[:count, :count], self._side[pixel_class, :count]
        matrix = matrix + np.diag(DAMPING * np.diag(matrix) + np.finfo(float).tiny)
        factors, free = np.zeros(FACTORS), np.arange(count)
        while len(free):
            known = side[free] - matrix[free] @ factors[:count]
            best = np.linalg.solve(matrix[np.ix_(free, free)], known)
            factors[free[0]] = np.clip(np.rint(best[0] / FACTOR_UNIT), -MAX_FACTOR, MAX_FACTOR) * FACTOR_UNIT
            free = free[1:]
        return factors
