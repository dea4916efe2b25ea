# SPDX-License-Identifier: MIT
"""Samples of a frame associated with what a view shows at their pixels, and the residuals between the two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Mask
from threedvc.encoder.registration.frame_samples import Samples
from threedvc.encoder.registration.registration_types import RegistrationConfig
from threedvc.kernels.encoder import registration as kernels

__all__ = ["TUKEY_BOUND", "Associations", "measure_associations", "median_of_known"]

TUKEY_BOUND = 4.685
"""Standard deviations beyond which a residual has no weight: 95 % as good as least squares on Gaussian noise."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian noise over the median of its absolute values."""
MEDIAN_SAMPLES = 2048
"""So many give a median to some percent of the scatter."""
MIN_DEPTH_SCALE = 0.5
"""Residuals of depth that scatter by less than this part of the sensor's noise do so by chance."""
MAX_DEPTH_SCALE = 2.0
"""Beyond so many times the sensor's noise, depth fits badly and its weight no longer falls."""
INLIER_SIGMAS = 3.0
"""Distance of a sample that fits, in sigmas of its depth: all but the tail of the noise."""
INLIER_DEPTH = 0.01
"""The same in parts of the depth: sensors bend by as much."""
INLIER_M = 0.005
"""Real sensors are wrong by some millimeters however smooth their depth and however near the surface."""
INLIER_LUMA = 30.0
"""Levels by which the luma of a sample that fits may differ: more is another thing, not its shading."""
DISTANCE, LUMA = 6, 10
"""Columns of a row of `kernels.associate`: the distance to the view's plane and the view's luma."""


@dataclass(frozen=True, eq=False)
class Associations:
    """Samples associated at one pose, with measured scales and exposure.

    Attributes
    ----------
    samples
        The samples (n) of the frame.
    rows, states
        (n, 11) and (n,) of `kernels.associate`.
    scales
        (4,) scale of depth residuals in sigmas, of luma residuals in levels; weights of depth and luma.
    exposure
        (2,) gain and offset of the frame's luma.
    """

    samples: Samples
    rows: Doubles
    states: NDArray[np.uint8]
    scales: Doubles
    exposure: Doubles

    @property
    def count(self) -> int:
        """Number of samples that meet the view's surface."""
        return int(np.count_nonzero(self.states == kernels.FITTING))

    @property
    def residual_m(self) -> float:
        """Robust standard deviation of the distance to the view's surface."""
        return MAD_TO_SIGMA * median_of_known(np.abs(self.rows[:, DISTANCE]), np.inf)

    @property
    def inliers(self) -> Mask:
        """Which samples (n,) lie on the view's surface and do not contradict its luma."""
        by_sigma, by_depth = INLIER_SIGMAS * self.samples.sigma, INLIER_DEPTH * self.samples.surface[:, 2]
        bound = np.maximum(np.maximum(by_sigma, by_depth), INLIER_M)
        dark_or_bright = np.abs(self._luma_residuals()) > INLIER_LUMA
        return (np.abs(self.rows[:, DISTANCE]) <= bound) & ~dark_or_bright

    def costs(self, scales: Doubles) -> Doubles:
        """Return the robust cost of every sample (n,) under given scales, NaN where it does not meet the surface."""
        luma = np.nan_to_num(_tukey_cost(self._luma_residuals() / scales[1]), nan=0.0)
        depth = _tukey_cost(self.rows[:, DISTANCE] / (scales[0] * self.samples.sigma))
        cost: Doubles = scales[2] * depth + scales[3] * luma
        return cost

    def _luma_residuals(self) -> Doubles:
        expected: Doubles = self.exposure[0] * (self.samples.luma - kernels.LUMA_CENTER) + self.exposure[1]
        return self.rows[:, LUMA] - expected


def measure_associations(
    rows: Doubles, states: NDArray[np.uint8], samples: Samples, exposure: Doubles | None, config: RegistrationConfig
) -> Associations:
    """Measure the exposure of associated samples, if there is none yet, and the scales of both residuals."""
    some = slice(None, None, max(1, len(rows) // MEDIAN_SAMPLES))
    level, luma = samples.luma[some] - kernels.LUMA_CENTER, rows[some, LUMA]
    if exposure is None:
        exposure = np.array([1.0, median_of_known(luma - level, kernels.LUMA_CENTER)])
    depth_scale = MAD_TO_SIGMA * median_of_known(np.abs(rows[some, DISTANCE]) / samples.sigma[some], 1.0)
    luma_scale = MAD_TO_SIGMA * median_of_known(np.abs(luma - exposure[0] * level - exposure[1]), 0.0)
    depth_scale, luma_scale = max(depth_scale, MIN_DEPTH_SCALE), max(luma_scale, config.luma_noise)
    # Depth that fits badly must not hand the pose over to luma, or its residuals would grow.
    depth_weight = max(1.0, depth_scale / MAX_DEPTH_SCALE) ** 2
    scales = np.array([depth_scale, luma_scale, depth_weight, config.luma_weight])
    return Associations(samples, rows, states, scales, exposure)


def median_of_known(values: Doubles, default: float) -> float:
    """Return the median of the finite values, or a default where there are none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else default


def _tukey_cost(residuals: Doubles) -> Doubles:
    inside = np.clip(1 - (residuals / TUKEY_BOUND) ** 2, 0, 1)
    cost: Doubles = (1 - inside**3) * (TUKEY_BOUND**2 / 6)
    return cost
