# SPDX-License-Identifier: MIT
"""Curves of rate over quality, and the Bjontegaard difference of two."""

from __future__ import annotations

import numpy as np
import pytest

from bd_rate import Curve, bd_rate, geometric_mean

RATES = np.array([10.0, 20, 40, 80, 160])
QUALITIES = np.array([25.0, 29, 32, 34, 35])


def curve(rates: np.ndarray = RATES, qualities: np.ndarray = QUALITIES) -> Curve:
    return Curve.hull(zip(rates.tolist(), qualities.tolist(), strict=True))


class TestBdRate:
    @pytest.mark.parametrize("factor", [0.5, 0.8, 1.0, 1.5])
    def test_every_rate_times_a_factor(self, factor: float) -> None:
        assert bd_rate(curve(), curve(factor * RATES)) == pytest.approx(100 * (factor - 1), abs=1e-9)

    def test_two_points_each_are_joined_by_straight_lines(self) -> None:
        reference, tested = Curve.hull([(1, 0), (100, 2)]), Curve.hull([(1, 1), (100, 3)])
        assert bd_rate(reference, tested) == pytest.approx(-90)

    def test_only_common_qualities_count(self) -> None:
        tested = curve(2 * RATES[:3], QUALITIES[:3])
        assert bd_rate(curve(RATES[:3], QUALITIES[:3]), tested) == pytest.approx(100)
        longer = Curve.hull([(5, 20), *zip(RATES[:3].tolist(), QUALITIES[:3].tolist(), strict=True)])
        assert bd_rate(longer, Curve.hull([(1, 0), (2, 20)])) is None

    def test_integral_is_that_of_the_interpolation(self) -> None:
        reference, tested = curve(), curve(RATES * [0.7, 0.9, 0.6, 0.8, 0.5], QUALITIES + 0.7)
        quality = np.linspace(25.7, 35, 200001)
        difference = np.exp(np.mean(tested.log_rate(quality) - reference.log_rate(quality))) - 1
        assert bd_rate(reference, tested) == pytest.approx(100 * difference, abs=1e-3)

    def test_none_without_common_qualities(self) -> None:
        assert bd_rate(curve(), curve(qualities=QUALITIES + 10)) is None
        assert bd_rate(curve(), Curve.hull([(30, 30)])) is None


class TestCurve:
    def test_passes_through_its_points_and_stays_between_them(self) -> None:
        assert curve().rate(29.0) == pytest.approx(20)
        rates = [curve().rate(quality) for quality in np.linspace(25, 35, 101)]
        assert rates == sorted(rates)

    def test_ends(self) -> None:
        assert curve().rate(3.0) == pytest.approx(10)
        assert curve().rate(35.1) is None

    def test_points_that_others_beat_are_left_out(self) -> None:
        points = [(10.0, 20.0), (10.0, 25.0), (15.0, 24.0), (20.0, 26.0), (30.0, 35.0), (40.0, 35.0)]
        assert Curve.hull(points).qualities.tolist() == [25.0, 35.0]

    def test_linear_curve_has_its_slope_everywhere(self) -> None:
        straight = Curve.hull([(float(np.exp(q)), float(q)) for q in range(4)])
        assert straight.slopes == pytest.approx(np.ones(4))

    @pytest.mark.parametrize("points", [[], [(0.0, 1.0), (1.0, 2.0)]], ids=["no point", "rate of zero"])
    def test_what_is_no_curve(self, points: list[tuple[float, float]]) -> None:
        with pytest.raises(ValueError, match="a curve needs points"):
            Curve.hull(points)


def test_geometric_mean() -> None:
    assert geometric_mean([0.5, 2.0, 8.0]) == pytest.approx(2)
    assert geometric_mean([]) is None
