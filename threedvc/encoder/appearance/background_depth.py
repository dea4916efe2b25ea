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
from numpy.typing import NDArray

from threedvc.arrays import Doubles
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
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose
from threedvc.model.decoded_model import DecodedModel

__all__ = ["RELIEF_BITS", "DepthChoice", "best_depths", "measured_depths"]

RELIEF_BITS = 3
"""Cells made of a picture cost nothing, so they tell as finely as they can where the surface passes."""
CELL_PIXELS, LEAST_CELL_PIXELS = 2.0, 1.0
REFERENCE_PIXELS = 320 * 240
"""Cells of smaller pictures are narrower: they are few, and a pixel shows more."""
LEAST_CELL_M = 1e-4
MARGIN_PX = 2
BESIDE = np.float32(1e-4)
OUTLIER = 0.02
SLOPE_PX = 8
LEVELS = 5
MOST_TRIED = 140_000
"""How many samples a grid may have that is tried."""
STEPS = (0.024, 0.012)
"""Quantisation steps as shares of the median inverse depth."""
HALVINGS = (2, 4)
DEAD_ZONE, DEAD_ZONES = 192, (160, 224)
HEADROOM = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthChoice:
    """A coded depth picture.

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


def measured_depths(frames: Iterable[tuple[NDArray[np.float32], NDArray[np.bool_]]]) -> Doubles:
    """Average the inverse depths that frames measure of what is no object.

    Parameters
    ----------
    frames
        Depth (h, w) in metres, 0 = no measurement, and where objects are (h, w).

    Returns
    -------
    (h, w) float64 in 1/m; 0 where no frame tells.
    """
    seen = [_seen(depth, hidden) for depth, hidden in frames]
    middle = np.zeros_like(seen[0][0], dtype=np.float64)
    for again in (False, True):
        total, weight = np.zeros_like(middle), np.zeros_like(middle)
        for found, trust in seen:
            share = trust.astype(np.float64)
            if again:
                away = (found - middle) / (OUTLIER * np.maximum(middle, 1e-9))
                share /= (1 + away**2) ** 2
            total += share * found
            weight += share
        middle = total / np.maximum(weight, 1e-30)
    return np.where(weight > 0, middle, 0.0)


def best_depths(
    measured: Doubles, camera: Camera, cost: Callable[[DepthChoice], float], voxel_size_m: float | None = None
) -> DepthChoice | None:
    """Return that coding of inverse depths (h, w) that costs least, of some tried; None if all cost infinitely much.

    Without `voxel_size_m` cells are as narrow as the picture deserves.
    """
    if camera.distorted or not measured.any():
        return None
    middle, scale_bits = float(np.median(measured[measured > 0])), _scale_bits(measured)
    size = voxel_size_m or max(round(_cell_pixels(camera) / (middle * camera.fx), 4), LEAST_CELL_M)

    def tried(settings: _Settings) -> tuple[float, DepthChoice]:
        units = max(1, round(settings.step * middle * 2.0**scale_bits))
        steps = DepthSteps(step=units, levels=LEVELS, halvings=settings.halvings, dead_zone=settings.dead_zone)
        payload, _ = encode_depths(_picture(measured, settings.spacing, scale_bits), steps)
        choice = DepthChoice(payload=payload, voxel_size_m=size)
        return cost(choice), choice

    usual = [_Settings(*each, DEAD_ZONE) for each in product(_spacings(camera), STEPS, HALVINGS)]
    tries = {settings: tried(settings) for settings in usual}
    best = min(tries, key=lambda each: tries[each][0])
    others = [best._replace(dead_zone=zone) for zone in DEAD_ZONES]
    tries |= {settings: tried(settings) for settings in others}
    least, choice = min(tries.values(), key=lambda each: each[0])
    return choice if least < inf else None


class _Settings(NamedTuple):
    """What is tried: pixels between samples, quantisation step as a share of the middle, and see `DepthSteps`."""

    spacing: int
    step: float
    halvings: int
    dead_zone: int


def _seen(depth: NDArray[np.float32], hidden: NDArray[np.bool_]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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
    while np.prod(grid_shape(camera.width, camera.height, spacing)) > MOST_TRIED and spacing < MAX_SPACING:
        spacing *= 2
    return [spacing * wider for wider in (1, 2, 4) if spacing * wider <= MAX_SPACING]


def _picture(measured: Doubles, spacing: int, scale_bits: int) -> DepthPicture:
    samples = np.rint(_sampled(measured, spacing) * 2.0**scale_bits).astype(np.int64)
    return DepthPicture(samples=np.clip(samples, 0, MAX_SAMPLE), spacing=spacing, scale_bits=scale_bits)


def _cell_pixels(camera: Camera) -> float:
    """Return how many pixels a cell at the middle inverse depth covers."""
    share = camera.width * camera.height / REFERENCE_PIXELS
    return float(np.clip(CELL_PIXELS * np.sqrt(share), LEAST_CELL_PIXELS, CELL_PIXELS))


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
    slope = np.where((before > 0) & (np.abs(last - before) < 0.1 * last), (last - before) / back, 0)
    more = [np.where(last > 0, last + slope * (step + 1), 0) for step in range(count)]
    return np.concatenate([values, np.stack(more)])
