# SPDX-License-Identifier: MIT
"""Labels of a frame without a mask, by what the models of the objects show."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.registration.frame_resolutions import Downsampled
from threedvc.encoder.registration.model_view import raycast_model
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.pose import Pose

__all__ = ["predicted_labels"]

GATE_SIGMAS = 4
"""Depth within so many deviations of a model's is taken for its; the rest of the noise is cut, not the object."""
GATE_SHARE = 0.03
"""Share of the depth that a predicted pose may be off by."""


def predicted_labels(
    depth: NDArray[np.float32],
    resolution: Downsampled,
    sensor: SensorModel,
    models: Iterable[tuple[int, EvidenceModel, Pose]],
    threads: int,
) -> NDArray[np.uint8]:
    """Return the number (h, w) of the object whose model meets the depth best, 0 where none does.

    Parameters
    ----------
    depth
        (h, w) meters.
    resolution
        The full one of the sensor.
    sensor
        Noise of its depth.
    models
        Number, evidence and expected T_rig_object of each object.
    threads
        Number of threads.
    """
    labels = np.zeros(depth.shape, dtype=np.uint8)
    gate = GATE_SIGMAS * sensor.sigma_m(depth.astype(np.float64)) + GATE_SHARE * depth
    nearest = np.full(depth.shape, np.inf)
    for number, evidence, T_rig_object in models:
        view = raycast_model(evidence, resolution, resolution.rig.at_sensor(T_rig_object), threads).depth
        residual = np.where(depth > 0, np.abs(depth - view), 0)
        mine = (view > 0) & (residual <= gate) & (residual < nearest)
        labels[mine], nearest[mine] = number, residual[mine]
    return labels
