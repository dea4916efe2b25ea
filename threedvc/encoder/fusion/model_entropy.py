# SPDX-License-Identifier: MIT
"""Entropy of a model: the sum over its cells of H(occupancy) + H(color), in bits.

The color of an empty cell means nothing, so H(color) counts with the probability that the cell is
occupied (the chain rule of the joint entropy). Blocks that a frame did not touch keep their value.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.kernels.encoder.uncertainty import block_entropies
from threedvc.parallel import for_ranges

__all__ = ["UNKNOWN_BITS", "EntropyMeter", "channel_bits", "cross_entropy_bits"]

LOOK_SPREAD = 8.0
"""Levels by which the color of one look deviates: noise of the camera, shading and blur together; by hand."""
LOOK_WEIGHT = 0.25
"""Color weight of that look: one from 2 m (weights go with the inverse square of the depth)."""
UNKNOWN_BITS = 8.0
"""Entropy of a color channel before the first look: any of 256 levels."""


def channel_bits(weight: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the entropy in bits of a color channel of cells with color weights (n,), as the meter counts it."""
    with np.errstate(divide="ignore"):
        bits = 0.5 * np.log2(2 * np.pi * np.e * LOOK_SPREAD**2 * LOOK_WEIGHT / np.maximum(weight, 0, dtype=np.float64))
    return np.asarray(np.clip(bits, 0, UNKNOWN_BITS))


def cross_entropy_bits(residual: NDArray[np.floating], weight: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the cross-entropy in bits of a channel against a belief with another mean.

    The belief has the deviation of one look; one whose residual is large costs as many bits as none.

    Parameters
    ----------
    residual
        (...) levels by which the believed mean differs from the evidence's.
    weight
        (...) color weight of the evidence.
    """
    believed = LOOK_SPREAD**2
    with np.errstate(divide="ignore"):
        variance = believed * LOOK_WEIGHT / np.maximum(weight, 0, dtype=np.float64)
    square = variance + np.square(residual, dtype=np.float64)
    bits = 0.5 * np.log2(2 * np.pi * believed) + square / (2 * np.log(2) * believed)
    return np.asarray(np.minimum(bits, UNKNOWN_BITS))


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
