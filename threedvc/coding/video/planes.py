# SPDX-License-Identifier: MIT
"""Pictures of a video as they are coded: luma, and two planes of chroma of half its rows and columns, or all of them.

Luma is Y = (R + 2 G + B) / 4, chroma Co = (R - B) / 2 and Cg = (2 G - R - B) / 4, the latter magnified as far as none
is clipped: an error of a chroma sample shows in four pixels. Going back is integer arithmetic (docs/drawing.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats
from threedvc.kernels.coding.ycocg import color_rows, stretch_rows
from threedvc.parallel import for_ranges

__all__ = [
    "MAX_MAGNIFIED",
    "CapturedColor",
    "ExactColor",
    "Picture",
    "Planes",
    "Samples",
    "ShownColor",
    "VideoFormat",
    "flat_chroma",
    "gray_planes",
    "picture_of",
    "planes_of",
    "spare_magnification",
]

MAX_MAGNIFIED = 2
"""Chroma is magnified by 1 + m/4 with m up to this: 5 to 9 % fewer bytes (decision 0030)."""
STEPS = 64
"""Places between two samples at which pixels may lie."""

Samples: TypeAlias = NDArray[np.uint16]
"""(rows, columns) of one plane."""
Picture: TypeAlias = NDArray[np.uint8]
"""(h, w, 3) RGB."""


class Planes(NamedTuple):
    """A picture as it is coded.

    Attributes
    ----------
    luma
        (h, w) uint16, as all.
    orange, green
        ((h + 1) // 2, (w + 1) // 2), or (h, w), Co and Cg plus the middle of the range.
    """

    luma: Samples
    orange: Samples
    green: Samples


@dataclass(frozen=True, kw_only=True)
class VideoFormat:
    """Pictures of a run.

    Attributes
    ----------
    width, height
        Size of the luma.
    bits
        Of a sample, 8 or 10; a level has 1 or 4 units.
    magnified
        Chroma is 1 + magnified/4 times as large as its formula says.
    gray
        Whether chroma means nothing.
    full_chroma
        Whether chroma has all rows and columns of luma, not half of them.
    """

    width: int
    height: int
    bits: int
    magnified: int = 0
    gray: bool = False
    full_chroma: bool = False

    @property
    def chroma_shape(self) -> tuple[int, int]:
        """Rows and columns of a chroma plane."""
        if self.full_chroma:
            return self.height, self.width
        return -(-self.height // 2), -(-self.width // 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class CapturedColor:
    """The color of one frame as it was captured."""

    planes: Planes
    video: VideoFormat

    def shown(self, width: int, height: int, threads: int) -> Picture:
        """Return the picture (height, width, 3) of the frame."""
        return picture_of(self.planes, self.video, width, height, threads)


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactColor:
    """The color (h, w, 3) uint8 of one frame as it was captured, without loss."""

    picture: Picture

    def shown(self, width: int, height: int, threads: int) -> Picture:
        """Return the picture (height, width, 3) of the frame; of another size its channels are interpolated."""
        rows, columns, _ = self.picture.shape
        if (rows, columns) == (height, width):
            return self.picture
        video = VideoFormat(width=columns, height=rows, bits=8, gray=True)
        flat = np.zeros(video.chroma_shape, dtype=np.uint16)
        each = (Planes(channel.astype(np.uint16), flat, flat) for channel in np.moveaxis(self.picture, -1, 0))
        return np.stack([picture_of(planes, video, width, height, threads)[..., 0] for planes in each], axis=-1)


ShownColor: TypeAlias = CapturedColor | ExactColor
"""The color of one frame as it was captured, or nearly."""


def spare_magnification(picture: Picture) -> int:
    """Return the greatest magnification of chroma that clips none of a picture."""
    red, green, blue = np.moveaxis(picture.astype(np.int32), -1, 0)
    largest = max(2 * np.abs(red - blue).max(), np.abs(2 * green - red - blue).max())
    # A chroma of 127 levels at most: four times the largest is what both come to here, times (4 + m) / 4.
    return next(m for m in range(MAX_MAGNIFIED, -1, -1) if m == 0 or largest * (4 + m) <= 4 * 4 * 127)


def flat_chroma(video: VideoFormat) -> Samples:
    """Return a plane of chroma that means gray everywhere."""
    return np.full(video.chroma_shape, 1 << (video.bits - 1), dtype=np.uint16)


def gray_planes(luma: Samples, video: VideoFormat) -> Planes:
    """Return the planes of a picture without color."""
    flat = flat_chroma(video)
    return Planes(luma, flat, flat)


def planes_of(picture: Picture, video: VideoFormat) -> Planes:
    """Return the samples of a picture, which may be larger than the video: each is the mean of what it covers."""
    red, green, blue = np.moveaxis(picture.astype(np.float32), -1, 0)
    luma = _shrunk((red + 2 * green + blue) / 4, video.height, video.width)
    if video.gray:
        return gray_planes(_sampled(luma, video.bits), video)
    larger, middle = np.float32(1 + video.magnified / 4), np.float32(128)
    whole = (_shrunk(each, video.height, video.width) for each in ((red - blue) / 2, (2 * green - red - blue) / 4))
    chroma = whole if video.full_chroma else map(_halved, whole)
    orange, green = (_sampled(larger * plane + middle, video.bits) for plane in chroma)
    return Planes(_sampled(luma, video.bits), orange, green)


def _shrunk(plane: Floats, rows: int, columns: int) -> Floats:
    return plane if plane.shape == (rows, columns) else _resized(plane, rows, columns)


def _halved(plane: Floats) -> Floats:
    rows, columns = plane.shape
    even = np.pad(plane, ((0, rows % 2), (0, columns % 2)), mode="edge")
    return _resized(even, -(-rows // 2), -(-columns // 2))


def _resized(plane: Floats, rows: int, columns: int) -> Floats:
    return np.asarray(cv2.resize(plane, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float32)


def _sampled(levels: Floats, bits: int) -> Samples:
    scaled = np.rint(levels * np.float32(1 << (bits - 8)))
    return np.asarray(np.clip(scaled, 0, (1 << bits) - 1).astype(np.uint16))


def picture_of(planes: Planes, video: VideoFormat, width: int, height: int, threads: int) -> Picture:
    """Return the picture (height, width, 3) that planes are magnified to, as docs/drawing.md says."""
    across, down = _taps(width, video.width), _taps(height, video.height)
    half = not video.full_chroma
    across_chroma, down_chroma = _taps(width, video.width, half=half), _taps(height, video.height, half=half)
    luma = _stretched(planes.luma, across, threads)
    picture = np.empty((height, width, 3), dtype=np.uint8)
    if video.gray:
        planes = gray_planes(planes.luma, video)
    orange, green = (_stretched(plane, across_chroma, threads) for plane in (planes.orange, planes.green))

    def row_range(start: int, stop: int) -> None:
        color_rows(start, stop, luma, orange, green, *down, *down_chroma, video.bits, video.magnified, picture)

    for_ranges(row_range, height, threads)
    return picture


class _Taps(NamedTuple):
    """Samples (n, 4) along one axis that each of n pixels lies amid, and how much each counts (n, 4)."""

    places: NDArray[np.int32]
    weights: NDArray[np.int32]


def _taps(pixels: int, samples: int, *, half: bool = False) -> _Taps:
    """Return the samples of luma around pixels, or `half` as many of chroma: Catmull and Rom's interpolation."""
    places = STEPS // (4 if half else 2) * (2 * np.arange(pixels, dtype=np.int64) + 1) * samples // pixels - STEPS // 2
    f = places % STEPS
    weights = np.stack(
        [
            f * (f * (2 * STEPS - f) - STEPS**2),
            f * f * (3 * f - 5 * STEPS) + 2 * STEPS**3,
            f * (f * (4 * STEPS - 3 * f) + STEPS**2),
            f * f * (f - STEPS),
        ],
        axis=1,
    )
    last = (-(-samples // 2) if half else samples) - 1
    around = np.clip(places[:, None] // STEPS + np.arange(-1, 3), 0, last)
    return _Taps(around.astype(np.int32), weights.astype(np.int32))


def _stretched(samples: Samples, taps: _Taps, threads: int) -> NDArray[np.int32]:
    """Return samples (rows, columns) interpolated along rows at n pixels (rows, n)."""
    result = np.empty((len(samples), len(taps.places)), dtype=np.int32)

    def row_range(start: int, stop: int) -> None:
        stretch_rows(start, stop, samples, taps.places, taps.weights, result)

    for_ranges(row_range, len(samples), threads)
    return result
