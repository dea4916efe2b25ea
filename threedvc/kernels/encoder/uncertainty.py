# SPDX-License-Identifier: MIT
"""Entropy of the evidence, block by block."""

from __future__ import annotations

import numpy as np

from threedvc.kernels import kernel

__all__ = ["block_entropies"]


@kernel
def block_entropies(numbers, start, stop, log_odds, color_weight, one_look, spread, entropies):
    """Write the entropy in bits of blocks ``numbers[start:stop]`` into `entropies` (blocks,) float64.

    A cell has the entropy of its occupancy, and of its colour as far as it is occupied: eight bits a
    channel before the first look, then those of a Gaussian whose deviation, `spread` levels after a look
    of weight `one_look`, falls with the root of the weight, and no less than none.
    """
    scale = 2.0 * np.pi * np.e * spread * spread * one_look
    for n in range(start, stop):
        b = numbers[n]
        total = 0.0
        for i in range(512):
            odds = abs(np.float64(log_odds[b, i]))
            tail = np.exp(-odds)
            total += (np.log1p(tail) + odds * tail / (1.0 + tail)) / np.log(2.0)
            occupied = 1.0 / (1.0 + np.exp(-np.float64(log_odds[b, i])))
            weight = np.float64(color_weight[b, i])
            channel = 8.0 if weight <= 0.0 else min(max(0.5 * np.log2(scale / weight), 0.0), 8.0)
            total += occupied * 3.0 * channel
        entropies[b] = total
