# SPDX-License-Identifier: MIT
"""How good decoded pictures are, and what a model weighs: the one definition of each measure.

Colour is measured over all pixels and averaged over frames. Depth is measured in units of the
16-bit depth pictures: errors are then whole numbers, so that one histogram gives the exact median,
percentile and maximum over any number of frames in constant memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from threedvc.kernels.metrics import sum_ssim
from threedvc.parallel import default_threads, for_ranges

__all__ = [
    "MAX_PSNR_DB",
    "ColorQuality",
    "DepthErrors",
    "PaperAccounting",
    "bernoulli_entropy_bits",
    "depth_units",
    "gaussian_entropy_bits",
    "luma",
    "mean_color_quality",
    "psnr",
    "psnr_y",
    "ssim_y",
]

MAX_PSNR_DB = 99.0
MAX_DEPTH_UNITS = 65534
INVALID_UNITS = 65535
NEAR_MM = 10.0
LUMA_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
SSIM_WINDOW = 11
SSIM_SIGMA = 1.5
COLOR_LEVELS = 256
BYTES_PER_CELL = 4
BYTES_PER_POSE = 24
# Half a nanometre: keeps errors of exactly 10 mm inside whatever the depth unit is.
ROUNDING_MM = 5e-7


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
    weighted: NDArray[np.float32] = LUMA_WEIGHTS[0] * red + LUMA_WEIGHTS[1] * green + LUMA_WEIGHTS[2] * blue
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
    """Colour measures of one frame or their mean; names as in the JSON report."""

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


def depth_units(depth: NDArray[np.float32], depth_scale: float) -> NDArray[np.uint16]:
    """Round a depth map to the units of a 16-bit depth picture.

    Parameters
    ----------
    depth
        float32 metres, 0 = no measurement.
    depth_scale
        Units per metre.

    Returns
    -------
    uint16, 0 = no measurement; depths that 16 bits cannot hold, and their saturated value 65535,
    count as no measurement.
    """
    units = np.rint(depth * np.float32(depth_scale))
    return np.where((units > 0) & (units <= MAX_DEPTH_UNITS), units, 0).astype(np.uint16)


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthErrors:
    """Errors of depth over any number of frames; add two of them to pool their pixels.

    Attributes
    ----------
    unit_mm
        Millimetres per unit of the depth pictures.
    histogram
        (65536,) int64, number of pixels by absolute error in units, where both depths are valid.
    within_1pct
        Pixels whose error is at most 1 % of the reference depth.
    valid, invalid
        Pixels with and without a reference depth.
    lost, invented
        Pixels valid only in the reference, and only in the decoded depth.
    """

    unit_mm: float
    histogram: NDArray[np.int64]
    within_1pct: int
    valid: int
    invalid: int
    lost: int
    invented: int

    @classmethod
    def measure(cls, reference: NDArray[np.uint16], decoded: NDArray[np.uint16], unit_mm: float) -> Self:
        """Compare two depth pictures (h, w) uint16 of one unit, 0 = no measurement."""
        known, drawn = reference > 0, decoded > 0
        both = known & drawn
        expected = reference[both].astype(np.int32)
        errors = np.abs(decoded[both].astype(np.int32) - expected)
        return cls(
            unit_mm=unit_mm,
            histogram=np.bincount(errors, minlength=INVALID_UNITS + 1).astype(np.int64),
            within_1pct=int(np.count_nonzero(100 * errors <= expected)),
            valid=int(np.count_nonzero(known)),
            invalid=int(np.count_nonzero(~known)),
            lost=int(np.count_nonzero(known & ~drawn)),
            invented=int(np.count_nonzero(drawn & ~known)),
        )

    def __add__(self, other: DepthErrors) -> DepthErrors:
        """Pool the pixels of both."""
        return DepthErrors(
            unit_mm=self.unit_mm,
            histogram=self.histogram + other.histogram,
            within_1pct=self.within_1pct + other.within_1pct,
            valid=self.valid + other.valid,
            invalid=self.invalid + other.invalid,
            lost=self.lost + other.lost,
            invented=self.invented + other.invented,
        )

    @property
    def compared(self) -> int:
        """Number of pixels valid on both sides."""
        return self.valid - self.lost

    def rmse_mm(self) -> float:
        """Return the root mean square error over compared pixels; NaN without any."""
        units = np.arange(len(self.histogram), dtype=np.float64)
        total = float(self.histogram @ units**2)
        return self.unit_mm * float(np.sqrt(total / self.compared)) if self.compared else float("nan")

    def quantile_mm(self, fraction: float) -> float:
        """Return the least error that `fraction` of the compared pixels do not exceed; NaN without any."""
        if not self.compared:
            return float("nan")
        reached = np.cumsum(self.histogram) >= max(1.0, fraction * self.compared)
        return self.unit_mm * int(np.argmax(reached))

    def within_mm(self, limit_mm: float) -> float:
        """Return the fraction of reference pixels with an error up to a limit; a lost pixel is a miss."""
        units = int((limit_mm + ROUNDING_MM) / self.unit_mm)
        return _fraction(int(self.histogram[: units + 1].sum()), self.valid)

    def quality(self) -> dict[str, float]:
        """Return all depth measures under their names in the JSON report."""
        return {
            "depth_rmse_mm": self.rmse_mm(),
            "depth_median_mm": self.quantile_mm(0.5),
            "depth_within_10mm": self.within_mm(NEAR_MM),
            "depth_within_1pct": _fraction(self.within_1pct, self.valid),
            "depth_p99_mm": self.quantile_mm(0.99),
            "depth_max_mm": self.quantile_mm(1.0),
            "depth_lost": _fraction(self.lost, self.valid),
            "depth_invented": _fraction(self.invented, self.invalid),
        }


def _fraction(part: int, whole: int) -> float:
    return part / whole if whole else 0.0


def bernoulli_entropy_bits(log_odds: ArrayLike) -> NDArray[np.float64]:
    """Return the entropy in bits of occupancies given by their log-odds; 0 log-odds is one bit."""
    magnitude = np.abs(np.asarray(log_odds, dtype=np.float64))
    tail = np.exp(-magnitude)
    return np.asarray((np.log1p(tail) + magnitude * tail / (1 + tail)) / np.log(2.0))


@cache
def _gaussian_entropy_table() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    log_precision = np.linspace(-20.0, 6.0, 521)
    level = np.arange(COLOR_LEVELS) - COLOR_LEVELS // 2
    weight = np.exp(-0.5 * np.exp2(log_precision)[:, None] * level**2)
    probability = weight / weight.sum(axis=1, keepdims=True)
    logarithm = np.log2(probability, out=np.zeros_like(probability), where=probability > 0)
    return log_precision, -np.sum(probability * logarithm, axis=1)


def gaussian_entropy_bits(precision: ArrayLike) -> NDArray[np.float64]:
    """Return the entropy in bits of one colour channel given by the precision of its posterior.

    The posterior is a Gaussian on the 256 levels, ``P(k) ~ exp(-precision (k - mean)^2 / 2)``, taken
    with its mean in the middle of the range. Precision 0 (nothing known) is 8 bits.

    Parameters
    ----------
    precision
        Inverse variance, per squared level, of any shape.
    """
    log_precision, entropy = _gaussian_entropy_table()
    known = np.maximum(np.asarray(precision, dtype=np.float64), 2.0**-40)
    return np.asarray(np.interp(np.log2(known), log_precision, entropy, left=8.0, right=0.0))


@dataclass(frozen=True, kw_only=True)
class PaperAccounting:
    """Size of a sequence by equations (8) to (10) of Martins and Moura, 1995.

    Equation (9) counts the 8-bit video alone, not the range data, and equation (8) charges nothing
    for the background.

    Attributes
    ----------
    cells
        M, occupied cells of the moving objects.
    pose_frames
        F_m, frames that need a pose.
    frames
        F.
    pixels
        Pixels of a frame, 100 x 100 in the paper.
    """

    cells: float
    pose_frames: float
    frames: int
    pixels: int = 100 * 100

    @property
    def coded_bytes(self) -> float:
        """S_3DVC, eq. (8)."""
        return BYTES_PER_CELL * self.cells + BYTES_PER_POSE * self.pose_frames

    @property
    def raw_bytes(self) -> int:
        """S_raw, eq. (9)."""
        return self.pixels * self.frames

    @property
    def ratio(self) -> float:
        """N of the compression 1:N, the inverse of C in eq. (10); infinite when nothing is sent."""
        return self.raw_bytes / self.coded_bytes if self.coded_bytes else float("inf")
