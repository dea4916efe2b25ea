# SPDX-License-Identifier: MIT
"""Entropy of a model: the sum over its cells of H(occupancy) + H(colour), in bits.

The colour of an empty cell means nothing, so H(colour) counts with the probability that the cell is
occupied (the chain rule of the joint entropy). Blocks that a frame did not touch keep their value.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.uncertainty import block_entropies
from threedvc.object_model import EvidenceModel
from threedvc.parallel import for_ranges

__all__ = ["EntropyMeter"]

LOOK_SPREAD = 8.0
LOOK_WEIGHT = 0.25


class EntropyMeter:
    """Keeps the entropy of one model.

    Parameters
    ----------
    model
        The evidence to measure.
    """

    def __init__(self, model: EvidenceModel) -> None:
        self._model = model
        self._entropies = np.zeros(0)

    @property
    def bits(self) -> float:
        """Entropy of the whole model."""
        return float(self._entropies.sum())

    def update(self, numbers: NDArray[np.int64], threads: int) -> None:
        """Measure blocks `numbers` (n,) again."""
        model = self._model
        if model.index.count > len(self._entropies):
            self._entropies = np.concatenate([self._entropies, np.zeros(model.index.count - len(self._entropies))])
        entropies = self._entropies

        def measure(start: int, stop: int) -> None:
            block_entropies(
                numbers, start, stop, model.log_odds, model.color_weight, LOOK_WEIGHT, LOOK_SPREAD, entropies
            )

        for_ranges(measure, len(numbers), threads)
