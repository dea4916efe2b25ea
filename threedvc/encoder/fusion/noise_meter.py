# SPDX-License-Identifier: MIT
"""Which sensor scatters as a sensor's first frames do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.config import Sensor
from threedvc.frames.sensor_model import SENSORS, SensorModel

__all__ = ["NoiseMeter"]

STRAY_SHARE, STRAY_DENSITY_PER_M = 0.05, 1.0
"""Measurements that have nothing to do with the model, and their density: anywhere within a meter. By hand: they keep a
few from deciding."""
MUCH_LIKELIER = 0.6
"""Logarithm of how many times as likely another sensor must make a pixel: errors of poses look like noise, too.
Measured: it stands between fr1_rpy's 0.37, errors of poses, and iphone_door's 1.77, noise (decision 0027)."""
MIN_METERED_FRAMES, MIN_METERED_PIXELS = 3, 300
"""One frame may have a wrong pose, and a few hundred pixels may all lie on one thing."""


class NoiseMeter:
    """Holds what was measured against what a model shows, to tell if a sensor scatters more than was thought.

    Attributes
    ----------
    frames
        How many frames told something.
    """

    def __init__(self) -> None:
        self.frames = 0
        self._pixels = 0
        self._log_likelihoods = dict.fromkeys(SENSORS, 0.0)
        self._sigmas_m = dict.fromkeys(SENSORS, 0.0)

    def add(self, shown: NDArray[np.float32], measured: NDArray[np.float32], voxel_size_m: float) -> None:
        """Take in a frame.

        Parameters
        ----------
        shown, measured
            Depths of the same shape in meters, 0 = none. The model should not hold this frame alone.
        voxel_size_m
            Edge of the model's cells: a surface lies anywhere within them.
        """
        both = (shown > 0) & (measured > 0)
        depth = measured[both].astype(np.float64)
        if len(depth) < MIN_METERED_PIXELS:
            return
        residual = shown[both] - depth
        self.frames += 1
        self._pixels += len(depth)
        for sensor, model in SENSORS.items():
            sigma = np.sqrt(model.sigma_m(depth) ** 2 + voxel_size_m**2 / 12)
            self._sigmas_m[sensor] += float(sigma.sum())
            density = np.exp(-0.5 * (residual / sigma) ** 2) / (np.sqrt(2 * np.pi) * sigma)
            likelihood = (1 - STRAY_SHARE) * density + STRAY_SHARE * STRAY_DENSITY_PER_M
            self._log_likelihoods[sensor] += float(np.log(likelihood).sum())

    def likelier_sensor(self, model: SensorModel) -> Sensor | None:
        """Return the noisier sensor that makes measurements much likelier than a model does; None if there is none."""
        now = next(sensor for sensor, each in SENSORS.items() if each is model)
        noisier = [sensor for sensor in SENSORS if self._sigmas_m[sensor] > self._sigmas_m[now]]
        if self.frames < MIN_METERED_FRAMES or not noisier:
            return None
        best = max(noisier, key=lambda sensor: self._log_likelihoods[sensor])
        gain = self._log_likelihoods[best] - self._log_likelihoods[now]
        return best if gain > MUCH_LIKELIER * self._pixels else None
