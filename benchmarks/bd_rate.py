# SPDX-License-Identifier: MIT
"""Compare rate-distortion curves: rate at equal quality, and the Bjontegaard difference of rates.

A curve is interpolated as log rate over quality by monotone piecewise cubics (Fritsch and Butland 1984), so that
it neither swings between points nor leaves their range.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["Curve", "bd_rate", "geometric_mean"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Curve:
    """Rate of a codec as a function of quality.

    Attributes
    ----------
    qualities
        (n,) increasing; larger is better.
    log_rates
        (n,) increasing, natural logarithms of rates in any unit.
    slopes
        (n,) derivatives of the interpolation at the points.
    """

    qualities: Floats
    log_rates: Floats
    slopes: Floats

    @classmethod
    def hull(cls, points: Iterable[tuple[float, float]]) -> Self:
        """Join the points (rate, quality) that no mixture of others beats: their upper convex hull.

        Raises
        ------
        ValueError
            If there is no point, or one has a rate of zero or less.
        """
        best = _upper_hull(sorted(set(points)))
        rates = np.array([rate for rate, _ in best])
        if not best or rates[0] <= 0:
            raise ValueError("a curve needs points, and all of them rates above zero")
        qualities = np.array([quality for _, quality in best])
        return cls(qualities, np.log(rates), _monotone_slopes(qualities, np.log(rates)))

    @property
    def lowest(self) -> float:
        """Quality at the smallest rate."""
        return float(self.qualities[0])

    @property
    def highest(self) -> float:
        """Quality at the largest rate."""
        return float(self.qualities[-1])

    def log_rate(self, quality: Floats) -> Floats:
        """Interpolate at qualities within `lowest` and `highest`."""
        if len(self.qualities) == 1:
            return np.full_like(quality, self.log_rates[0])
        k = np.clip(np.searchsorted(self.qualities, quality, side="right") - 1, 0, len(self.qualities) - 2)
        width = self.qualities[k + 1] - self.qualities[k]
        t = (quality - self.qualities[k]) / width
        start, stop = self.log_rates[k], self.log_rates[k + 1]
        bend = width * ((1 - t) * self.slopes[k] - t * self.slopes[k + 1])
        return np.asarray(start + t**2 * (3 - 2 * t) * (stop - start) + t * (1 - t) * bend)

    def rate(self, quality: float) -> float | None:
        """Return the rate that reaches a quality: that of the first point below the curve, None above it."""
        if quality > self.highest:
            return None
        return float(np.exp(self.log_rate(np.array([max(quality, self.lowest)]))[0]))


def _upper_hull(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the points of the upper convex hull, quality over rate, as far as quality increases."""
    hull: list[tuple[float, float]] = []
    for point in points:
        if hull and point[1] <= hull[-1][1]:
            continue
        if hull and point[0] == hull[-1][0]:
            hull.pop()
        while len(hull) > 1 and _gain(hull[-2], hull[-1]) <= _gain(hull[-1], point):
            hull.pop()
        hull.append(point)
    return hull


def _gain(cheap: tuple[float, float], dear: tuple[float, float]) -> float:
    return (dear[1] - cheap[1]) / (dear[0] - cheap[0])


def _monotone_slopes(x: Floats, y: Floats) -> Floats:
    """Return the derivatives (n,) of the monotone cubic interpolation of increasing values `y` at `x`."""
    if len(x) < 3:
        return np.full(len(x), (y[-1] - y[0]) / (x[-1] - x[0]) if len(x) == 2 else 0.0)
    width, rise = np.diff(x), np.diff(y) / np.diff(x)
    near, far = 2 * width[1:] + width[:-1], width[1:] + 2 * width[:-1]
    inner = (near + far) / (near / rise[:-1] + far / rise[1:])
    return np.array([_end_slope(width, rise), *inner, _end_slope(width[::-1], rise[::-1])])


def _end_slope(width: Floats, rise: Floats) -> float:
    """Return the slope of the parabola through three points at the first of them, held within what is monotone."""
    slope = ((2 * width[0] + width[1]) * rise[0] - width[0] * rise[1]) / (width[0] + width[1])
    return float(np.clip(slope, 0, 3 * rise[0]))


def bd_rate(reference: Curve, tested: Curve) -> float | None:
    """Return by how many percent the rate of one curve differs from another at equal quality, on average.

    The mean is one of log rates over the qualities that both curves reach (Bjontegaard 2001); negative means
    that the tested curve needs less. None where no range of qualities is common.
    """
    low, high = max(reference.lowest, tested.lowest), min(reference.highest, tested.highest)
    if low >= high:
        return None
    knots = np.unique([low, high, *reference.qualities, *tested.qualities])
    knots = knots[(knots >= low) & (knots <= high)]
    middles = (knots[1:] + knots[:-1]) / 2
    ends, centers = (tested.log_rate(at) - reference.log_rate(at) for at in (knots, middles))
    # Simpson's rule is exact: between two knots both curves are cubics.
    area = np.sum(np.diff(knots) * (ends[:-1] + 4 * centers + ends[1:]) / 6)
    return 100 * float(np.expm1(area / (high - low)))


def geometric_mean(ratios: Sequence[float]) -> float | None:
    """Return the geometric mean of positive numbers; None of none."""
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else None
