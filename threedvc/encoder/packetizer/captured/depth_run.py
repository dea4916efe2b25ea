# SPDX-License-Identifier: MIT
"""A run of depth maps as small pictures in logarithmic units, coded one after another."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.coding.video.av1 import Av1Settings, encode_av1
from threedvc.coding.video.planes import Samples, VideoFormat, gray_planes
from threedvc.render.captured_depth import tiles_of_pixels
from threedvc.render.hole_filling import fill_unknown

__all__ = ["DEPTH_BITS", "DepthMaps", "EncodedDepthRun", "PictureFormat", "encode_depth_run"]

DEPTH_BITS = 10
"""Of a sample, whose values are steps fine enough to round nothing away: 9 to 11 % fewer bytes than with 8 for as many
pixels within 1 % (decision 0019)."""
LAST = (1 << DEPTH_BITS) - 1
"""Greatest value."""
ENDS_PERCENT = 0.1
"""The values reach over the depths of all pixels but these at either end, which are outliers."""
COMPLETE = 0.995
"""Where this part of the pixels of every frame is measured, a run shows something everywhere: holes are specks."""
MIN_RATIO, MAX_RATIO = 1.000025, 1.02
"""Depth of a value to that of the one before: finer than any sensor where all is equally far, and far below what is
taken for an edge between surfaces, see `threedvc.render.captured_depth.EDGE`."""
QUICK_PRESET, THOROUGH_PRESET = 4, 1
"""Work of the encoder: the latter takes two to five times as long for 4 to 10 % fewer bytes."""
MAX_THOROUGH_SAMPLES = 16_000_000
"""Samples of a run above which thorough coding takes minutes: 300 pictures of 290x180."""
MIN_WEIGHT = np.float32(1e-6)
"""Where no pixel under a sample was measured: the sample is filled from around."""
DepthMaps: TypeAlias = list[NDArray[np.float32]]
"""Depth maps (h, w) in meters, 0 = nothing."""


class PictureFormat(NamedTuple):
    """Size of the pictures, and their quantization from 1 to 70, the finest first."""

    columns: int
    rows: int
    crf: float


class EncodedDepthRun(NamedTuple):
    """A run of depth maps, coded.

    Attributes
    ----------
    nearest_m, ratio
        Depth that the value 0 means, and of each value to the one before.
    complete
        Whether the run shows something everywhere.
    payload
        The coded pictures.
    tiles
        (down, across) bool: where they are shown; None: everywhere.
    """

    nearest_m: float
    ratio: float
    complete: bool
    payload: bytes
    tiles: NDArray[np.bool_] | None


def encode_depth_run(
    measured: DepthMaps,
    filled: DepthMaps,
    choice: PictureFormat,
    tiles: NDArray[np.bool_] | None = None,
    *,
    thorough: bool,
    threads: int,
) -> EncodedDepthRun:
    """Code depth maps.

    Parameters
    ----------
    measured
        What the sensor measured.
    filled
        The same maps, with something else where nothing was measured: these are coded.
    choice
        Size and quality.
    tiles
        (down, across) bool: which tiles are shown, see `threedvc.render.captured_depth`; None: all. In the others
        pictures stay as the first one is about them, which costs next to nothing.
    thorough
        Whether to take time for it.
    threads
        On how many; the payload does not depend on it.
    """
    ends = [np.percentile(depth[depth > 0], [ENDS_PERCENT, 100 - ENDS_PERCENT]) for depth in filled]
    nearest, furthest = float(min(near for near, _ in ends)), float(max(far for _, far in ends))
    ratio = float(np.clip((furthest / nearest) ** (1 / LAST), MIN_RATIO, MAX_RATIO))
    video = VideoFormat(width=choice.columns, height=choice.rows, bits=DEPTH_BITS, gray=True)
    samples: Iterator[Samples] = (_samples(depth, choice, nearest, ratio) for depth in filled)
    if tiles is not None:
        samples = _still_outside(samples, tiles)
    pictures = (gray_planes(each, video) for each in samples)
    thorough = thorough and len(filled) * choice.columns * choice.rows < MAX_THOROUGH_SAMPLES
    preset = THOROUGH_PRESET if thorough else QUICK_PRESET
    return EncodedDepthRun(
        nearest_m=nearest,
        ratio=ratio,
        complete=min(float(np.mean(depth > 0)) for depth in measured) > COMPLETE,
        payload=encode_av1(pictures, video, Av1Settings(crf=choice.crf, preset=preset, threads=threads, depth=True)),
        tiles=tiles,
    )


def _still_outside(pictures: Iterator[Samples], tiles: NDArray[np.bool_]) -> Iterator[Samples]:
    """Yield pictures that stay the same outside of some tiles."""
    still: Samples | None = None
    shown = np.zeros((0, 0), np.bool_)
    for samples in pictures:
        if still is None:
            down, across = tiles_of_pixels(samples.shape, samples.shape)
            shown = tiles[down][:, across]
            around = np.repeat(samples.astype(np.float32)[..., None], 3, axis=2)
            fill_unknown(around, shown.astype(np.uint8))
            still = np.clip(np.rint(around[..., 0]), 0, LAST).astype(np.uint16)
        yield np.where(shown, samples, still)


def _samples(depth: NDArray[np.float32], choice: PictureFormat, nearest_m: float, ratio: float) -> Samples:
    """Return the samples (rows, columns) of a depth map; what is missing is filled from around."""
    size = choice.columns, choice.rows
    seen = depth > 0
    steps = np.log(np.where(seen, depth, nearest_m) / nearest_m) / np.log(ratio)
    weight = cv2.resize(seen.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize((steps * seen).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    mean = np.repeat((total / np.maximum(weight, MIN_WEIGHT))[..., None], 3, axis=2)
    fill_unknown(mean, (weight > 0).astype(np.uint8))
    return np.asarray(np.clip(np.rint(mean[..., 0]), 0, LAST).astype(np.uint16))
