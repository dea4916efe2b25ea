# SPDX-License-Identifier: MIT
"""Turn color and depth pictures into the planes that video codecs take, and back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["InverseDepth", "filled", "lanczos", "resized", "rgb_of", "triangle", "yuv_of"]

Plane = NDArray[np.float32]
Kernel = Callable[[NDArray[np.float64]], NDArray[np.float64]]

# BT.601, full range: luma is that of `threedvc.metrics.picture_quality`.
RGB_TO_YUV = np.array(
    [[0.299, 0.587, 0.114], [-0.299 / 1.772, -0.587 / 1.772, 0.5], [0.5, -0.587 / 1.402, -0.114 / 1.402]],
    dtype=np.float32,
)
YUV_TO_RGB = np.linalg.inv(RGB_TO_YUV.astype(np.float64)).astype(np.float32)
CHROMA_ZERO = 128.0
"""Chroma of gray, the middle of 8 bits."""
LOBES = 3
"""Of the windowed sinc: Lanczos-3, usual for resizing video."""
TINY = np.float32(1e-6)
"""Keeps the division finite where nothing is known."""


def yuv_of(picture: NDArray[np.uint8], size: tuple[int, int]) -> list[Plane]:
    """Return luma and halved chroma planes, 0 to 255, of an RGB picture scaled to an even (width, height)."""
    y, u, v = np.moveaxis(picture.astype(np.float32) @ RGB_TO_YUV.T, -1, 0)
    half = size[0] // 2, size[1] // 2
    return [resized(y, size, lanczos), *(resized(plane, half, lanczos) + CHROMA_ZERO for plane in (u, v))]


def rgb_of(planes: list[Plane], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the RGB picture (height, width, 3) of a size from luma and chroma planes of any sizes."""
    y, u, v = (resized(plane, size, lanczos) for plane in planes)
    rgb = np.stack([y, u - CHROMA_ZERO, v - CHROMA_ZERO], axis=-1) @ YUV_TO_RGB.T
    return np.clip(np.rint(rgb), 0, 255).astype(np.uint8)


def lanczos(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the windowed sinc of three lobes."""
    return np.asarray(np.where(np.abs(x) < LOBES, np.sinc(x) * np.sinc(x / LOBES), 0))


def triangle(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the kernel of linear interpolation."""
    return np.asarray(np.maximum(1 - np.abs(x), 0))


def resized(plane: Plane, size: tuple[int, int], kernel: Kernel) -> Plane:
    """Scale a plane to (width, height); where it shrinks, the kernel widens, so that nothing folds over."""
    height, width = plane.shape
    if (width, height) == size:
        return plane
    across, down = _weights(width, size[0], kernel), _weights(height, size[1], kernel)
    return np.asarray(down @ plane @ across.T, dtype=np.float32)


@cache
def _weights(before: int, after: int, kernel: Kernel) -> Plane:
    """Return the weights (after, before) of old samples in new ones; edge samples stand for what is outside."""
    step = before / after
    stretch = max(step, 1.0)
    margin = int(np.ceil(LOBES * stretch))
    place = (np.arange(after) + 0.5) * step - 0.5
    samples = np.arange(-margin, before + margin)
    values = kernel((samples - place[:, None]) / stretch)
    weights = np.zeros((after, before))
    np.add.at(weights.T, np.clip(samples, 0, before - 1), values.T)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), dtype=np.float32)


def filled(values: Plane, known: Plane) -> Plane:
    """Fill what is not known smoothly from around it: means of ever larger blocks, interpolated.

    Parameters
    ----------
    values
        (h, w) float32.
    known
        (h, w) float32 weights, 0 to 1; values of weight 0 do not count.
    """
    height, width = values.shape
    if known.min() >= 1 or max(height, width) == 1:
        return values
    half = (width + 1) // 2, (height + 1) // 2
    weight, total = (_scaled(plane, half, cv2.INTER_AREA) for plane in (known, values * known))
    mean = np.asarray(total / np.maximum(weight, TINY), dtype=np.float32)
    coarse = filled(mean, np.asarray(np.minimum(4 * weight, 1), dtype=np.float32))
    around = _scaled(coarse, (width, height), cv2.INTER_LINEAR)
    return np.asarray(known * values + (1 - known) * around, dtype=np.float32)


def _scaled(plane: Plane, size: tuple[int, int], interpolation: int) -> Plane:
    return np.asarray(cv2.resize(plane, size, interpolation=interpolation), dtype=np.float32).reshape(size[::-1])


@dataclass(frozen=True, kw_only=True)
class InverseDepth:
    """Depth as numbers from 0 (farthest) to `top` (nearest), uniform in its inverse.

    Attributes
    ----------
    near_m, far_m
        The range of depths that is coded.
    top
        Largest number, 1023 for ten bits.
    """

    near_m: float
    far_m: float
    top: int = 1023

    @classmethod
    def covering(cls, near_m: float, far_m: float) -> Self:
        """Return the map of a range of depths, which may be a single depth."""
        return cls(near_m=near_m, far_m=far_m if far_m > near_m else 1.001 * near_m)

    def numbers(self, depth: Plane) -> Plane:
        """Return the numbers, not rounded, of depths (h, w) in meters; what has no depth is filled."""
        known = depth > 0
        step = (1 / self.near_m - 1 / self.far_m) / self.top
        inverse = 1 / np.where(known, depth, np.float32(self.far_m))
        return filled(((inverse - 1 / self.far_m) / step).astype(np.float32), known.astype(np.float32))

    def depth(self, numbers: Plane) -> Plane:
        """Return the depths in meters of numbers (h, w)."""
        share = np.clip(numbers / self.top, 0, 1)
        return np.asarray(1 / (share / self.near_m + (1 - share) / self.far_m), dtype=np.float32)
