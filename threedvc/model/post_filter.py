# SPDX-License-Identifier: MIT
"""Post filter of drawn pictures: six symmetric ones, for pixels at silhouettes, near them and elsewhere.

Cells are some pixels wide, so what is drawn is sharper at silhouettes than it is right, and surfaces
have kinks; a background picture has the marks of its quantization. The writer finds by least squares
what mends most of it. Pixels of a background picture have filters of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.config import FilterParts
from threedvc.kernels.render.picture_filter import MARGIN, filter_rows
from threedvc.parallel import for_ranges

__all__ = ["FACTOR_UNIT", "PAIRS", "PIXEL_CLASSES", "PostFilter", "classify_pixels", "planes_of"]

PAIRS = 6
"""Pairs of opposite pixels in a diamond of 13 about the one that is filtered. Measured: the next larger one gains .01
to .05 dB more (decision 0014). All numbers here are part of the format."""
DISTANCES = 3
"""At silhouettes, near them, elsewhere. Measured: one class for all pixels saves half as much (decision 0014)."""
PIXEL_CLASSES = 2 * DISTANCES
"""Cells and a background image have filters of their own."""
FACTOR_UNIT = 1 / 64
"""Unit of the factors: sums of pairs stay integers that single precision holds exactly."""
EDGE = np.float32(1.05)
"""Depths of neighbors that differ by more than this factor lie on different surfaces."""
NEAR_PX = (1, 5)
"""At a silhouette is what is no further from an edge along both axes, and near one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PostFilter:
    """Factors of the filters, one for each class of pixels.

    Attributes
    ----------
    luma, chroma
        (PIXEL_CLASSES, PAIRS) int32 in 1/64: how much of the difference of each pair of pixels to the one between
        them is added to it.
    """

    luma: NDArray[np.int32]
    chroma: NDArray[np.int32]

    @classmethod
    def none(cls) -> PostFilter:
        """Return the filter that changes nothing."""
        zero = np.zeros((PIXEL_CLASSES, PAIRS), dtype=np.int32)
        return cls(luma=zero, chroma=zero)

    def of(self, parts: FilterParts) -> PostFilter:
        """Return the filter that works on some pixels alone: beside silhouettes, or on surfaces."""
        keep = np.zeros(PIXEL_CLASSES, dtype=np.int32)
        for distance in range(DISTANCES):
            on_surfaces = distance == DISTANCES - 1
            keep[distance::DISTANCES] = parts.on_surfaces if on_surfaces else parts.at_silhouettes
        return PostFilter(luma=self.luma * keep[:, None], chroma=self.chroma * keep[:, None])

    def apply(self, picture: NDArray[np.uint8], pixel_classes: NDArray[np.uint8], threads: int) -> NDArray[np.uint8]:
        """Return the filtered picture (h, w, 3); `pixel_classes` (h, w) are those of its pixels."""
        planes, result = planes_of(picture), np.empty_like(picture)

        def row_range(start: int, stop: int) -> None:
            filter_rows(start, stop, planes, pixel_classes, self.luma, self.chroma, result)

        for_ranges(row_range, len(picture), threads)
        return result


def planes_of(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the planes (3, h + 4, w + 4) float32 of a picture (h, w, 3), continued beyond its border."""
    wider = cv2.copyMakeBorder(picture, MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(np.moveaxis(wider, -1, 0), dtype=np.float32)


def classify_pixels(depth: NDArray[np.float32], labels: NDArray[np.uint8], with_backdrop: bool) -> NDArray[np.uint8]:
    """Return the class (h, w) of every pixel: 0 at a silhouette, 1 near one, 2 elsewhere; 3 more before a backdrop.

    A pixel is on an edge if among it and its eight neighbors one has no depth, depths differ by more than 5 %, or
    labels differ; at a silhouette, if an edge is within one pixel along both axes; near one, if within five.
    """
    around = np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.erode(depth, around), cv2.dilate(depth, around)
    edge = (nearest == 0) | (farthest > EDGE * nearest) | (cv2.erode(labels, around) != cv2.dilate(labels, around))
    pixel_classes = np.full(depth.shape, DISTANCES - 1, dtype=np.uint8)
    for distance in reversed(range(len(NEAR_PX))):
        side = 2 * NEAR_PX[distance] + 1
        pixel_classes[cv2.dilate(edge.view(np.uint8), np.ones((side, side), np.uint8)) > 0] = distance
    if with_backdrop:
        pixel_classes[labels == 0] += DISTANCES
    return pixel_classes
