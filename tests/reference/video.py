# SPDX-License-Identifier: MIT
"""Slow reference of what samples of a video look like, pixel by pixel, as docs/drawing.md says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["shown_picture"]


def _around(pixel: int, pixels: int, samples: int, half: bool) -> list[tuple[int, int]]:
    """Return four places in a row of samples, and their weights in 1/2^19."""
    at = (16 if half else 32) * (2 * pixel + 1) * samples // pixels - 32
    j, f = at // 64, at % 64
    weights = (
        f * (f * (128 - f) - 4096),
        f * f * (3 * f - 320) + (1 << 19),
        f * (f * (256 - 3 * f) + 4096),
        f * f * (f - 64),
    )
    last = ((samples + 1) // 2 if half else samples) - 1
    return [(min(max(j + k - 1, 0), last), weights[k]) for k in range(4)]


def _value(plane: NDArray[np.uint16], rows: list[tuple[int, int]], columns: list[tuple[int, int]]) -> int:
    total = 1 << 18
    for row, down in rows:
        along = sum(int(plane[row, column]) * across for column, across in columns)
        total += ((along + 1024) >> 11) * down
    return total >> 19


def shown_picture(
    planes: tuple[NDArray[np.uint16], ...],
    size: tuple[int, int],
    bits: int,
    magnified: int,
    *,
    full_chroma: bool = False,
) -> NDArray[np.uint8]:
    """Return the picture (h, w, 3) of a size (w, h) that luma, Co and Cg show."""
    width, height = size
    half_chroma = not full_chroma
    rows, columns = planes[0].shape
    result = np.zeros((height, width, 3), np.uint8)
    middle, unit = 256 << (bits - 1), (4 + magnified) * (256 << (bits - 8))
    for y in range(height):
        for x in range(width):
            luma, co, cg = (
                _value(plane, _around(y, height, rows, half), _around(x, width, columns, half))
                for plane, half in zip(planes, (False, half_chroma, half_chroma), strict=True)
            )
            luma, co, cg = (4 + magnified) * luma, 4 * (co - middle), 4 * (cg - middle)
            for k, value in enumerate((luma - cg + co, luma + cg, luma - cg - co)):
                result[y, x, k] = min(max((value + unit // 2) // unit, 0), 255)
    return result
