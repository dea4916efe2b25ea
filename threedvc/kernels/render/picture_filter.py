# SPDX-License-Identifier: MIT
"""The filter of drawn pictures, and the equations of its least squares, compiled.

Floats hold integers below 2^24 here, so all sums are exact; as floats they are added eight at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel

__all__ = ["MARGIN", "OFFSETS", "add_filter_equations", "filter_rows"]

OFFSETS = np.array([(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)], dtype=np.int64)
"""(6, 2) row and column of one pixel of each pair; the other lies opposite."""
MARGIN = int(np.abs(OFFSETS).max())
"""Pixels that the pairs reach beyond the border."""
UNIT = np.float32(1 / 256)
"""Of what pairs add: factors are in 1/64, and luma is a quarter of R + 2 G + B."""
HALF = np.float32(128)
"""Half a level in these units, for rounding."""


@kernel
def filter_rows(
    start: int,
    stop: int,
    planes: NDArray[np.float32],
    kinds: NDArray[np.uint8],
    luma: NDArray[np.int32],
    chroma: NDArray[np.int32],
    result: NDArray[np.uint8],
) -> None:
    """Filter rows ``start..stop`` of a picture, run by run of pixels of one kind.

    Parameters
    ----------
    planes
        (3, h + 4, w + 4) RGB, continued by `MARGIN` pixels on all sides.
    kinds
        (h, w) kind of every pixel.
    luma, chroma
        (kinds, 6) factors of the pairs, in 1/64.
    result
        (h, w, 3), written.
    """
    width = kinds.shape[1]
    change = np.empty((3, width), dtype=np.float32)
    for y in range(start, stop):
        first = 0
        while first < width:
            kind = kinds[y, first]
            last = first + 1
            while last < width and kinds[y, last] == kind:
                last += 1
            change[:, first:last] = np.float32(0)
            for pair in range(len(OFFSETS)):
                c, more = chroma[kind, pair], luma[kind, pair] - chroma[kind, pair]
                if c != 0 or more != 0:
                    add_pair(planes, y, OFFSETS[pair, 0], OFFSETS[pair, 1], first, last, 4 * c, more, change)
            for channel in range(3):
                for x in range(first, last):
                    step = np.floor((change[channel, x] + HALF) * UNIT)
                    value = planes[channel, y + MARGIN, x + MARGIN] + step
                    result[y, x, channel] = np.uint8(min(max(value, np.float32(0)), np.float32(255)))
            first = last


@kernel
def add_pair(
    planes: NDArray[np.float32],
    y: int,
    dy: int,
    dx: int,
    first: int,
    last: int,
    own: int,
    shared: int,
    change: NDArray[np.float32],
) -> None:
    """Add what the pair at +-(dy, dx) gives to pixels ``first..last`` of row `y`, in 1/256."""
    row, of_own, of_shared = y + MARGIN, np.float32(own), np.float32(shared)
    for x in range(first, last):
        column = x + MARGIN
        red = planes[0, row + dy, column + dx] + planes[0, row - dy, column - dx]
        green = planes[1, row + dy, column + dx] + planes[1, row - dy, column - dx]
        blue = planes[2, row + dy, column + dx] + planes[2, row - dy, column - dx]
        red -= np.float32(2) * planes[0, row, column]
        green -= np.float32(2) * planes[1, row, column]
        blue -= np.float32(2) * planes[2, row, column]
        luma = of_shared * (red + np.float32(2) * green + blue)
        change[0, x] += of_own * red + luma
        change[1, x] += of_own * green + luma
        change[2, x] += of_own * blue + luma


@kernel
def add_filter_equations(
    start: int,
    stop: int,
    planes: NDArray[np.float32],
    kinds: NDArray[np.uint8],
    wanted: NDArray[np.uint8],
    matrix: NDArray[np.float64],
    side: NDArray[np.float64],
    square: NDArray[np.float64],
) -> None:
    """Add up the normal equations for the factors of rows ``start..stop``; see `filter_rows`.

    Parameters
    ----------
    wanted
        (h, w, 3) RGB.
    matrix, side, square
        (kinds, 12, 12) upper triangles, (kinds, 12) and (kinds,) squared errors without a filter, updated; of
        luma's factors first, then of chroma's.
    """
    pairs = len(OFFSETS)
    of_luma, row = np.empty(pairs), np.empty(2 * pairs)
    away = np.empty((3, pairs))
    for y in range(start, stop):
        for x in range(kinds.shape[1]):
            kind = kinds[y, x]
            for pair in range(pairs):
                dy, dx = OFFSETS[pair, 0], OFFSETS[pair, 1]
                for channel in range(3):
                    away[channel, pair] = (
                        planes[channel, y + MARGIN + dy, x + MARGIN + dx]
                        + planes[channel, y + MARGIN - dy, x + MARGIN - dx]
                        - np.float32(2) * planes[channel, y + MARGIN, x + MARGIN]
                    )
                of_luma[pair] = 0.25 * (away[0, pair] + 2.0 * away[1, pair] + away[2, pair])
            for channel in range(3):
                error = np.float64(wanted[y, x, channel]) - planes[channel, y + MARGIN, x + MARGIN]
                square[kind] += error * error
                for pair in range(pairs):
                    row[pair] = of_luma[pair]
                    row[pairs + pair] = away[channel, pair] - of_luma[pair]
                for a in range(2 * pairs):
                    side[kind, a] += row[a] * error
                    for b in range(a, 2 * pairs):
                        matrix[kind, a, b] += row[a] * row[b]
