# SPDX-License-Identifier: MIT
"""Errors of depth: shares of pixels within limits, root mean squares."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["DepthErrors", "depth_units", "geman_mcclure_error", "geman_mcclure_errors", "shown_depth_error"]

ERROR_SCALE = 0.01
"""Of the depth: an error of 1 % counts a half (decision 0012)."""

NOWHERE_M = np.float32(1e6)
"""Depth that stands for what is missing, further than any measurement."""
MAX_DEPTH_UNITS = 65534
"""The largest depth of a 16-bit picture; the value beyond it is taken for no measurement."""
INVALID_UNITS = 65535
"""The largest value of 16 bits, with which many data sets say that there is no measurement."""
NEAR_MM = 10.0
"""Bound of a share that is reported beside that of 1 %: the same at 1 m."""
# Half a nanometer: keeps errors of exactly 10 mm inside whatever the depth unit is.
ROUNDING_MM = 5e-7


def geman_mcclure_error(pictures: Iterable[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> float:
    """Return how badly depths meet measurements, from 0 for exactly to 1, on an average over pairs of pictures.

    One per cent off counts a half. Pixels (n,) without the one or the other, 0, do not count.
    """
    misfits = []
    for found, measured in pictures:
        seen = (found > 0) & (measured > 0)
        if seen.any():
            squares = (found[seen] / measured[seen] - 1) ** 2
            misfits.append(float(np.mean(squares / (squares + ERROR_SCALE**2))))
    return float(np.mean(misfits)) if misfits else 0.0


def geman_mcclure_errors(shown: NDArray[np.float32], measured: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return how badly each pixel (h, w) meets what was measured there, from 0 to 1; 0 where nothing was measured."""
    seen = measured > 0
    squares = (np.where(shown > 0, shown, NOWHERE_M) / np.where(seen, measured, 1) - 1.0) ** 2
    return np.where(seen, squares / (squares + ERROR_SCALE**2), 0.0)


def shown_depth_error(pictures: Iterable[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> float:
    """Return the `geman_mcclure_error` of depths that are shown; where nothing is shown, it fits not at all."""
    return geman_mcclure_error((np.where(shown > 0, shown, NOWHERE_M), measured) for shown, measured in pictures)


def depth_units(depth: NDArray[np.float32], depth_scale: float) -> NDArray[np.uint16]:
    """Round a depth map to the units of a 16-bit depth picture.

    Parameters
    ----------
    depth
        float32 meters, 0 = no measurement.
    depth_scale
        Units per meter.

    Returns
    -------
    uint16, 0 = no measurement; depths that 16 bits cannot hold, and their saturated value 65535,
    count as no measurement.
    """
    units = np.rint(depth * np.float32(depth_scale))
    return np.where((units > 0) & (units <= MAX_DEPTH_UNITS), units, 0).astype(np.uint16)


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthErrors:
    """Errors of depth over any number of frames; add two of them to pool their pixels.

    Attributes
    ----------
    unit_mm
        Millimeters per unit of the depth pictures.
    histogram
        (65536,) int64, number of pixels by absolute error in units, where both depths are valid.
    within_1pct
        Pixels whose error is at most 1 % of the reference depth.
    valid, invalid
        Pixels with and without a reference depth.
    lost, invented
        Pixels valid only in the reference, and only in the decoded depth.
    """

    unit_mm: float
    histogram: NDArray[np.int64]
    within_1pct: int
    valid: int
    invalid: int
    lost: int
    invented: int

    @classmethod
    def measure(cls, reference: NDArray[np.uint16], decoded: NDArray[np.uint16], unit_mm: float) -> Self:
        """Compare two depth pictures (h, w) uint16 of one unit, 0 = no measurement."""
        known, drawn = reference > 0, decoded > 0
        both = known & drawn
        expected = reference[both].astype(np.int32)
        errors = np.abs(decoded[both].astype(np.int32) - expected)
        return cls(
            unit_mm=unit_mm,
            histogram=np.bincount(errors, minlength=INVALID_UNITS + 1).astype(np.int64),
            within_1pct=int(np.count_nonzero(100 * errors <= expected)),
            valid=int(np.count_nonzero(known)),
            invalid=int(np.count_nonzero(~known)),
            lost=int(np.count_nonzero(known & ~drawn)),
            invented=int(np.count_nonzero(drawn & ~known)),
        )

    def __add__(self, other: DepthErrors) -> DepthErrors:
        """Pool the pixels of both."""
        return DepthErrors(
            unit_mm=self.unit_mm,
            histogram=self.histogram + other.histogram,
            within_1pct=self.within_1pct + other.within_1pct,
            valid=self.valid + other.valid,
            invalid=self.invalid + other.invalid,
            lost=self.lost + other.lost,
            invented=self.invented + other.invented,
        )

    @property
    def lossless(self) -> bool:
        """Whether all pixels are equal."""
        return not (self.lost or self.invented or self.histogram[1:].any())

    @property
    def compared(self) -> int:
        """Number of pixels valid on both sides."""
        return self.valid - self.lost

    def rmse_mm(self) -> float:
        """Return the root mean square error over compared pixels; NaN without any."""
        units = np.arange(len(self.histogram), dtype=np.float64)
        total = float(self.histogram @ units**2)
        return self.unit_mm * float(np.sqrt(total / self.compared)) if self.compared else float("nan")

    def quantile_mm(self, fraction: float) -> float:
        """Return the least error that `fraction` of the compared pixels do not exceed; NaN without any."""
        if not self.compared:
            return float("nan")
        reached = np.cumsum(self.histogram) >= max(1.0, fraction * self.compared)
        return self.unit_mm * int(np.argmax(reached))

    def within_mm(self, limit_mm: float) -> float:
        """Return the fraction of reference pixels with an error up to a limit; a lost pixel is a miss."""
        units = int((limit_mm + ROUNDING_MM) / self.unit_mm)
        return _fraction(int(self.histogram[: units + 1].sum()), self.valid)

    def quality(self) -> dict[str, float]:
        """Return all depth measures under their names in the JSON report."""
        return {
            "depth_rmse_mm": self.rmse_mm(),
            "depth_median_mm": self.quantile_mm(0.5),
            "depth_within_10mm": self.within_mm(NEAR_MM),
            "depth_within_1pct": _fraction(self.within_1pct, self.valid),
            "depth_p99_mm": self.quantile_mm(0.99),
            "depth_max_mm": self.quantile_mm(1.0),
            "depth_lost": _fraction(self.lost, self.valid),
            "depth_invented": _fraction(self.invented, self.invalid),
        }


def _fraction(part: int, whole: int) -> float:
    return part / whole if whole else 0.0
