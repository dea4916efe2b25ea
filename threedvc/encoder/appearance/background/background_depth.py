# SPDX-License-Identifier: MIT
"""The depth picture of a background at rest before a camera at rest: measured in all frames, coded as is best."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product
from math import inf
from typing import NamedTuple

import cv2
import numpy as np

from threedvc.arrays import Doubles, Floats, Mask
from threedvc.coding.depth_cells import spread
from threedvc.coding.depth_picture import (
    MAX_SAMPLE,
    MAX_SCALE_BITS,
    MAX_SPACING,
    DepthPicture,
    DepthSteps,
    decode_depths,
    encode_depths,
    grid_shape,
)
from threedvc.encoder.appearance.background.robust_mean import Observations, robust_mean
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose
from threedvc.model.decoded_model import DecodedModel

__all__ = ["RELIEF_BITS", "CodedDepthMap", "averaged_inverse_depth", "cheapest_depth_map"]

RELIEF_BITS = 3
"""Cells made of a picture cost nothing, so they tell as finely as they can where the surface passes."""
MIN_CELL_PIXELS, MAX_CELL_PIXELS = 1.0, 2.0
"""Measured on two_toys: cells of 1 and 2 pixels lose 0.05 and 0.06 % of the depth, drawn in 37 and 20 ms."""
REFERENCE_PIXELS = 320 * 240
"""Cells of smaller pictures are narrower: they are few, and a pixel shows more."""
MIN_CELL_M = 1e-4
"""Edges are rounded to this."""
MARGIN_PX = 2
"""About objects: depth there is often a mixture of theirs and the background's."""
BESIDE = np.float32(1e-4)
"""Weight of a measurement beside an object: so little that any other one decides."""
OUTLIER = 0.02
"""Share of the inverse depth that a measurement must be off to count a quarter: a few times the noise of a sensor."""
MIN_WEIGHT = 1e-30
"""Of a pixel that some frame measures, however far off its measurements are; only saves from dividing by zero."""
SLOPE_PX = 8
"""Pixels from the border over which its inclination is taken: of fewer the noise would be tilted beyond it."""
MAX_BORDER_STEP = 0.1
"""Share of the inverse depth by which that may differ over `SLOPE_PX`; more is an edge, not an inclination."""
LEVELS = 5
"""Levels of the prediction of samples (`DepthSteps`): beyond the coarsest, 32 samples apart, planes cost nothing."""
MAX_TRIED_SAMPLES = 140_000
"""How many samples a grid may have that is tried: bounds the time of the trials."""
WIDER_GRIDS = (1, 2, 4)
"""By how much wider than the finest the grids are that are tried."""
STEPS = (0.024, 0.012)
"""Quantization steps as shares of the median inverse depth: errors of up to 1.2 and 0.6 %, about the 1 % by which depth
is judged."""
HALVINGS = (2, 4)
"""On how many levels the step is halved (`DepthSteps`): coarse levels tilt all that is predicted from them."""
DEAD_ZONE, DEAD_ZONES = 192, (160, 224)
"""The one with which everything else is chosen, and others that are tried with the best of that (`DepthSteps`)."""
HEADROOM = 8
"""How far the greatest sample is above the greatest inverse depth measured: predictions may overshoot."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CodedDepthMap:
    """A coded picture of inverse depths.

    Attributes
    ----------
    payload
        For `decode_depths`.
    voxel_size_m
        Edge of the cells that are to be made of it.
    """

    payload: bytes
    voxel_size_m: float

    def model(self, camera: Camera, T_camera_object: Pose) -> DecodedModel:
        """Return the object that the decoder makes of it, before a depth camera."""
        model = DecodedModel(self.voxel_size_m, relief_bits=RELIEF_BITS)
        spread(decode_depths(self.payload, camera.width, camera.height), model, camera, T_camera_object)
        return model


def averaged_inverse_depth(frames: Iterable[tuple[Floats, Mask]]) -> Doubles:
    """Average the inverse depths that frames measure of what is no object.

    Parameters
    ----------
    frames
        Depth (h, w) in meters, 0 = no measurement, and where objects are (h, w).

    Returns
    -------
    (h, w) float64 in 1/m; 0 where no frame tells.
    """
    seen = [_seen(depth, hidden) for depth, hidden in frames]

    def observations() -> Observations:
        return ((found, trust.astype(np.float64)) for found, trust in seen)

    mean, weight = robust_mean(observations, _residual, MIN_WEIGHT)
    return np.where(weight > 0, mean, 0.0)


def _residual(found: Floats | Doubles, mean: Doubles) -> Doubles:
    return np.asarray((found - mean) / (OUTLIER * np.maximum(mean, 1e-9)))


def cheapest_depth_map(
    measured: Doubles, camera: Camera, cost: Callable[[CodedDepthMap], float], voxel_size_m: float | None = None
) -> CodedDepthMap | None:
    """Return that coding of inverse depths (h, w) that costs least, of some tried; None if all cost infinitely much.

    Without `voxel_size_m` cells are as narrow as the picture deserves.
    """
    if camera.distorted or not measured.any():
        return None
    middle, scale_bits = float(np.median(measured[measured > 0])), _scale_bits(measured)
    size = voxel_size_m or max(round(_cell_pixels(camera) / (middle * camera.fx), 4), MIN_CELL_M)

    def tried(settings: _Settings) -> tuple[float, CodedDepthMap]:
        units = max(1, round(settings.step * middle * 2.0**scale_bits))
        steps = DepthSteps(step=units, levels=LEVELS, halvings=settings.halvings, dead_zone=settings.dead_zone)
        payload, _ = encode_depths(_picture(measured, settings.spacing, scale_bits), steps)
        choice = CodedDepthMap(payload=payload, voxel_size_m=size)
        return cost(choice), choice

    usual = [_Settings(*each, DEAD_ZONE) for each in product(_spacings(camera), STEPS, HALVINGS)]
    tries = {settings: tried(settings) for settings in usual}
    best = min(tries, key=lambda each: tries[each][0])
    others = [best._replace(dead_zone=zone) for zone in DEAD_ZONES]
    tries |= {settings: tried(settings) for settings in others}
    least, choice = min(tries.values(), key=lambda each: each[0])
    return choice if least < inf else None


class _Settings(NamedTuple):
    """What is tried: pixels between samples, quantization step as a share of the middle, and see `DepthSteps`."""

    spacing: int
    step: float
    halvings: int
    dead_zone: int


def _seen(depth: Floats, hidden: Mask) -> tuple[Floats, Floats]:
    """Return the inverse depths of a frame, 0 where there are none, and how far to trust them.

    Beside objects they count only if nothing better is known.
    """
    near = cv2.dilate(hidden.astype(np.uint8), np.ones((2 * MARGIN_PX + 1,) * 2, np.uint8))
    clear = (depth > 0) & ~hidden
    inverse = np.where(clear, 1 / np.where(clear, depth, np.float32(1)), np.float32(0))
    return inverse, np.where(near == 0, np.float32(1), BESIDE) * clear


def _scale_bits(measured: Doubles) -> int:
    """Return the finest scale at which inverse depths are well below the greatest sample."""
    return int(np.clip(np.floor(np.log2(MAX_SAMPLE / HEADROOM / measured.max())), 0, MAX_SCALE_BITS))


def _spacings(camera: Camera) -> list[int]:
    """Return the grids that are worth trying: the finest without too many samples, and wider ones."""
    spacing = 1
    while np.prod(grid_shape(camera.width, camera.height, spacing)) > MAX_TRIED_SAMPLES and spacing < MAX_SPACING:
        spacing *= 2
    return [spacing * wider for wider in WIDER_GRIDS if spacing * wider <= MAX_SPACING]


def _picture(measured: Doubles, spacing: int, scale_bits: int) -> DepthPicture:
    samples = np.rint(_sampled(measured, spacing) * 2.0**scale_bits).astype(np.int64)
    return DepthPicture(samples=np.clip(samples, 0, MAX_SAMPLE), spacing=spacing, scale_bits=scale_bits)


def _cell_pixels(camera: Camera) -> float:
    """Return how many pixels a cell at the middle inverse depth covers."""
    share = camera.width * camera.height / REFERENCE_PIXELS
    return float(np.clip(MAX_CELL_PIXELS * np.sqrt(share), MIN_CELL_PIXELS, MAX_CELL_PIXELS))


def _sampled(measured: Doubles, spacing: int) -> Doubles:
    """Return inverse depths at the samples of a grid; beyond the picture its border goes on as it is inclined."""
    filled = np.where(measured > 0, measured, cv2.dilate(measured, np.ones((3, 3), np.uint8)))
    for axis in (0, 1):
        filled = np.moveaxis(_extended(np.moveaxis(filled, axis, 0), spacing), 0, axis)
    return filled[::spacing, ::spacing]


def _extended(values: Doubles, spacing: int) -> Doubles:
    """Append rows up to the next multiple of `spacing`."""
    count = -(len(values) - 1) % spacing
    back = min(SLOPE_PX, len(values) - 1)
    if not count or not back:
        return np.concatenate([values, np.repeat(values[-1:], count, axis=0)])
    last, before = values[-1], values[-1 - back]
    slope = np.where((before > 0) & (np.abs(last - before) < MAX_BORDER_STEP * last), (last - before) / back, 0)
    more = [np.where(last > 0, last + slope * (step + 1), 0) for step in range(count)]
    return np.concatenate([values, np.stack(more)])
