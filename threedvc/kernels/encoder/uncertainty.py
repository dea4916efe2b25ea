# SPDX-License-Identifier: MIT
"""Entropy of the evidence, block by block."""

from __future__ import annotations

import numpy as np

from threedvc.kernels import kernel
from threedvc.kernels.blocks import BLOCK_CELLS

__all__ = ["block_entropies"]

MAX_CHANNEL_BITS = 8.0
"""Entropy of a channel of 256 levels of which nothing is known."""


@kernel
def block_entropies(numbers, start, stop, log_odds, color_weight, one_look, spread, entropies):
    """Write the entropy in bits of blocks ``numbers[start:stop]`` into `entropies` (blocks,) float64.

    A cell has the entropy of its occupancy, and of its color as far as it is occupied: eight bits a
    channel before the first look, then those of a Gaussian whose deviation, `spread` levels after a look
    of weight `one_look`, falls with the root of the weight, and no less than none.
    """
    scale = 2.0 * np.pi * np.e * spread * spread * one_look
    for n in range(start, stop):
        b = numbers[n]
        total = 0.0
        for i in range(BLOCK_CELLS):
            odds = abs(np.float64(log_odds[b, i]))
            tail = np.exp(-odds)
            total += (np.log1p(tail) + odds * tail / (1.0 + tail)) / np.log(2.0)
            occupied = 1.0 / (1.0 + np.exp(-np.float64(log_odds[b, i])))
            weight = np.float64(color_weight[b, i])
            channel = MAX_CHANNEL_BITS
            if weight > 0.0:
                channel = min(max(0.5 * np.log2(scale / weight), 0.0), MAX_CHANNEL_BITS)
            total += occupied * 3.0 * channel
        entropies[b] = total
