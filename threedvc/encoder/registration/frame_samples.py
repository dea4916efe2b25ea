# SPDX-License-Identifier: MIT
"""What a frame gives a registration: samples of its depth, and luma at several resolutions."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from threedvc.arrays import Doubles, Floats
from threedvc.encoder.registration.registration_types import DepthSample, RegistrationConfig, Sigma, camera_rays
from threedvc.geometry.camera import Camera
from threedvc.kernels.encoder import registration as kernels

__all__ = ["MAX_JUMP", "Samples", "level_samples", "luma_levels", "normal_reach", "sample_surface"]

MIN_LEVEL_SAMPLES = 1500
"""Coarse levels are downsampled no further: some hundred samples for each unknown outvote noise and outliers."""
MIN_LEVEL_SIDE = 24
"""Pixels of the shorter side of the coarsest picture: of a smaller one nothing is left but a few shades."""
NORMAL_REACH_PARTS = 160
"""Normals are taken across the picture's width over this, so that noise tilts them alike at every resolution: 4 pixels
of 640."""
MAX_JUMP = 0.04
"""Neighbors whose depth differs by more than this part lie on two surfaces: no normal is taken across them. Beyond the
noise of sensors (1 % or less)."""


def normal_reach(camera: Camera) -> int:
    """Return the pixels to each side across which normals are taken, as fits the picture's size."""
    return max(1, round(camera.width / NORMAL_REACH_PARTS))


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of a frame at one level: rows of `kernels.sample_frame`, luma, its slopes by pixel, depth noise."""

    surface: Doubles
    luma: Doubles
    slopes: Doubles
    sigma: Doubles

    def __len__(self) -> int:
        return len(self.surface)


def sample_surface(sample: DepthSample, sigma_m: Sigma, count: int) -> tuple[Doubles, Doubles]:
    """Return about `count` samples (n, 8) with surface, rows of `kernels.sample_frame`, and their depth noise (n,)."""
    mask, depth = sample.mask, sample.depth
    inside = np.ones(depth.shape, dtype=np.bool_) if mask is None else np.ascontiguousarray(mask)
    depth = np.ascontiguousarray(depth)
    stride = max(1, round(np.sqrt(np.count_nonzero(inside & (depth > 0)) / count)))
    height, width = depth.shape
    grid = np.zeros((max(1, height // stride), max(1, width // stride), 8))
    rays, reach = camera_rays(sample.camera), normal_reach(sample.camera)
    kernels.sample_frame(depth, inside, rays, stride, reach, MAX_JUMP, grid, 0, len(grid))
    surface = grid[grid[:, :, 2] > 0]
    if callable(sigma_m):
        return surface, np.ascontiguousarray(sigma_m(surface[:, 2]), dtype=np.float64)
    columns, rows = surface[:, 6].astype(np.intp), surface[:, 7].astype(np.intp)
    return surface, sigma_m[rows, columns].astype(np.float64)


def luma_levels(luma: Floats, config: RegistrationConfig) -> list[Floats]:
    """Return the luma of every level, the finest against its local mean."""
    count = min(config.levels, 1 + int(np.log2(max(1.0, min(luma.shape) / MIN_LEVEL_SIDE))))
    pictures = [np.ascontiguousarray(luma, dtype=np.float32)]
    for _ in range(count - 1):
        pictures.append(_halved(pictures[-1]))
    if config.detail_pixels:
        pictures[0] = _detail(pictures[0], config.detail_pixels)
    return pictures


def _halved(luma: Floats) -> Floats:
    """Return luma (h, w) at half its resolution, (h // 2, w // 2)."""
    half = np.empty((luma.shape[0] // 2, luma.shape[1] // 2), dtype=np.float32)
    kernels.halve_luma(luma, half, 0, len(half))
    return half


def _detail(luma: Floats, side: int) -> Floats:
    """Return luma against the mean of the known pixels around, about the same level as before."""
    known = np.isfinite(luma)
    mean = _window_mean(np.where(known, luma, np.float32(0)), side)
    if not known.all():
        mean /= np.maximum(_window_mean(known.astype(np.float32), side), np.float32(1e-6))
    return luma - mean + np.float32(kernels.LUMA_CENTER)


def _window_mean(picture: Floats, side: int) -> Floats:
    mean = cv2.boxFilter(picture, -1, (side, side), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(mean, dtype=np.float32)


def level_samples(surface: Doubles, sigma: Doubles, luma: Floats, level: int) -> Samples:
    """Downsample the samples for a level and look up its luma."""
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
