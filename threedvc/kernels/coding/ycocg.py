# SPDX-License-Identifier: MIT
"""Samples of luma and chroma made into pixels, in integers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel

__all__ = ["FRACTION_BITS", "WEIGHT_BITS", "color_rows", "stretch_rows"]

WEIGHT_BITS = 19
"""Binary logarithm of the sum of the weights of a pixel's four samples: twice the cube of 64, the places between."""
FRACTION_BITS = 8
"""Of samples interpolated along rows: with them and a weight 38 bits are not exceeded, nor 31 before."""
MAX_LEVEL = 255
"""Greatest value of a channel."""


@kernel
def stretch_rows(
    start: int,
    stop: int,
    samples: NDArray[np.uint16],
    places: NDArray[np.int32],
    weights: NDArray[np.int32],
    stretched: NDArray[np.int32],
) -> None:
    """Interpolate rows ``start..stop`` of samples (rows, columns) at (w, 4) columns with (w, 4) weights.

    What is written into `stretched` (rows, w) has `FRACTION_BITS`.
    """
    shift = WEIGHT_BITS - FRACTION_BITS
    half = np.int32(1 << (shift - 1))
    for y in range(start, stop):
        for x in range(stretched.shape[1]):
            total = half
            for tap in range(4):
                total += weights[x, tap] * np.int32(samples[y, places[x, tap]])
            stretched[y, x] = total >> shift


@kernel
def color_rows(
    start: int,
    stop: int,
    luma: NDArray[np.int32],
    orange: NDArray[np.int32],
    green: NDArray[np.int32],
    luma_places: NDArray[np.int32],
    luma_weights: NDArray[np.int32],
    chroma_places: NDArray[np.int32],
    chroma_weights: NDArray[np.int32],
    bits: int,
    magnified: int,
    picture: NDArray[np.uint8],
) -> None:
    """Set rows ``start..stop`` of a picture (h, w, 3) from planes (rows, w) that `stretch_rows` has written.

    Parameters
    ----------
    luma_places, luma_weights, chroma_places, chroma_weights
        (h, 4) rows of the planes, and how much each counts.
    bits
        Of a sample.
    magnified
        Chroma is 1 + magnified/4 times as large as it would be.
    """
    half = 1 << (WEIGHT_BITS - 1)
    middle = 1 << (FRACTION_BITS + bits - 1)
    larger = 4 + magnified
    unit = larger << (FRACTION_BITS + bits - 8)
    for y in range(start, stop):
        for x in range(picture.shape[1]):
            light, warm, verdant = half, half, half
            for tap in range(4):
                light += luma_weights[y, tap] * np.int64(luma[luma_places[y, tap], x])
                row, weight = chroma_places[y, tap], np.int64(chroma_weights[y, tap])
                warm += weight * orange[row, x]
                verdant += weight * green[row, x]
            light = larger * (light >> WEIGHT_BITS) + (unit >> 1)
            warm = 4 * ((warm >> WEIGHT_BITS) - middle)
            verdant = 4 * ((verdant >> WEIGHT_BITS) - middle)
            picture[y, x, 0] = min(max((light - verdant + warm) // unit, 0), MAX_LEVEL)
            picture[y, x, 1] = min(max((light + verdant) // unit, 0), MAX_LEVEL)
            picture[y, x, 2] = min(max((light - verdant - warm) // unit, 0), MAX_LEVEL)
