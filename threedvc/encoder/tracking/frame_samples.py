# SPDX-License-Identifier: MIT
"""What a frame gives a registration: samples of its depth, and luma at several resolutions."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from threedvc.arrays import Doubles, Floats, Mask
from threedvc.geometry.camera import Camera
from threedvc.kernels.encoder import registration as kernels

__all__ = ["MAX_JUMP", "SMALLEST_SIDE", "Samples", "detail", "halved", "level_samples", "masked_luma", "normal_reach"]

MIN_LEVEL_SAMPLES = 1500
SMALLEST_SIDE = 24
NORMAL_REACH_PARTS = 160
MAX_JUMP = 0.04


def normal_reach(camera: Camera) -> int:
    """Return the pixels to each side across which normals are taken, as fits the picture's size."""
    return max(1, round(camera.width / NORMAL_REACH_PARTS))


def masked_luma(intensity: Floats, mask: Mask | None) -> Floats:
    """Return the luma with NaN outside an object's pixels."""
    return intensity if mask is None else np.where(mask, intensity, np.float32(np.nan))


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of a frame at one level: rows of `kernels.sample_frame`, luma, its slopes by pixel, depth noise."""

    surface: Doubles
    luma: Doubles
    slopes: Doubles
    sigma: Doubles

    def __len__(self) -> int:
        return len(self.surface)


def halved(luma: Floats) -> Floats:
    """Return luma (h, w) at half its resolution, (h // 2, w // 2)."""
    half = np.empty((luma.shape[0] // 2, luma.shape[1] // 2), dtype=np.float32)
    kernels.halve_luma(luma, half, 0, len(half))
    return half


def detail(luma: Floats, side: int) -> Floats:
    """Return luma against the mean of the known pixels around, about the same level as before."""
    known = np.isfinite(luma)
    mean = _window_mean(np.where(known, luma, np.float32(0)), side)
    if not known.all():
        mean /= np.maximum(_window_mean(known.astype(np.float32), side), np.float32(1e-6))
    return luma - mean + np.float32(kernels.LUMA_CENTRE)


def _window_mean(picture: Floats, side: int) -> Floats:
    mean = cv2.boxFilter(picture, -1, (side, side), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(mean, dtype=np.float32)


def level_samples(surface: Doubles, sigma: Doubles, luma: Floats, level: int) -> Samples:
    """Thin out the samples for a level and look up its luma."""
    step = max(1, min(4**level, len(surface) // MIN_LEVEL_SAMPLES))
    chosen = np.ascontiguousarray(surface[::step])
    values = np.empty(len(chosen))
    kernels.sample_luma(luma, 0.5**level, chosen, values, 0, len(chosen))
    return Samples(chosen, values, _slopes(luma, 0.5**level, chosen), np.ascontiguousarray(sigma[::step]))


def _slopes(luma: Floats, scale: float, samples: Doubles) -> Doubles:
    """Return the slopes (n, 2) of a shrunk luma picture at samples, by unshrunk pixels; NaN beside unknown ones."""
    height, width = luma.shape
    columns, rows = np.rint((samples[:, 6:8] + 0.5) * scale - 0.5).astype(np.intp).T
    columns, rows = np.clip(columns, 1, width - 2), np.clip(rows, 1, height - 2)
    along = luma[rows, columns + 1] - luma[rows, columns - 1], luma[rows + 1, columns] - luma[rows - 1, columns]
    return np.column_stack(along) * (0.5 * scale)
