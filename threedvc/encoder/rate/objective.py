# SPDX-License-Identifier: MIT
"""The one number by which streams and choices are compared, and what bytes are worth in it.

The objective is the mean over frames of ``ln(mean squared error of colors + 1)`` plus `DEPTH_WEIGHT` times the depth's
misfit, which is 0 where depth is exact, a half where it is 1 % off, and 1 where it is wrong or missing
(`threedvc.metrics.depth_errors.shown_depth_error`). Bytes go where they lower it most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log

import numpy as np

__all__ = ["DEPTH_WEIGHT", "MIN_SLOPE", "ColorCost", "objective"]

DEPTH_WEIGHT = 14.0
"""Measured (decision 0033): a hundredth of the misfit, about a hundredth of the pixels within 1 %, is worth 0.6 dB."""
MIN_SLOPE = 0.3
"""By how much the logarithm of the error of a video rises at least as that of its bytes falls. Measured: 0.5 to 0.9."""
STARVED_SLOPE = 3.0
"""The same where a video would have fewer bytes than its coarsest one takes: then nothing else is worth them."""
MIN_LEFT = 0.02
"""Share of the bytes that is taken to be left at least, so that the logarithm stays finite."""


def objective(color_error: float, misfit: float, depth_weight: float) -> float:
    """Return the objective of an error of colors and a misfit of depth; `depth_weight` is 1 unless one is favored."""
    return color_error + DEPTH_WEIGHT * depth_weight * misfit


@dataclass(frozen=True)
class ColorCost:
    """How the error of a color video rises with the bytes that other things take.

    Attributes
    ----------
    sizes, errors
        Bytes of two videos or more, ascending if there is a budget, and the mean logarithms of their squared errors.
    budget_bytes
        What the stream may take; None: the first video stays as it is, and bytes beside it cost what it would gain by
        as many more.
    coarsest_bytes
        What the coarsest video takes; 0: not known.
    """

    sizes: Sequence[float]
    errors: Sequence[float]
    budget_bytes: float | None = None
    coarsest_bytes: float = 0.0

    @classmethod
    def of_slope(cls, size: float, slope: float, *, fixed: bool) -> ColorCost:
        """Return the costs beside colors of which a doubling of all bytes takes ``slope ln 2`` off the error.

        `fixed` tells whether `size` is all that there is; else other bytes are added to it.
        """
        return cls((size, 2 * size), (0.0, -slope * log(2)), size if fixed else None)

    def beside(self, spent_bytes: float) -> ColorCost:
        """Return the costs of what comes on top of so many bytes."""
        return self if self.budget_bytes is None else replace(self, budget_bytes=self.budget_bytes - spent_bytes)

    def at(self, spent_bytes: float) -> float:
        """Return the error of colors, or what counts for it, if other things take so many bytes."""
        if self.budget_bytes is None:
            return self.errors[0] + self._slope(0) * log(1 + spent_bytes / self.sizes[0])
        return self._error(max(self.budget_bytes - spent_bytes, MIN_LEFT * abs(self.budget_bytes), 1.0))

    def _error(self, size: float) -> float:
        """Return the error of a video of a size, linear in logarithms between those known and beyond them."""
        if self.coarsest_bytes and size < self.coarsest_bytes:
            return self._error(self.coarsest_bytes) + STARVED_SLOPE * log(self.coarsest_bytes / size)
        known = int(np.clip(np.searchsorted(self.sizes, size) - 1, 0, len(self.sizes) - 2))
        return self.errors[known] - self._slope(known) * log(size / self.sizes[known])

    def _slope(self, known: int) -> float:
        """Return the fall of the error over the rise of the logarithm of bytes from one of the videos to the next."""
        fall = self.errors[known] - self.errors[known + 1]
        rise = log(self.sizes[known + 1] / self.sizes[known])
        return max(fall / rise, MIN_SLOPE) if rise else MIN_SLOPE
