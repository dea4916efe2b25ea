# SPDX-License-Identifier: MIT
"""Fresh models for the mixing kernels."""

from __future__ import annotations

import numpy as np

from threedvc.kernels.coding.mixing import Mixer
from threedvc.kernels.coding.range_coder import COUNTER_START

__all__ = ["new_mixer"]

TABLE_BITS = 16
"""Binary logarithm of the counters of a context. Part of the format (docs/coding.md), as the next."""
ONE = 65536
"""The weight 1."""


def new_mixer(models: int, sets: int, rows: int, first_weights: tuple[float, ...] = (0.3, 0.0)) -> Mixer:
    """Return a mixer that has seen nothing.

    Parameters
    ----------
    models
        Number of contexts.
    sets, rows
        Number of weight sets and of rows in each.
    first_weights
        First weight of every context, then those of the further inputs.
    """
    per_input = [first_weights[0]] * models + list(first_weights[1:])
    weights = np.empty((sets, rows, len(per_input)), dtype=np.int32)
    weights[:] = [int(weight * ONE) for weight in per_input]
    return Mixer(
        contexts=np.zeros(models, dtype=np.int64),
        selectors=np.zeros(sets, dtype=np.int64),
        tables=np.full((models, 1 << TABLE_BITS), COUNTER_START, dtype=np.uint32),
        weights=weights,
        inputs=np.zeros(len(per_input), dtype=np.int64),
        opinions=np.zeros(sets, dtype=np.int64),
    )
