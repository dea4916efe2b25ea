# SPDX-License-Identifier: MIT
"""Slow, obvious versions of the picture measures."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

__all__ = ["slow_ssim"]


def slow_ssim(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Return the mean structural similarity of two (h, w) pictures over all whole 11x11 windows."""
    axis = np.arange(-5, 6)
    window = np.exp(-(axis[:, None] ** 2 + axis[None, :] ** 2) / (2 * 1.5**2))
    window /= window.sum()

    def mean(picture: NDArray[np.float64]) -> NDArray[np.float64]:
        return (sliding_window_view(picture, (11, 11)) * window).sum(axis=(2, 3))

    mean_a, mean_b = mean(first), mean(second)
    variance_a, variance_b = mean(first**2) - mean_a**2, mean(second**2) - mean_b**2
    covariance = mean(first * second) - mean_a * mean_b
    c1, c2 = 2.55**2, 7.65**2
    index = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    return float(np.mean(index / ((mean_a**2 + mean_b**2 + c1) * (variance_a + variance_b + c2))))
