# SPDX-License-Identifier: MIT
"""Choices of the encoder, one frozen dataclass per stage, checked when made."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from threedvc.errors import ConfigError
from threedvc.parallel import default_threads

__all__ = [
    "ColorConfig",
    "EncoderConfig",
    "FusionConfig",
    "Motion",
    "PoseConfig",
    "RenderConfig",
    "SegmentationConfig",
    "SegmentationMode",
    "Sensor",
]

MIN_VOXEL_SIZE_M = 0.0005
MAX_VOXEL_SIZE_M = 1.0


class Motion(StrEnum):
    """Where poses come from."""

    AUTO = "auto"
    KNOWN = "known"
    TRACK = "track"


class Sensor(StrEnum):
    """Noise of the depth sensor, see `threedvc.sensor_model`."""

    AUTO = "auto"
    IDEAL = "ideal"
    KINECT1 = "kinect1"
    REALSENSE = "realsense"
    LIDAR = "lidar"


class SegmentationMode(StrEnum):
    """How a frame is divided into objects."""

    AUTO = "auto"
    NONE = "none"
    DEPTH = "depth"
    MASKS = "masks"


@dataclass(frozen=True, kw_only=True)
class SegmentationConfig:
    """Division of a frame into objects; `near_m` and `far_m` bound the object of the depth threshold."""

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
    """Bayesian integration of depth and colour.

    Attributes
    ----------
    band_sigmas
        Half width of the window of the ray sum, in standard deviations of the sensor.
    max_log_odds
        Bound of a cell's log-odds, so that change stays possible.
    """

    band_sigmas: float = 3.0
    max_log_odds: float = 8.0

    def __post_init__(self) -> None:
        if self.band_sigmas <= 0 or self.max_log_odds <= 0:
            raise ConfigError(f"band_sigmas {self.band_sigmas} and max_log_odds {self.max_log_odds} must be positive")


@dataclass(frozen=True, kw_only=True)
class ColorConfig:
    """Colour coding: quantisation steps in grey levels for luma and for chroma."""

    luma_step: float = 16.0
    chroma_step: float = 28.0

    def __post_init__(self) -> None:
        if self.luma_step < 1 or self.chroma_step < 1:
            raise ConfigError(f"colour steps {self.luma_step}, {self.chroma_step} must be at least 1")


@dataclass(frozen=True, kw_only=True)
class PoseConfig:
    """Pose coding: quantisation steps."""

    translation_step_m: float = 0.0005
    rotation_step_rad: float = 0.00025

    def __post_init__(self) -> None:
        if self.translation_step_m <= 0 or self.rotation_step_rad <= 0:
            raise ConfigError(f"pose steps {self.translation_step_m} m, {self.rotation_step_rad} rad must be positive")


@dataclass(frozen=True, kw_only=True)
class EncoderConfig:
    """All choices of the encoder.

    Attributes
    ----------
    voxel_size_m
        Edge of a cell, or None to derive it from the first frame.
    max_depth_m
        Measurements beyond are ignored, or None.
    motion, sensor
        See `Motion` and `Sensor`.
    refine
        Calibrate the colour camera and register all frames again once the model is finished; needs
        frames that can be read more than once.
    causal
        Send each group as soon as it is fused (live); otherwise fuse everything first.
    group_frames
        Frames whose packets are written together, or None for one second's worth.
    threads
        Number of threads; the stream does not depend on it.
    """

    voxel_size_m: float | None = None
    max_depth_m: float | None = None
    motion: Motion = Motion.AUTO
    sensor: Sensor = Sensor.AUTO
    segmentation: SegmentationConfig = field(default_factory=SegmentationConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)
    color: ColorConfig = field(default_factory=ColorConfig)
    pose: PoseConfig = field(default_factory=PoseConfig)
    refine: bool = True
    causal: bool = False
    group_frames: int | None = None
    threads: int = field(default_factory=default_threads)

    def __post_init__(self) -> None:
        if self.voxel_size_m is not None and not MIN_VOXEL_SIZE_M <= self.voxel_size_m <= MAX_VOXEL_SIZE_M:
            raise ConfigError(
                f"voxel size {self.voxel_size_m} m is not within {MIN_VOXEL_SIZE_M}..{MAX_VOXEL_SIZE_M} m; try 16mm"
            )
        if self.max_depth_m is not None and not self.max_depth_m > 0:
            raise ConfigError(f"maximum depth {self.max_depth_m} m must be positive")
        if self.group_frames is not None and self.group_frames < 1:
            raise ConfigError(f"group of {self.group_frames} frames must have at least one frame")
        if self.threads < 1:
            raise ConfigError(f"number of threads {self.threads} must be at least 1")


@dataclass(frozen=True, kw_only=True)
class RenderConfig:
    """Choices of the decoder's renderer.

    Attributes
    ----------
    supersample
        Rays per pixel side for colour, or None for 2 on small pictures and 1 on large ones.
    threads
        Number of threads; pictures do not depend on it.
    """

    supersample: int | None = None
    threads: int = field(default_factory=default_threads)

    def __post_init__(self) -> None:
        if self.supersample is not None and not 1 <= self.supersample <= 4:
            raise ConfigError(f"supersampling {self.supersample} must be within 1..4")
        if self.threads < 1:
            raise ConfigError(f"number of threads {self.threads} must be at least 1")
