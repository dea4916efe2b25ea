# SPDX-License-Identifier: MIT
"""The weights with which depth is predicted from what is around it, as an encoder finds them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.coding.depth_prediction import BORDER, NEAR_TAPS, TAPS, WEIGHT_BITS, add_products
from threedvc.parallel import for_ranges

__all__ = ["MAX_WEIGHT", "WeightFit"]

MAX_WEIGHT = 1 << 14
"""Of a tap, either sign: 32 times the whole. Part of the format (docs/coding.md)."""
FIT_SPACING = 5
"""Every how many pixels are looked at: all of them make no payload smaller."""
FIT_ROWS = 64
"""Rows that are summed in one piece."""
RIDGE = 1 / 1024
"""Part of the energy of the depths that holds the weights of taps without use at zero. More costs 1 to 10 %."""


class WeightFit:
    """The weights of predictions, fitted to the filmed depths of frames so far.

    New ones are found at the first frame, the first with something ahead, and when their number has doubled.
    """

    def __init__(self) -> None:
        self.weights = np.zeros(TAPS, dtype=np.int64)
        self.products = np.zeros((TAPS + 1, TAPS + 1), dtype=np.int64)
        self.frames, self.due = 0, 1

    def update(
        self,
        filmed: NDArray[np.int32],
        ahead: NDArray[np.int32],
        before: NDArray[np.int32],
        first: bool,
        threads: int,
    ) -> NDArray[np.int64] | None:
        """Return new weights for a frame, or None if they stay.

        `filmed` (h, w) holds the places in the table of its depths, 0 for none; the others have a border.
        """
        self.frames += 1
        if self.frames < self.due and not first:
            return None
        present = filmed > 0
        levels = np.pad(filmed, BORDER, mode="edge")
        starts = list(range(0, len(filmed), FIT_ROWS))
        parts = np.zeros((len(starts), *self.products.shape), dtype=np.int64)

        def work(a: int, b: int) -> None:
            for k in range(a, b):
                last = min(starts[k] + FIT_ROWS, len(filmed))
                add_products(levels, ahead, before, present, FIT_SPACING, parts[k], starts[k], last)

        for_ranges(work, len(starts), threads)
        found = parts.sum(axis=0)
        taps = NEAR_TAPS if first else TAPS
        if not first:
            self.products += found
            found, self.due = self.products, 2 * self.frames
        self.weights = _solved(found, taps)
        if first:
            self.frames, self.due = 0, 1
        return self.weights


def _solved(products: NDArray[np.int64], taps: int) -> NDArray[np.int64]:
    """Return the weights of the first taps that leave the least squared error."""
    whole = np.triu(products, 1).T + np.triu(products)
    ridge = RIDGE * (1 + whole[TAPS, TAPS])
    matrix = whole[:taps, :taps] + np.eye(taps) * ridge
    weights = np.zeros(TAPS, dtype=np.int64)
    found = np.linalg.solve(matrix, whole[:taps, TAPS].astype(np.float64))
    weights[:taps] = np.clip(np.rint(found * (1 << WEIGHT_BITS)), -MAX_WEIGHT, MAX_WEIGHT)
    return weights
