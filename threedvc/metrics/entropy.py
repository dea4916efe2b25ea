# SPDX-License-Identifier: MIT
"""Entropy of occupancy and of colours, in bits."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["bernoulli_entropy_bits", "gaussian_entropy_bits"]

COLOR_LEVELS = 256
"""Of a channel of 8 bits."""


def bernoulli_entropy_bits(log_odds: ArrayLike) -> NDArray[np.float64]:
    """Return the entropy in bits of occupancies given by their log-odds; 0 log-odds is one bit."""
    magnitude = np.abs(np.asarray(log_odds, dtype=np.float64))
    tail = np.exp(-magnitude)
    return np.asarray((np.log1p(tail) + magnitude * tail / (1 + tail)) / np.log(2.0))


@cache
def _gaussian_entropy_table() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    log_precision = np.linspace(-20.0, 6.0, 521)
    level = np.arange(COLOR_LEVELS) - COLOR_LEVELS // 2
    weight = np.exp(-0.5 * np.exp2(log_precision)[:, None] * level**2)
    probability = weight / weight.sum(axis=1, keepdims=True)
    logarithm = np.log2(probability, out=np.zeros_like(probability), where=probability > 0)
    return log_precision, -np.sum(probability * logarithm, axis=1)


def gaussian_entropy_bits(precision: ArrayLike) -> NDArray[np.float64]:
    """Return the entropy in bits of one colour channel given by the precision of its posterior.

    The posterior is a Gaussian on the 256 levels, ``P(k) ~ exp(-precision (k - mean)^2 / 2)``, taken
    with its mean in the middle of the range. Precision 0 (nothing known) is 8 bits.

    Parameters
    ----------
    precision
        Inverse variance, per squared level, of any shape.
    """
    log_precision, entropy = _gaussian_entropy_table()
    known = np.maximum(np.asarray(precision, dtype=np.float64), 2.0**-40)
    return np.asarray(np.interp(np.log2(known), log_precision, entropy, left=8.0, right=0.0))
