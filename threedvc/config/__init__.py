# SPDX-License-Identifier: MIT
"""Choices of the encoder and of the renderer, checked when made."""

from threedvc.config.choices import (
    ColorVideo,
    DepthErrorKind,
    DepthVideo,
    Favor,
    FilterParts,
    Motion,
    Preset,
    SegmentationMode,
    Sensor,
)
from threedvc.config.drawing import ExplorationConfig, RenderConfig
from threedvc.config.encoder import DEPTH_WEIGHTS, EncoderConfig
from threedvc.config.presets import with_lossless, with_preset, with_quality, with_step
from threedvc.config.stages import (
    AppearanceConfig,
    ColorConfig,
    DepthErrorConfig,
    FusionConfig,
    PoseConfig,
    RegionOfInterest,
    SegmentationConfig,
    VideoConfig,
)

__all__ = [
    "DEPTH_WEIGHTS",
    "AppearanceConfig",
    "ColorConfig",
    "ColorVideo",
    "DepthErrorConfig",
    "DepthErrorKind",
    "DepthVideo",
    "EncoderConfig",
    "ExplorationConfig",
    "Favor",
    "FilterParts",
    "FusionConfig",
    "Motion",
    "PoseConfig",
    "Preset",
    "RegionOfInterest",
    "RenderConfig",
    "SegmentationConfig",
    "SegmentationMode",
    "Sensor",
    "VideoConfig",
    "with_lossless",
    "with_preset",
    "with_quality",
    "with_step",
]
