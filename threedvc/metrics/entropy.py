# SPDX-License-Identifier: MIT
"""Entropy of occupancy, in bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["bernoulli_entropy_bits"]


def bernoulli_entropy_bits(log_odds: ArrayLike) -> NDArray[np.float64]:
    """Return the entropy in bits of occupancies given by their log-odds; 0 log-odds is one bit."""
    magnitude = np.abs(np.asarray(log_odds, dtype=np.float64))
    tail = np.exp(-magnitude)
    return np.asarray((np.log1p(tail) + magnitude * tail / (1 + tail)) / np.log(2.0))
