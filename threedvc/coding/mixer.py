# SPDX-License-Identifier: MIT
"""Fresh models for the mixing kernels."""

from __future__ import annotations

import numpy as np

from threedvc.kernels.entropy import COUNTER_START
from threedvc.kernels.mixing import Mixer

__all__ = ["new_mixer"]

TABLE_BITS = 16
FIRST_WEIGHT = 3 * 65536 // 10


def new_mixer(models: int, sets: int, rows: int) -> Mixer:
    """Return a mixer that knows nothing: `models` contexts and a constant, `sets` weight sets of `rows` each."""
    weights = np.full((sets, rows, models + 1), FIRST_WEIGHT, dtype=np.int32)
    weights[:, :, models:] = 0
    return Mixer(
        contexts=np.zeros(models, dtype=np.int64),
        selectors=np.zeros(sets, dtype=np.int64),
        tables=np.full((models, 1 << TABLE_BITS), COUNTER_START, dtype=np.uint32),
        weights=weights,
        inputs=np.zeros(models + 1, dtype=np.int64),
        opinions=np.zeros(sets, dtype=np.int64),
    )
