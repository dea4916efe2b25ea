# SPDX-License-Identifier: MIT
"""The mean of what many frames say of the same pixels, in which outliers count little."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeAlias

import numpy as np

from threedvc.arrays import Doubles, Floats

__all__ = ["Observations", "robust_mean"]

Observations: TypeAlias = Iterable[tuple[Floats | Doubles, Doubles]]
"""Values, and weights that broadcast to them, of one frame after the other."""


def robust_mean(
    observations: Callable[[], Observations],
    residual: Callable[[Floats | Doubles, Doubles], Doubles],
    min_weight: float,
) -> tuple[Doubles, Doubles]:
    """Average frames in two passes; in the second one each counts by how near it is to the mean of the first.

    Parameters
    ----------
    observations
        Return values and weights of all frames; called once for each pass, so that values need not be kept.
    residual
        Return how far values are from the mean, in units of what an outlier is; broadcasts to the weights.
    min_weight
        Sums of weights below this count as this much: what no frame tells becomes zero.

    Returns
    -------
    mean, weight
        The mean, and the sum of the weights (those of Geman and McClure, times the frames' own).
    """
    first, _ = _weighted_mean(observations(), min_weight)
    return _weighted_mean(
        ((value, weight / (1 + residual(value, first) ** 2) ** 2) for value, weight in observations()), min_weight
    )


def _weighted_mean(observations: Observations, min_weight: float) -> tuple[Doubles, Doubles]:
    total, weights = np.zeros(()), np.zeros(())
    for value, weight in observations:
        total, weights = total + weight * value, weights + weight
    return total / np.maximum(weights, min_weight), weights
