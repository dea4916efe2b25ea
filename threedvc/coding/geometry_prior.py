# SPDX-License-Identifier: MIT
"""Weights of the network that guesses geometry; see `threedvc.kernels.coding.geometry_prior`."""

from __future__ import annotations

import base64
from functools import cache

import numpy as np

from threedvc.coding.entropy.prior_weights import OUTPUT_BIAS, WEIGHTS
from threedvc.kernels.coding.geometry_prior import FEATURES, HIDDEN, Prior

__all__ = ["geometry_prior"]


@cache
def geometry_prior() -> Prior:
    """Return the trained network."""
    rows = np.frombuffer(base64.b85decode(WEIGHTS), dtype=np.int8).reshape(-1, HIDDEN).astype(np.int32)
    return Prior(inputs=rows[:FEATURES], biases=rows[FEATURES:-1], outputs=rows[-1], output_bias=OUTPUT_BIAS)
