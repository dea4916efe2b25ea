# SPDX-License-Identifier: MIT
"""Sensor models p(r|z): how a depth sensor's reading scatters around the true depth (sec. 2.3).

The reading is Gaussian around the depth of the nearest occupied cell, or an outlier with a small
probability. The axial deviation is a polynomial in depth plus the rounding of the disparity:

    sigma(z)^2 = (s0 + s1 z + s2 z^2)^2 + (q z^2)^2 / 12

A surface lies anywhere within its cell, so the ray sum adds the variance of a uniform distribution
over the cell, ``h^2 / 12``. Likelihoods are taken relative to the peak of the Gaussian; the outlier
weight is relative to it as well, so it follows the evidence near the measured range instead of
standing as a constant against a product of thousands of priors (which would let the exact sum
explain every far reading as an outlier).

Which sensor it was is guessed from the first frame, and held against what later frames measure of the model: depth
that was smoothed before anybody saw it looks clean, and yet differs from frame to frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.config import Sensor
from threedvc.errors import ConfigError

__all__ = ["SENSORS", "SensorModel", "chosen_sensor", "guess_sensor"]

MAX_IDEAL_ROUGHNESS = 0.001
"""Per meter: what rounding to millimeters leaves at 1 m; the disparity steps of a Kinect are three times as rough."""
MIN_SMOOTH_PIXELS = 100
"""Fewer do not tell a quantile."""
WORST_SIGMA_M = 0.1
"""What is known no better than to a decimeter is no basis for a model."""
MAX_REACH_M = 1000.0
"""Where the search for that depth ends: the noise of an ideal sensor never grows so far."""


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """A depth sensor.

    Parameters
    ----------
    s0_m, s1, s2_per_m
        Axial deviation ``s0 + s1 z + s2 z^2`` in meters at depth z in meters.
    quantum_per_m
        Rounding step in meters at 1 m; it grows as z^2 (disparity sensors).
    outlier
        Likelihood of an outlying reading, relative to the Gaussian's peak; a fiftieth by hand: with less, one wrong
        reading outweighs many right ones, with more surfaces are slow to be believed.
    """

    s0_m: float = 0.0
    s1: float = 0.0
    s2_per_m: float = 0.0
    quantum_per_m: float = 0.0
    outlier: float = 0.02

    def __post_init__(self) -> None:
        if min(self.s0_m, self.s1, self.s2_per_m, self.quantum_per_m) < 0 or not 0 < self.outlier < 1:
            raise ConfigError(
                f"sensor model {self} must have non-negative deviations and an outlier weight within 0..1"
            )

    def sigma_m(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the axial deviations in meters at depths `z` in meters, of any shape."""
        axial = self.s0_m + z * (self.s1 + z * self.s2_per_m)
        return np.asarray(np.sqrt(axial * axial + (self.quantum_per_m * z * z) ** 2 / 12), dtype=np.float64)

    @property
    def reach_m(self) -> float:
        """The depth up to which a measurement is good to 0.1 m; what lies beyond is no basis for a model."""
        depths = np.arange(0.1, MAX_REACH_M, 0.1)
        return float(depths[self.sigma_m(depths) <= WORST_SIGMA_M].max(initial=0.1))

    def parameters(self) -> NDArray[np.float64]:
        """Return ``s0, s1, s2, q, outlier`` for the kernels."""
        return np.array([self.s0_m, self.s1, self.s2_per_m, self.quantum_per_m, self.outlier])


SENSORS = {
    Sensor.IDEAL: SensorModel(s0_m=0.0003),
    Sensor.KINECT1: SensorModel(s2_per_m=0.0012, quantum_per_m=0.0029),
    Sensor.REALSENSE: SensorModel(s0_m=0.001, s2_per_m=0.0025, quantum_per_m=0.002, outlier=0.05),
    Sensor.LIDAR: SensorModel(s0_m=0.004, s1=0.002),
}
"""Ideal: the rounding to millimeters, 1 mm / sqrt(12). Kinect 1: 1.2 mm and steps of 2.9 mm at 1 m, which grow as z^2
(an eighth of a pixel of disparity, see `threedvc.synthesis.noise`). RealSense: stereo too, noisier, with more outliers;
lidar: mostly the same at every depth. These two are round values set by hand; decision 0027 compares all four."""


def guess_sensor(depth: NDArray[np.float32]) -> Sensor:
    """Tell a noise-free depth map from a noisy one by its roughness.

    Parameters
    ----------
    depth
        (height, width) float32 meters, 0 = no measurement.

    Returns
    -------
    Sensor
        IDEAL where three quarters of the second differences along rows, over depth squared, are at the
        level of rounding; edges and curved surfaces make up the rest. Else KINECT1.
    """
    left, middle, right = depth[:, :-2], depth[:, 1:-1], depth[:, 2:]
    bend = np.abs(left - 2 * middle + right)
    smooth = (left > 0) & (middle > 0) & (right > 0) & (bend < 0.05 * middle)
    if np.count_nonzero(smooth) < MIN_SMOOTH_PIXELS:
        return Sensor.KINECT1
    roughness = float(np.quantile(bend[smooth] / middle[smooth] ** 2, 0.75))
    return Sensor.IDEAL if roughness < MAX_IDEAL_ROUGHNESS else Sensor.KINECT1


def chosen_sensor(asked: Sensor, depth: NDArray[np.float32]) -> SensorModel:
    """Return the model of the sensor asked for, or of the one that a depth map (h, w) in meters looks like."""
    return SENSORS[guess_sensor(depth) if asked is Sensor.AUTO else asked]
