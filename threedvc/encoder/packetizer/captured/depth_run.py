# SPDX-License-Identifier: MIT
"""A run of depth maps as small pictures of levels, coded one after another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.coding.video.av1 import Av1Settings, encode_av1
from threedvc.coding.video.planes import Samples, VideoFormat, gray_planes
from threedvc.render.captured_depth import DepthLaw, tiles_of_pixels
from threedvc.render.hole_filling import fill_unknown

__all__ = ["DEPTH_BITS", "LAW", "DepthMaps", "EncodedDepthRun", "PictureFormat", "encode_depth_run", "is_everywhere"]

DEPTH_BITS = 10
"""Of a sample, whose values are steps fine enough to round nothing away: 9 to 11 % fewer bytes than with 8 for as many
pixels within 1 % (decision 0019)."""
LAST = (1 << DEPTH_BITS) - 1
"""Greatest value."""
ENDS_PERCENT = 0.1
"""The values reach over the depths of all pixels but these at either end, which are outliers."""
LAW = DepthLaw.INVERSE_ROOT
"""Between levels of equal ratio, in which noise grows with the distance, and equal steps of inverse depth, which are
too coarse far away: 12 to 25 % fewer bytes than the former for stereo cameras, 0 to 5 % for Kinects (decision 0034)."""
COMPLETE = 0.995
"""Where this part of the pixels of every frame is measured, a run shows something everywhere: holes are specks."""
MOSTLY = 0.5
"""So it does where this part of the pixels that models do not draw is measured: models miss more than sensors do."""
WORTHWHILE = 0.02
"""Share of all pixels that models must miss for that; by hand."""
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
        Depth that the value 0 means, and of each value to the one before on an average.
    payload
        The coded pictures.
    tiles
        (down, across) bool: where they are shown; None: everywhere.
    """

    nearest_m: float
    ratio: float
    payload: bytes
    tiles: NDArray[np.bool_] | None


def encode_depth_run(
    measured: DepthMaps,
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
        What the sensor measured. Where it did not, pictures are filled smoothly from around: what models draw there has
        edges, which flicker and take up to a third of the bytes (decision 0038).
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
    ends = [np.percentile(depth[depth > 0], [ENDS_PERCENT, 100 - ENDS_PERCENT]) for depth in measured]
    nearest, furthest = float(min(near for near, _ in ends)), float(max(far for _, far in ends))
    ratio = float(np.clip((furthest / nearest) ** (1 / LAST), MIN_RATIO, MAX_RATIO))
    video = VideoFormat(width=choice.columns, height=choice.rows, bits=DEPTH_BITS, gray=True)
    furthest = nearest * ratio**LAST
    samples: Iterator[Samples] = (_samples(depth, choice, nearest, furthest) for depth in measured)
    if tiles is not None:
        samples = _still_outside(samples, tiles)
    pictures = (gray_planes(each, video) for each in samples)
    thorough = thorough and len(measured) * choice.columns * choice.rows < MAX_THOROUGH_SAMPLES
    preset = THOROUGH_PRESET if thorough else QUICK_PRESET
    return EncodedDepthRun(
        nearest_m=nearest,
        ratio=ratio,
        payload=encode_av1(pictures, video, Av1Settings(crf=choice.crf, preset=preset, threads=threads, depth=True)),
        tiles=tiles,
    )


def is_everywhere(measured: Sequence[NDArray[np.float32]], drawn: Sequence[NDArray[np.float32]]) -> bool:
    """Tell whether a run shows something everywhere, by some frames' depths (h, w), as measured and as drawn."""
    if min(float(np.mean(depth > 0)) for depth in measured) > COMPLETE:
        return True
    missed = sum(np.count_nonzero((own > 0) & (other <= 0)) for own, other in zip(measured, drawn, strict=True))
    undrawn = sum(np.count_nonzero(depth <= 0) for depth in drawn)
    return bool(missed > MOSTLY * undrawn and missed > WORTHWHILE * sum(depth.size for depth in drawn))


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


def _samples(depth: NDArray[np.float32], choice: PictureFormat, nearest_m: float, furthest_m: float) -> Samples:
    """Return the samples (rows, columns) of a depth map; what is missing is filled from around."""
    size = choice.columns, choice.rows
    seen = depth > 0
    first, last = nearest_m**-0.5, furthest_m**-0.5
    steps = LAST * (first - np.where(seen, depth, np.float32(nearest_m)) ** -0.5) / (first - last)
    weight = cv2.resize(seen.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize((steps * seen).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    mean = np.repeat((total / np.maximum(weight, MIN_WEIGHT))[..., None], 3, axis=2)
    fill_unknown(mean, (weight > 0).astype(np.uint8))
    return np.asarray(np.clip(np.rint(mean[..., 0]), 0, LAST).astype(np.uint16))
