# SPDX-License-Identifier: MIT
"""Choices for an amount of work, a quality, or no loss at all."""

from __future__ import annotations

from dataclasses import replace

from threedvc.config.choices import ColorVideo, DepthErrorKind, Preset
from threedvc.config.encoder import EncoderConfig
from threedvc.config.stages import (
    CHROMA_STEP,
    MAX_COARSENESS,
    MAX_STEP,
    MIDDLE_COARSENESS,
    MIDDLE_PSNR_DB,
    MIN_CRF,
    ROUNDS,
    VIDEO_PRESETS,
    ColorConfig,
    DepthErrorConfig,
)
from threedvc.errors import ConfigError

__all__ = ["with_lossless", "with_preset", "with_quality", "with_step"]

MIDDLE_QUALITY = 50
"""The default, in the middle of 1 to 100."""
QUALITY_PER_STEP = 16
"""More halve the steps of colors (decision 0010): about three halvings to either side of the middle."""
QUALITY_PER_CELL = 50
"""More halve the edge of cells (decision 0010): once to either side, as it makes four times as many."""
COARSENESS_PER_QUALITY, COARSENESS_PER_LOW_QUALITY = 1.1, 1.25
"""By which quality 90 comes to 40 dB on recordings of noisy cameras, and 32, below the middle, to the coarsest."""
PSNR_PER_QUALITY, PSNR_PER_LOW_QUALITY = 0.275, 0.4
"""By which quality 90 has 40 dB at least, on noisy recordings, too; below the middle about as coarseness goes."""
VIDEO_QUALITY = 32
"""The least with a color video, the coarsest there is; below are models in their own colors, at the rates of the
paper."""


def with_quality(config: EncoderConfig, quality: int) -> EncoderConfig:
    """Return the choices for a quality of 1 to 100; 50 is the default.

    Sixteen more halve the quantization steps of colors, fifty more the edge of a cell. Below `VIDEO_QUALITY` there is
    no color video unless it is asked for. A video is as coarse as the quality says, but has 29 dB at 50 and 40 dB at
    90 at least.

    Raises
    ------
    ConfigError
        If the quality is out of range.
    """
    if not 1 <= quality <= 100:
        raise ConfigError(f"quality {quality} must be within 1..100")
    middle = ColorConfig()
    finer = 2.0 ** ((MIDDLE_QUALITY - quality) / QUALITY_PER_STEP)
    too_low = quality < VIDEO_QUALITY and config.color_video is ColorVideo.AUTO
    return replace(
        config,
        color=with_step(middle.luma_step * finer),
        cell_factor=2.0 ** ((MIDDLE_QUALITY - quality) / QUALITY_PER_CELL),
        video=replace(
            config.video,
            coarseness=_coarseness(quality),
            min_psnr_db=_min_psnr_db(quality),
        ),
        color_video=ColorVideo.OFF if too_low else config.color_video,
    )


def _coarseness(quality: int) -> float:
    below = MIDDLE_QUALITY - quality
    coarseness = MIDDLE_COARSENESS + (COARSENESS_PER_LOW_QUALITY if below > 0 else COARSENESS_PER_QUALITY) * below
    return min(max(round(4 * coarseness) / 4, MIN_CRF), MAX_COARSENESS)


def _min_psnr_db(quality: int) -> float:
    above = quality - MIDDLE_QUALITY
    return MIDDLE_PSNR_DB + (PSNR_PER_QUALITY if above > 0 else PSNR_PER_LOW_QUALITY) * above


def with_lossless(config: EncoderConfig) -> EncoderConfig:
    """Return the choices by which every color and depth comes back exactly."""
    return replace(
        config,
        color_video=ColorVideo.ON,
        video=replace(config.video, lossless=True),
        depth_error=DepthErrorConfig(kind=DepthErrorKind.LOSSLESS),
    )


def with_step(luma_step: float) -> ColorConfig:
    """Return color steps in their usual relation."""
    return ColorConfig(luma_step=min(luma_step, MAX_STEP), chroma_step=min(CHROMA_STEP * luma_step, MAX_STEP))


def with_preset(config: EncoderConfig, preset: Preset) -> EncoderConfig:
    """Return the choices for an amount of work."""
    if preset is Preset.LIVE:
        return replace(config, causal=True, video=replace(config.video, preset=VIDEO_PRESETS[preset]))
    return replace(
        config,
        refine=preset is not Preset.FAST,
        appearance=replace(config.appearance, rounds=ROUNDS[preset]),
        video=replace(config.video, preset=VIDEO_PRESETS[preset]),
    )
