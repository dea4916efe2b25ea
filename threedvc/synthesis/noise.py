# SPDX-License-Identifier: MIT
"""What a depth sensor makes of exact depth.

The Kinect-1 model: disparity ``d = f b / z`` with ``f b = 580 px * 0.075 m`` gets Gaussian noise and is
rounded to 1/8 px, so that the axial error grows as z^2 (1.2 mm at 1 m); nothing is measured outside
0.4..6 m, where the projector's light does not arrive, and at random pixels about depth discontinuities.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

__all__ = ["KINECT_PROJECTOR_M", "Noise", "kinect_depth", "quantized_depth"]

KINECT_PROJECTOR_M = (0.075, 0.0, 0.0)
"""To the right of the depth camera: its baseline."""
FOCAL_BASELINE_PX_M = 580 * KINECT_PROJECTOR_M[0]
"""Of the depth camera, whose focal length is 580 pixels."""
DISPARITY_SIGMA_PX = 0.0522
"""1.2 mm at 1 m."""
DISPARITY_STEP_PX = 0.125
"""An eighth of a pixel, as the sensor rounds: 2.9 mm at 1 m."""
NEAR_M, FAR_M = 0.4, 6.0
"""Between which the projector's light is seen."""
EDGE_RATIO = 0.04
"""Of the depth, within 3x3 pixels: a step, not a slope."""
EDGE_DROPOUT = 0.05
"""Share of the pixels at edges without a measurement; by taste, so that outlines are ragged."""


class Noise(StrEnum):
    """The depth sensor of a synthetic sequence."""

    IDEAL = "ideal"
    KINECT = "kinect"


def quantized_depth(depth: NDArray[np.float64], depth_scale: float) -> NDArray[np.float32]:
    """Round depth in meters to whole units of a 16-bit picture; what does not fit becomes 0.

    Parameters
    ----------
    depth
        (height, width) meters, 0 = no measurement.
    depth_scale
        Units per meter.
    """
    units = np.rint(depth * depth_scale)
    return np.where(units <= np.iinfo(np.uint16).max, units / depth_scale, 0.0).astype(np.float32)


def kinect_depth(
    depth: NDArray[np.float64], hidden: NDArray[np.bool_], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Apply the Kinect-1 model.

    Parameters
    ----------
    depth
        (height, width) exact meters along z, 0 = nothing there.
    hidden
        (height, width) points that the projector at `KINECT_PROJECTOR_M` does not reach.
    rng
        Source of the noise of this frame.

    Returns
    -------
    (height, width) meters, 0 = no measurement.
    """
    dropped = depth_edges(depth) & (rng.random(depth.shape) < EDGE_DROPOUT)
    measurable = (depth >= NEAR_M) & (depth <= FAR_M) & ~hidden & ~dropped
    disparity = FOCAL_BASELINE_PX_M / np.where(measurable, depth, 1.0)
    disparity += DISPARITY_SIGMA_PX * rng.standard_normal(depth.shape)
    disparity = np.rint(disparity / DISPARITY_STEP_PX) * DISPARITY_STEP_PX
    return np.where(measurable, FOCAL_BASELINE_PX_M / disparity, 0.0)


def depth_edges(depth: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mark pixels whose 3x3 neighborhood spans more than 4 % of their depth."""
    padded = np.pad(depth, 1, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    span = windows.max(axis=(2, 3)) - windows.min(axis=(2, 3))
    return np.asarray(span > EDGE_RATIO * depth, dtype=np.bool_)
