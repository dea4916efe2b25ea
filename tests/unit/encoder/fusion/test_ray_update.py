# SPDX-License-Identifier: MIT
"""The exact ray sum of a cell against an enumeration of every configuration of the cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from threedvc.kernels.encoder.ray_update import cell_update

Floats = NDArray[np.float64]


def enumerated(log_odds: Floats, likelihood: Floats, none_likelihood: float) -> Floats:
    """Sum eq. (6) over all 2^n configurations; eq. (7) gives each the likelihood of its nearest occupied cell."""
    n = len(log_odds)
    occupied = (np.arange(2**n)[:, None] >> np.arange(n) & 1).astype(bool)
    reading = np.where(occupied.any(axis=1), likelihood[occupied.argmax(axis=1)], none_likelihood)
    prior = np.where(occupied, 1 / (1 + np.exp(-log_odds)), 1 / (1 + np.exp(log_odds)))
    delta = np.empty(n)
    for cell in range(n):
        joint = np.prod(np.delete(prior, cell, axis=1), axis=1) * reading
        delta[cell] = np.log(joint[occupied[:, cell]].sum()) - np.log(joint[~occupied[:, cell]].sum())
    return delta


def in_logarithms(log_odds: Floats, likelihood: Floats, none_likelihood: float) -> Floats:
    """Evaluate the closed form with the logarithms of T, A and S, which have no range to leave."""
    empty = -np.logaddexp(0, log_odds)
    hit = np.log(likelihood) + log_odds + empty
    reach = np.concatenate([[0], np.cumsum(empty)])[:-1]
    before = np.concatenate([[-np.inf], np.logaddexp.accumulate(hit + reach)])[:-1]
    beyond = np.empty(len(log_odds))
    value = np.log(none_likelihood)
    for cell in range(len(log_odds) - 1, -1, -1):
        beyond[cell] = value
        value = np.logaddexp(hit[cell], empty[cell] + value)
    return np.logaddexp(before, reach + np.log(likelihood)) - np.logaddexp(before, reach + beyond)


def updated(
    log_odds: Floats, likelihood: Floats, none_likelihood: float, cells: NDArray[np.int64] | None = None
) -> Floats:
    """Return the changes of all cells of a ray, or of some."""
    n = len(log_odds)
    chosen = np.arange(n) if cells is None else cells
    return np.array([cell_update(log_odds, likelihood, none_likelihood, n, cell) for cell in chosen])


def some_cells(n: int, around: int) -> NDArray[np.int64]:
    """Return cells all along a ray of n, and all those near one."""
    return np.unique(np.concatenate([np.arange(0, n, 9973), np.arange(around - 6, min(around + 6, n)), [n - 1]]))


def reading_at(cell: int, n: int, outlier: float = 0.02) -> Floats:
    """Return the likelihoods of a reading at the depth of one cell."""
    away = np.arange(n) - cell
    return (1 - outlier) * np.exp(-0.5 * (away / 0.7) ** 2) + outlier


@st.composite
def rays(draw: st.DrawFn) -> tuple[Floats, Floats, float]:
    n = draw(st.integers(1, 10))
    odds = draw(st.lists(st.floats(-30, 30), min_size=n, max_size=n))
    powers = draw(st.lists(st.floats(-12, 0), min_size=n + 1, max_size=n + 1))
    likelihood = 10.0 ** np.array(powers)
    return np.array(odds), likelihood[:-1], float(likelihood[-1])


@given(rays())
def test_equals_the_sum_over_all_configurations(ray: tuple[Floats, Floats, float]) -> None:
    np.testing.assert_allclose(updated(*ray), enumerated(*ray), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 5, 10])
def test_equals_the_sum_for_equiprobable_cells(n: int, rng: np.random.Generator) -> None:
    ray = np.zeros(n), rng.uniform(0.01, 1, n), 0.3
    np.testing.assert_allclose(updated(*ray), enumerated(*ray), rtol=1e-12, atol=1e-12)


@given(rays())
def test_what_stands_behind_the_ray_does_not_count(ray: tuple[Floats, Floats, float]) -> None:
    log_odds, likelihood, none = ray
    n = len(log_odds)
    scratch = np.concatenate([log_odds, [np.nan] * 3]), np.concatenate([likelihood, [np.nan] * 3])
    alone = [cell_update(*scratch, none, n, cell) for cell in range(n)]
    np.testing.assert_allclose(alone, updated(*ray), rtol=1e-12, atol=1e-12)


@given(rays(), st.floats(1e-6, 1e6))
def test_only_ratios_of_likelihoods_matter(ray: tuple[Floats, Floats, float], scale: float) -> None:
    log_odds, likelihood, none = ray
    scaled = updated(log_odds, likelihood * scale, none * scale)
    np.testing.assert_allclose(scaled, updated(*ray), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("prior", [-8.0, 0.0, 8.0])
def test_long_rays_neither_underflow_nor_overflow(prior: float) -> None:
    n = 100_000
    log_odds, likelihood, cells = np.full(n, prior), reading_at(n // 2, n), some_cells(n, n // 2)
    delta = updated(log_odds, likelihood, 0.02, cells)
    np.testing.assert_allclose(delta, in_logarithms(log_odds, likelihood, 0.02)[cells], atol=1e-9)


def test_a_hit_behind_a_long_free_path() -> None:
    n = 100_000
    log_odds = np.full(n, -30.0)
    log_odds[-12:] = 0
    cells = some_cells(n, n - 10)
    delta = updated(log_odds, reading_at(n - 10, n), 0.02, cells)
    assert delta[cells == n - 10] > 0.5
    assert np.all(delta[cells < n - 15] < -0.5)


@pytest.mark.parametrize("certain", [-2000.0, -700.0, 700.0, 2000.0])
def test_certain_cells_give_finite_changes(certain: float) -> None:
    log_odds = np.zeros(9)
    log_odds[3] = certain
    delta = updated(log_odds, reading_at(4, 9), 0.02)
    assert np.all(np.isfinite(delta))
    if certain > 0:
        np.testing.assert_allclose(delta[4:], 0, atol=1e-12)


def test_free_cells_lose_and_the_hit_cell_gains() -> None:
    log_odds, likelihood = np.zeros(12), reading_at(5, 12)
    delta = updated(log_odds, likelihood, 0.02)
    assert delta[5] > 0
    assert np.all(delta[:4] < 0)
    # What lies behind the hit is hidden: it changes far less.
    assert np.all(np.abs(delta[8:]) < 0.1 * delta[5])


def test_repeated_readings_converge_to_the_surface() -> None:
    log_odds, likelihood = np.zeros(10), reading_at(6, 10)
    for _ in range(20):
        log_odds += updated(log_odds, likelihood, 0.02)
    probability = 1 / (1 + np.exp(-log_odds))
    assert probability[6] > 0.99
    assert np.all(probability[:5] < 0.01)


def test_a_reading_that_tells_nothing_changes_nothing(rng: np.random.Generator) -> None:
    delta = updated(rng.normal(0, 3, 40), np.full(40, 0.25), 0.25)
    np.testing.assert_allclose(delta, 0, atol=1e-12)
