# SPDX-License-Identifier: MIT
"""The exact Bayesian update of the cells along one ray, eq. (4)-(7)."""

from __future__ import annotations

import numpy as np

from threedvc.kernels import kernel

__all__ = ["cell_update", "ray_update"]

MAX_LOG_ODDS = 600.0
MAX_BEFORE = 1e300


@kernel
def ray_update(log_odds, likelihood, none_likelihood, delta):
    """Write how far the log-odds of every cell of a ray move.

    The likelihood of eq. (6) marginalises over all configurations of the other cells, which matter
    only through their nearest occupied cell (eq. 7). With p the priors, T_i the probability that the
    ray reaches cell i, A_i that of having been stopped before, and S_i that of what comes from i on:

        delta_i = log (A_i + T_i L_i) - log (A_i + T_i S_{i+1})

    Both sums are divided by T_i, so that a long ray through likely cells does not underflow; A_i / T_i
    is bounded, beyond which a cell is hidden whatever it is.

    Parameters
    ----------
    log_odds
        (n,) prior log-odds, nearest cell first.
    likelihood
        (n,) p(r | the nearest occupied cell is i), any common scale.
    none_likelihood
        p(r | no cell is occupied), same scale.
    delta
        (n,) output.
    """
    n = log_odds.shape[0]
    beyond = none_likelihood
    for i in range(n - 1, -1, -1):
        delta[i] = beyond
        odds = np.exp(min(log_odds[i], MAX_LOG_ODDS))
        beyond = (odds * likelihood[i] + beyond) / (1.0 + odds)
    before = 0.0
    for i in range(n):
        after = delta[i]
        delta[i] = np.log(before + likelihood[i]) - np.log(before + after)
        odds = np.exp(min(log_odds[i], MAX_LOG_ODDS))
        before = min(before * (1.0 + odds) + odds * likelihood[i], MAX_BEFORE)


@kernel
def cell_update(log_odds, likelihood, none_likelihood, n, cell):
    """Return what `ray_update` writes for one cell, without the others.

    `log_odds` and `likelihood` are (m,) scratch arrays of which the first `n` entries count.
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
