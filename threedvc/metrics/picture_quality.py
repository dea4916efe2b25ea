# SPDX-License-Identifier: MIT
"""How good decoded pictures are, and what a model weighs: the one definition of each measure.

Color is measured over all pixels and averaged over frames. Depth is measured in units of the
16-bit depth pictures: errors are then whole numbers, so that one histogram gives the exact median,
percentile and maximum over any number of frames in constant memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.metrics import sum_ssim
from threedvc.parallel import default_threads, for_ranges
from threedvc.units import LUMA_WEIGHTS

__all__ = ["MAX_PSNR_DB", "ColorQuality", "luma", "mean_color_quality", "psnr", "psnr_y", "ssim_y"]

MAX_PSNR_DB = 99.0
"""Stands for equal pictures, whose ratio is infinite: a mean over frames has to stay finite."""
LUMA = np.array(LUMA_WEIGHTS, dtype=np.float32)
SSIM_WINDOW = 11
"""Pixels (Wang et al. 2004)."""
SSIM_SIGMA = 1.5
"""Pixels of the window's Gaussian (Wang et al. 2004)."""


def psnr(reference: NDArray[np.uint8], decoded: NDArray[np.uint8]) -> float:
    """Return the peak signal-to-noise ratio over all samples, in dB, at most 99.

    Parameters
    ----------
    reference, decoded
        uint8 pictures of one shape.
    """
    return _decibel(reference.astype(np.float32) - decoded.astype(np.float32))


def psnr_y(reference: NDArray[np.uint8], decoded: NDArray[np.uint8]) -> float:
    """Return the peak signal-to-noise ratio of luma in dB, at most 99, of two (h, w, 3) uint8 pictures."""
    return _decibel(luma(reference) - luma(decoded))


def _decibel(difference: NDArray[np.float32]) -> float:
    error = float(np.mean(np.square(difference), dtype=np.float64))
    return MAX_PSNR_DB if error <= 0 else min(MAX_PSNR_DB, 10 * float(np.log10(255.0**2 / error)))


def luma(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return ``0.299 R + 0.587 G + 0.114 B`` of an (h, w, 3) RGB picture, (h, w) float32, not rounded."""
    red, green, blue = np.moveaxis(picture.astype(np.float32), -1, 0)
    weighted: NDArray[np.float32] = LUMA[0] * red + LUMA[1] * green + LUMA[2] * blue
    return weighted


def ssim_y(reference: NDArray[np.uint8], decoded: NDArray[np.uint8]) -> float:
    """Return the structural similarity of luma of two (h, w, 3) uint8 pictures.

    Wang et al. 2004: Gaussian window of 11x11 and sigma 1.5, mean over the positions whose window
    lies inside the picture. NaN where no window fits.
    """
    height, width = reference.shape[:2]
    rows, columns = height - SSIM_WINDOW + 1, width - SSIM_WINDOW + 1
    if rows < 1 or columns < 1:
        return float("nan")
    first, second = luma(reference), luma(decoded)
    offsets = np.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    taps = np.exp(-0.5 * (offsets / SSIM_SIGMA) ** 2)
    taps /= taps.sum()
    sums = np.empty(rows)
    for_ranges(lambda start, stop: sum_ssim(first, second, taps, start, stop, sums), rows, default_threads())
    return float(sums.sum() / (rows * columns))


@dataclass(frozen=True, kw_only=True)
class ColorQuality:
    """Color measures of one frame or their mean; names as in the JSON report."""

    psnr_rgb: float
    psnr_y: float
    ssim_y: float

    @classmethod
    def measure(cls, reference: NDArray[np.uint8], decoded: NDArray[np.uint8]) -> Self:
        """Compare two (h, w, 3) uint8 RGB pictures."""
        return cls(
            psnr_rgb=psnr(reference, decoded), psnr_y=psnr_y(reference, decoded), ssim_y=ssim_y(reference, decoded)
        )


def mean_color_quality(frames: Sequence[ColorQuality]) -> ColorQuality:
    """Return the mean of each measure over frames."""
    values = np.array([(frame.psnr_rgb, frame.psnr_y, frame.ssim_y) for frame in frames])
    rgb, y, similarity = values.mean(axis=0)
    return ColorQuality(psnr_rgb=float(rgb), psnr_y=float(y), ssim_y=float(similarity))
