# SPDX-License-Identifier: MIT
"""The mean in which outliers count little."""

from __future__ import annotations

import numpy as np
import pytest

from threedvc.arrays import Doubles, Floats
from threedvc.encoder.appearance.background.robust_mean import Observations, robust_mean


def mean_of(values: list[list[float]], weights: list[list[float]], outlier: float) -> tuple[Doubles, Doubles]:
    def observations() -> Observations:
        return ((np.array(value), np.array(weight)) for value, weight in zip(values, weights, strict=True))

    def residual(value: Floats | Doubles, mean: Doubles) -> Doubles:
        return np.asarray((value - mean) / outlier)

    return robust_mean(observations, residual, 1e-9)


def test_alike_values_are_weighed_alone() -> None:
    mean, weight = mean_of([[1.0, 2.0], [1.0, 4.0]], [[1.0, 3.0], [1.0, 1.0]], 1e6)
    np.testing.assert_allclose(mean, [1.0, 2.5])
    np.testing.assert_allclose(weight, [2.0, 4.0])


def test_an_outlier_counts_little() -> None:
    values = [[10.0]] * 9 + [[110.0]]
    mean, weight = mean_of(values, [[1.0]] * 10, 10.0)
    assert mean[0] == pytest.approx(10.0, abs=0.3)
    # The first mean is 20: nine are one unit away and count a quarter.
    assert weight[0] == pytest.approx(9 / 4, rel=0.01)


def test_what_nothing_tells_is_zero() -> None:
    mean, weight = mean_of([[5.0, 7.0]], [[0.0, 1.0]], 1.0)
    np.testing.assert_array_equal(mean, [0.0, 7.0])
    np.testing.assert_array_equal(weight, [0.0, 1.0])
