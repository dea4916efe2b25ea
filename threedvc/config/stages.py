# SPDX-License-Identifier: MIT
"""Choices of the encoder's stages, one frozen dataclass each, checked when made."""

from __future__ import annotations

from dataclasses import dataclass

from threedvc.config.choices import DepthErrorKind, SegmentationMode
from threedvc.errors import ConfigError
from threedvc.limits import MAX_RELIEF_BITS

__all__ = [
    "AppearanceConfig",
    "ColorConfig",
    "DepthErrorConfig",
    "FusionConfig",
    "PoseConfig",
    "RegionOfInterest",
    "SegmentationConfig",
    "VideoConfig",
]

MIN_STEP, MAX_STEP = 0.5, 255.0
"""Gray levels: half of one, which rounding hides, and the largest that a stream can tell (4080 sixteenths)."""
MAX_FOCUS = 100.0
"""Steps are divided by its root: ten times as fine as the default is about a level."""
MAX_DEPTH_ERROR_M, MAX_DEPTH_ERROR = 1.0, 0.5
"""Meters, and a share of the depth: with more nothing is left of it."""
MAX_OBJECT = 255
"""Largest label of an 8-bit mask."""
LUMA_STEP = 12.0
"""Gray levels, at the middle quality; by taste: finer steps take bytes for noise."""
CHROMA_STEP = 1.75
"""Times the step of luma; by taste: the eye sees chroma less sharply."""
ROUNDS = {"fast": 0, "medium": 3, "slow": 8}
"""Of alignment, by preset. Measured on the kitchen (decision 0008): three give 0.5 dB, further ones 0.1 dB each."""
MIN_CRF, MAX_COARSENESS, MIDDLE_COARSENESS = 1.0, 82.75, 56.0
"""Coarseness of a video: the finest quantization of AV1, the coarsest with pictures of a quarter of the sides, and that
of the middle quality, at which recordings of hand-held cameras have 33 dB and more."""
MIDDLE_PSNR_DB = 29.3
"""PSNR that a video of the middle quality has at least, on noisy recordings, too: what looks right at first sight."""
VIDEO_PRESETS = {"live": 7, "fast": 7, "medium": 4, "slow": 2}
"""Of SVT-AV1, by preset. Measured on the kitchen: 4 takes 0.09 s a picture, 2 takes 2.5 times as long for 7 % fewer
bytes; live, 7 has half a dB more than 9 for 5 % more time in all (decision 0040)."""


@dataclass(frozen=True, kw_only=True)
class SegmentationConfig:
    """Division of a frame into objects.

    Attributes
    ----------
    mode
        See `SegmentationMode`.
    near_m, far_m
        Bounds of the object of the depth threshold; an empty range unless it is asked for.
    """

    mode: SegmentationMode = SegmentationMode.AUTO
    near_m: float = 0.0
    far_m: float = 0.0

    def __post_init__(self) -> None:
        if self.mode is SegmentationMode.DEPTH and not 0 <= self.near_m < self.far_m:
            raise ConfigError(
                f"depth range {self.near_m} m .. {self.far_m} m is empty; give it as depth:NEAR..FAR with NEAR < FAR"
            )


@dataclass(frozen=True, kw_only=True)
class FusionConfig:
    """Bayesian integration of depth and color.

    Attributes
    ----------
    band_sigmas
        Half width of the window of the ray sum, in standard deviations of the sensor: three hold 99.7 % of the
        measurements (decision 0002).
    max_log_odds
        Bound of a cell's log-odds, so that change stays possible: odds of e^8, 3000 to 1.
    """

    band_sigmas: float = 3.0
    max_log_odds: float = 8.0

    def __post_init__(self) -> None:
        if self.band_sigmas <= 0 or self.max_log_odds <= 0:
            raise ConfigError(f"band_sigmas {self.band_sigmas} and max_log_odds {self.max_log_odds} must be positive")


@dataclass(frozen=True, kw_only=True)
class ColorConfig:
    """Color coding: quantization steps in gray levels for luma and chroma; those of the middle quality unless told."""

    luma_step: float = LUMA_STEP
    chroma_step: float = CHROMA_STEP * LUMA_STEP

    def __post_init__(self) -> None:
        if not (MIN_STEP <= self.luma_step <= MAX_STEP and MIN_STEP <= self.chroma_step <= MAX_STEP):
            raise ConfigError(f"color steps {self.luma_step}, {self.chroma_step} must be within {MIN_STEP}..{MAX_STEP}")


@dataclass(frozen=True, kw_only=True)
class AppearanceConfig:
    """Fit of colors, gains and poses to the pictures that the decoder draws; files only.

    Attributes
    ----------
    rounds
        How often poses are aligned with the fitted colors, as the preset ``medium`` does it; 0 fits colors and gains
        alone.
    texture_scale
        Colors along an edge of a cell: 1, 2 or 4. More than one is no better at equal bytes than smaller cells
        (decision 0008).
    relief_bits
        Binary logarithm of the places in a cell that the surface may pass, 0 to 3; None: 1 where that is cheap, else 0.
    """

    rounds: int = ROUNDS["medium"]
    texture_scale: int = 1
    relief_bits: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.rounds <= 20:
            raise ConfigError(f"rounds {self.rounds} of alignment must be within 0..20")
        if self.texture_scale not in (1, 2, 4):
            raise ConfigError(f"texture scale {self.texture_scale} must be 1, 2 or 4")
        if self.relief_bits is not None and not 0 <= self.relief_bits <= MAX_RELIEF_BITS:
            raise ConfigError(f"relief bits {self.relief_bits} must be within 0..{MAX_RELIEF_BITS}")


@dataclass(frozen=True, kw_only=True)
class DepthErrorConfig:
    """How far decoded depth may lie from what was measured; files only.

    Attributes
    ----------
    kind
        See `DepthErrorKind`.
    size
        Meters, or a share of the depth; of no meaning for the others.
    """

    kind: DepthErrorKind = DepthErrorKind.MODEL
    size: float = 0.0

    def __post_init__(self) -> None:
        largest = {DepthErrorKind.ABSOLUTE: MAX_DEPTH_ERROR_M, DepthErrorKind.RELATIVE: MAX_DEPTH_ERROR}.get(self.kind)
        if largest is not None and not 0 < self.size <= largest:
            raise ConfigError(f"a depth error of {self.size:g} must be more than 0 and at most {largest:g}")


@dataclass(frozen=True, kw_only=True)
class RegionOfInterest:
    """Where squared errors of colors count more than elsewhere, or less: an object or a part of the background.

    Attributes
    ----------
    weight
        By how much more.
    number
        The object, or None.
    box_m
        ``x0, x1, y0, y1, z0, z1``, bounds in meters in the background's frame, or None.
    """

    weight: float
    number: int | None = None
    box_m: tuple[float, float, float, float, float, float] | None = None

    def __post_init__(self) -> None:
        if not 1 / MAX_FOCUS <= self.weight <= MAX_FOCUS:
            raise ConfigError(f"focus weight {self.weight:g} must be within {1 / MAX_FOCUS:g}..{MAX_FOCUS:g}")
        if (self.number is None) == (self.box_m is None):
            raise ConfigError("a focus is on an object or on a box; give one of them")
        if self.number is not None and not 0 <= self.number <= MAX_OBJECT:
            raise ConfigError(f"focus on object {self.number}: objects are numbered from 0 to {MAX_OBJECT}")
        if self.box_m is not None and not all(self.box_m[k] < self.box_m[k + 1] for k in (0, 2, 4)):
            bounds = ",".join(f"{self.box_m[k]:g}..{self.box_m[k + 1]:g}" for k in (0, 2, 4))
            raise ConfigError(f"focus on the empty box {bounds}; give it as X0..X1,Y0..Y1,Z0..Z1 with rising bounds")


@dataclass(frozen=True, kw_only=True)
class PoseConfig:
    """Pose coding: quantization steps; None: about a third of a pixel."""

    translation_step_m: float | None = None
    rotation_step_rad: float | None = None

    def __post_init__(self) -> None:
        if any(step is not None and not step > 0 for step in (self.translation_step_m, self.rotation_step_rad)):
            raise ConfigError(f"pose steps {self.translation_step_m} m, {self.rotation_step_rad} rad must be positive")


@dataclass(frozen=True, kw_only=True)
class VideoConfig:
    """Coding of a color video.

    Attributes
    ----------
    coarseness
        From 1, the finest, to 82.75 in quarters: quantization of AV1 (its CRF), the last of them with smaller pictures;
        about seven more halve the bytes. Of no meaning with a rate.
    min_psnr_db
        Mean PSNR of the pictures, of red, green and blue, that they have at least without a rate: the video is less
        coarse where it takes that.
    preset
        Work of the encoder, the most at 0.
    lossless
        Whether pictures come back exactly as they were (FFV1), in as many bytes as that takes; coarseness and preset
        mean nothing then.
    """

    coarseness: float = MIDDLE_COARSENESS
    min_psnr_db: float = 0.0
    preset: int = VIDEO_PRESETS["medium"]
    lossless: bool = False

    def __post_init__(self) -> None:
        if not (MIN_CRF <= self.coarseness <= MAX_COARSENESS and 4 * self.coarseness == round(4 * self.coarseness)):
            raise ConfigError(
                f"coarseness {self.coarseness:g} of a video must be within {MIN_CRF:g}..{MAX_COARSENESS:g}, in quarters"
            )
        if not 0 <= self.preset <= 13:
            raise ConfigError(f"preset {self.preset} of a video must be within 0..13")
