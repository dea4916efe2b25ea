# SPDX-License-Identifier: MIT
"""The filter of drawn pictures, and the equations of its least squares, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel

__all__ = ["MARGIN", "OFFSETS", "add_filter_equations", "filter_rows"]

OFFSETS = np.array([(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)], dtype=np.int64)
"""(6, 2) row and column of one pixel of each pair; the other lies opposite."""
MARGIN = 2
UNIT_BITS = 6


@kernel
def filter_rows(
    start: int,
    stop: int,
    planes: NDArray[np.int16],
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
    change = np.empty((3, width), dtype=np.int32)
    for y in range(start, stop):
        first = 0
        while first < width:
            kind = kinds[y, first]
            last = first + 1
            while last < width and kinds[y, last] == kind:
                last += 1
            if not (luma[kind].any() or chroma[kind].any()):
                for x in range(first, last):
                    for channel in range(3):
                        result[y, x, channel] = planes[channel, y + MARGIN, x + MARGIN]
                first = last
                continue
            change[:, first:last] = 0
            for pair in range(len(OFFSETS)):
                dy, dx = OFFSETS[pair, 0], OFFSETS[pair, 1]
                c, more = chroma[kind, pair], luma[kind, pair] - chroma[kind, pair]
                if c == 0 and more == 0:
                    continue
                for x in range(first, last):
                    row, column = y + MARGIN, x + MARGIN
                    red = np.int32(planes[0, row + dy, column + dx]) + planes[0, row - dy, column - dx]
                    green = np.int32(planes[1, row + dy, column + dx]) + planes[1, row - dy, column - dx]
                    blue = np.int32(planes[2, row + dy, column + dx]) + planes[2, row - dy, column - dx]
                    red -= 2 * np.int32(planes[0, row, column])
                    green -= 2 * np.int32(planes[1, row, column])
                    blue -= 2 * np.int32(planes[2, row, column])
                    shared = more * (red + 2 * green + blue)
                    change[0, x] += 4 * c * red + shared
                    change[1, x] += 4 * c * green + shared
                    change[2, x] += 4 * c * blue + shared
            half = 1 << (UNIT_BITS + 1)
            for x in range(first, last):
                for channel in range(3):
                    value = planes[channel, y + MARGIN, x + MARGIN] + ((change[channel, x] + half) >> (UNIT_BITS + 2))
                    result[y, x, channel] = min(max(value, 0), 255)
            first = last


@kernel
def add_filter_equations(
    start: int,
    stop: int,
    planes: NDArray[np.int16],
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
                        np.int32(planes[channel, y + MARGIN + dy, x + MARGIN + dx])
                        + planes[channel, y + MARGIN - dy, x + MARGIN - dx]
                        - 2 * np.int32(planes[channel, y + MARGIN, x + MARGIN])
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
