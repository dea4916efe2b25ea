# SPDX-License-Identifier: MIT
"""Gain of the color camera as frames come: how much brighter a frame is, per channel, than the evidence so far.

A camera that meters itself would otherwise leave its exposures in the model, patch by patch, and have it colored
again whenever they change. A factor alone is found, from robust means: an offset besides would follow the noise of the
colors and drift. Files do better, with all frames before them, see `threedvc.encoder.appearance.color_field`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.gains import apply_gain, quantized_gain
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import Observation
from threedvc.geometry.pose import Pose, inverse

__all__ = ["estimate_gain", "with_gain"]

SAMPLES = 8000
"""About so many pixels of a whole picture are looked up: their mean is sure to far below a level."""
MIN_SAMPLES = 200
"""With fewer that are known a gain would follow their noise."""
MIN_WEIGHT = 0.05
"""Color weight, that of a look at 4 m, from which a cell tells of a gain."""
DARK, BRIGHT = 8.0, 247.0
"""Levels beyond which a channel may be cut off."""
ROUNDS = 4
"""Of means and weights in turn, from equal weights on; by hand."""
MIN_GAIN, MAX_GAIN = 0.25, 4.0
"""Two stops down and up: exposures change by less from what a model was seen with."""
KEPT = 0.012
"""A gain that differs by less from the last one is noise."""


def estimate_gain(
    seen: Observation,
    mask: NDArray[np.bool_],
    T_camera_object: Pose,
    model: EvidenceModel,
    last: NDArray[np.int64],
    gray: bool,
) -> NDArray[np.int64]:
    """Return the gain of a frame.

    Parameters
    ----------
    seen
        The frame.
    mask
        (h, w) pixels that show the object.
    T_camera_object, model
        The object: where it is, and what is known of it from the frames before.
    last
        (3, 2) units of the gain of the frame before, see `threedvc.coding.gains`; it stays where too little is
        known, or nothing has changed.
    gray
        Whether the three channels are one.
    """
    points, T = _surface_points(seen, mask), inverse(T_camera_object)
    cells = np.floor((points @ T[:3, :3].T + T[:3, 3]) / model.voxel_size_m)
    positions = model.index.locate(cells.astype(np.int32))
    observed, usable = _observed(seen, points, model.voxel_size_m)
    known = (positions >= 0) & usable
    known[known] = model.color_weight.reshape(-1)[positions[known]] > MIN_WEIGHT
    if np.count_nonzero(known) < MIN_SAMPLES:
        return last.copy()
    shown = model.color.reshape(-1, 3)[positions[known]].astype(np.float64)
    gain = _robust_ratio(shown, observed[known], gray)
    before = apply_gain(last)[0].astype(np.float64)
    if np.abs(gain / before - 1).max() < KEPT:
        return last.copy()
    return quantized_gain(gain, np.zeros(3))


def with_gain(seen: Observation, gain: NDArray[np.int64]) -> Observation:
    """Return a frame as the camera would have seen it without a gain (3, 2)."""
    factor, offset = apply_gain(gain)
    return replace(seen, levels=tuple((level - offset) / factor for level in seen.levels))


def _surface_points(seen: Observation, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return measured points (n, 3) in the depth camera, of pixels spread over the object."""
    stride = max(int(np.sqrt(seen.depth.size / SAMPLES)), 1)
    depth = np.where(mask, seen.depth, 0)[::stride, ::stride].astype(np.float64)
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns, None]
    return np.concatenate([seen.rays[::stride, ::stride][rows, columns] * z, z], axis=1)


def _observed(
    seen: Observation, points: NDArray[np.float64], voxel_size_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the colors (n, 3) of points, as blurred as cells, and which of them were measured in full."""
    camera, T = seen.rig.color, seen.rig.T_color_depth
    points = points @ T[:3, :3].T + T[:3, 3]
    ahead = points[:, 2] > 0.01
    points[~ahead] = (0.0, 0.0, 1.0)
    pixels_per_cell = voxel_size_m * camera.fx / float(np.median(points[:, 2])) if len(points) else 1.0
    level = int(np.clip(np.log2(max(pixels_per_cell, 1.0)), 0, len(seen.levels) - 1))
    picture = seen.levels[level]
    columns, rows = np.floor((camera.project(points) + 0.5) / 2**level).astype(np.int64).T
    inside = ahead & (rows >= 0) & (columns >= 0) & (rows < picture.shape[0]) & (columns < picture.shape[1])
    colors = np.zeros((len(points), 3))
    colors[inside] = picture[rows[inside], columns[inside]]
    return colors, inside & (colors.min(axis=1) > DARK) & (colors.max(axis=1) < BRIGHT)


def _robust_ratio(shown: NDArray[np.float64], observed: NDArray[np.float64], gray: bool) -> NDArray[np.float64]:
    """Return the factors (3,) between the means of colors (n, 3); what they do not explain counts little.

    A ratio of means, unlike a regression, does not fall with the noise of the shown colors.
    """
    if gray:
        shown, observed = (np.repeat(each.mean(axis=1, keepdims=True), 3, axis=1) for each in (shown, observed))
    weight = np.ones(len(shown))
    gain = np.ones(3)
    for _ in range(ROUNDS):
        gain = np.clip(weight @ observed / np.maximum(weight @ shown, 1e-9), MIN_GAIN, MAX_GAIN)
        error = ((shown * gain - observed) ** 2).mean(axis=1)
        weight = 1 / (1 + error / (4 * np.median(error) + 1)) ** 2
    return np.asarray(gain)
