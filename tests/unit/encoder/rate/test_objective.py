# SPDX-License-Identifier: MIT
"""What bytes are worth beside a color video."""

from __future__ import annotations

from math import log

import pytest

from threedvc.encoder.rate.objective import DEPTH_WEIGHT, MIN_SLOPE, ColorCost, objective

TRIED = ColorCost((1000.0, 2000.0, 4000.0), (5.0, 4.5, 4.2), 4000.0)


def test_depth_counts_as_it_is_weighed() -> None:
    assert objective(3.0, 0.5, 1.0) == 3.0 + 0.5 * DEPTH_WEIGHT
    assert objective(3.0, 0.5, 3.0) - 3.0 == pytest.approx(3 * (objective(3.0, 0.5, 1.0) - 3.0))


@pytest.mark.parametrize(("spent", "error"), [(0, 4.2), (2000, 4.5), (3000, 5.0)])
def test_videos_that_were_tried_have_the_error_they_had(spent: float, error: float) -> None:
    assert TRIED.at(spent) == pytest.approx(error)


def test_between_and_beyond_the_error_follows_the_logarithm_of_the_bytes() -> None:
    assert TRIED.at(4000 - 2000 * 2**0.5) == pytest.approx(4.35)
    assert ColorCost(TRIED.sizes, TRIED.errors, 8000.0).at(0) == pytest.approx(3.9)
    assert TRIED.at(3500) == pytest.approx(5.5)


def test_an_error_never_falls_as_more_is_spent() -> None:
    costs = [TRIED.at(spent) for spent in range(0, 9000, 250)]
    assert costs == sorted(costs)


def test_a_video_that_hardly_gains_still_costs_something() -> None:
    flat = ColorCost((1000.0, 2000.0), (4.0, 4.0), 2000.0)
    assert flat.at(1000) - flat.at(0) == pytest.approx(MIN_SLOPE * log(2))


@pytest.mark.parametrize("budget", [None, 1000.0])
def test_videos_of_one_size_tell_no_slope_and_still_cost_something(budget: float | None) -> None:
    same = ColorCost((500.0, 500.0), (4.0, 4.1), budget)
    assert same.at(250) > same.at(0)


def test_more_than_all_may_be_spent() -> None:
    assert TRIED.beside(4000).at(0) > TRIED.at(3000)
    assert TRIED.beside(5000).at(1000) > TRIED.at(3000)


def test_below_the_coarsest_video_bytes_are_dear() -> None:
    bounded = ColorCost(TRIED.sizes, TRIED.errors, 4000.0, coarsest_bytes=1000.0)
    assert bounded.at(3500) > TRIED.at(3500) + 1


def test_without_a_budget_bytes_cost_what_the_video_would_gain_by_as_many() -> None:
    given = ColorCost((1000.0, 500.0), (5.0, 5.5))
    assert given.at(0) == 5.0
    assert given.at(1000) - given.at(0) == pytest.approx(0.5)


def test_what_comes_on_top_costs_what_it_costs_in_all() -> None:
    assert TRIED.beside(1500).at(500) == pytest.approx(TRIED.at(2000))


@pytest.mark.parametrize("fixed", [False, True])
def test_of_a_slope_a_share_of_the_bytes_costs_that_share_of_it(fixed: bool) -> None:
    cost = ColorCost.of_slope(1000.0, 0.4, fixed=fixed)
    assert cost.at(10) - cost.at(0) == pytest.approx(0.4 * 0.01, rel=0.02)
