# SPDX-License-Identifier: MIT
"""The exact Bayesian update of a cell on a ray, eq. (4)-(7)."""

from __future__ import annotations

import numpy as np

from threedvc.kernels import kernel

__all__ = ["MAX_SIDE", "MAX_WINDOW", "WINDOW_SIGMAS", "cell_update"]

MAX_LOG_ODDS = 600.0
"""More is as certain, and its exponential would leave the range of a double at 709."""
MAX_BEFORE = 1e300
"""Odds of having been stopped before, beyond which a cell is hidden whatever it is: just within a double."""
WINDOW_SIGMAS = 3.0
"""Deviations about a reading in which cells tell of it: 0.3 % of a Gaussian lie outside."""
MAX_SIDE = 30.0
"""Cells of a window before a cell, and behind it: enough while the deviation is below some five cells."""
MAX_WINDOW = 2 * int(MAX_SIDE) + 1
"""Room for a window and the cell itself."""


@kernel
def cell_update(log_odds, likelihood, none_likelihood, n, cell):
    """Return how far the log-odds of one cell of a ray move.

    The likelihood of eq. (6) marginalizes over all configurations of the other cells, which matter
    only through their nearest occupied cell (eq. 7). With p the priors, T_i the probability that the
    ray reaches cell i, A_i that of having been stopped before, and S_i that of what comes from i on:

        delta_i = log (A_i + T_i L_i) - log (A_i + T_i S_{i+1})

    Both sums are divided by T_i, so that a long ray through likely cells does not underflow; A_i / T_i
    is bounded, beyond which a cell is hidden whatever it is.

    Parameters
    ----------
    log_odds
        (m,) prior log-odds, nearest cell first; the first `n` entries count.
    likelihood
        (m,) p(r | the nearest occupied cell is i), any common scale.
    none_likelihood
        p(r | no cell is occupied), same scale.
    n, cell
        Number of cells, and which of them is asked for.
    """
    beyond = none_likelihood
    for i in range(n - 1, cell, -1):
        odds = np.exp(min(log_odds[i], MAX_LOG_ODDS))
        beyond = (odds * likelihood[i] + beyond) / (1.0 + odds)
    before = 0.0
    for i in range(cell):
        odds = np.exp(min(log_odds[i], MAX_LOG_ODDS))
        before = min(before * (1.0 + odds) + odds * likelihood[i], MAX_BEFORE)
    return np.log(before + likelihood[cell]) - np.log(before + beyond)
