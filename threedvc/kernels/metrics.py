# SPDX-License-Identifier: MIT
"""Loops of the picture measures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel

__all__ = ["sum_ssim"]

C1 = (0.01 * 255) ** 2
C2 = (0.03 * 255) ** 2
"""What keeps the ratios of means and of variances finite, by the definition of SSIM: 1 % and 3 % of the range."""


@kernel
def sum_ssim(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    taps: NDArray[np.float64],
    start: int,
    stop: int,
    sums: NDArray[np.float64],
) -> None:
    """Sum the structural similarity over each row of window positions ``start..stop``.

    Parameters
    ----------
    first, second
        (height, width) pictures, 0..255.
    taps
        (n,) window of one dimension, of sum 1; the window is its outer product.
    start, stop
        Rows to compute, of ``height - n + 1``.
    sums
        (height - n + 1,) output: sum over the ``width - n + 1`` positions of a row.
    """
    width = first.shape[1]
    size = len(taps)
    moments = np.empty((5, width))
    for row in range(start, stop):
        moments[:] = 0.0
        for tap in range(size):
            weight = taps[tap]
            for x in range(width):
                a = np.float64(first[row + tap, x])
                b = np.float64(second[row + tap, x])
                moments[0, x] += weight * a
                moments[1, x] += weight * b
                moments[2, x] += weight * (a * a)
                moments[3, x] += weight * (b * b)
                moments[4, x] += weight * (a * b)
        total = 0.0
        for x in range(width - size + 1):
            mean_a = mean_b = aa = bb = ab = 0.0
            for tap in range(size):
                weight = taps[tap]
                mean_a += weight * moments[0, x + tap]
                mean_b += weight * moments[1, x + tap]
                aa += weight * moments[2, x + tap]
                bb += weight * moments[3, x + tap]
                ab += weight * moments[4, x + tap]
            covariance = ab - mean_a * mean_b
            variances = aa - mean_a * mean_a + bb - mean_b * mean_b
            means = mean_a * mean_b
            squares = mean_a * mean_a + mean_b * mean_b
            total += (2 * means + C1) * (2 * covariance + C2) / ((squares + C1) * (variances + C2))
        sums[row] = total
