# SPDX-License-Identifier: MIT
"""All choices of the encoder."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

from threedvc.config.choices import ColorVideo, DepthErrorKind, DepthVideo, Favor, Motion, Sensor
from threedvc.config.stages import (
    MIDDLE_PSNR_DB,
    AppearanceConfig,
    ColorConfig,
    DepthErrorConfig,
    FusionConfig,
    PoseConfig,
    RegionOfInterest,
    SegmentationConfig,
    VideoConfig,
)
from threedvc.errors import ConfigError
from threedvc.parallel import default_threads

__all__ = ["DEPTH_WEIGHTS", "EncoderConfig"]

DEPTH_WEIGHTS = {Favor.NEITHER: 1.0, Favor.COLOR: 1 / 3, Favor.DEPTH: 3.0}
"""By hand: on the telephone's recording of a door from 29 to 36 dB at the same bytes (decision 0033)."""
MAX_DEPTH_WEIGHT = 100.0
"""With more, colors would count for nothing."""

MIN_VOXEL_SIZE_M = 0.0005
"""Half a millimeter: depth pictures in millimeters tell no more."""
MAX_VOXEL_SIZE_M = 1.0
"""More is a slip of the unit: of a room few cells would be left."""
MIN_BPS = 500
"""With less, ten seconds would not hold what a file takes besides surfaces (`rate_control.HEAD_BYTES`)."""
MIN_LIVE_BPS = 8000
"""A kilobyte a second, of which 30 frames without surfaces take some 270 bytes (`rate_control.FRAME_BYTES`)."""

MIN_LATENCY_S, MAX_LATENCY_S = 0.1, 10.0
"""Three frames at 30 frames/s, the fewest of which a run of pictures predicts some, to a group of a file's video."""


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
    other_sensors
        Those of the second sensor and further ones, where there are several; empty: all are as `sensor` says.
    focus
        Where errors of colors count more; all that a place lies in are multiplied.
    cell_factor
        By how much wider cells are than the object's distance suggests, 1 at the middle quality; of no meaning with
        `voxel_size_m`.
    bitrate_bps
        Bits per second that the stream shall take, or None. A file comes within 5 %, unless cells and steps have
        reached their bounds; a live stream keeps below it with a buffer of `live_buffer_s`.
    live_buffer_s
        How many seconds' worth of bits a live stream may send at once: as much as a viewer waits for at the start.
    refine
        Calibrate the color camera and register all frames again once the model is finished; needs
        frames that can be read more than once.
    depth_video
        See `DepthVideo`.
    depth_error
        See `DepthErrorConfig`; the bytes of such depth follow from it.
    depth_weight
        How many times as much as usual the misfit of depth counts where it is held against the error of colors, see
        `threedvc.encoder.rate.objective`.
    color_video, video
        See `ColorVideo` and `VideoConfig`.
    causal
        Send each group as soon as it is fused (live); otherwise fuse everything first.
    latency_s
        How long the first frame of a live stream's group waits for the others: the longer, the fewer bytes.
    batch_frames
        Frames whose packets are written together, or None for `latency_s` live and two seconds of a file.
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
    appearance: AppearanceConfig = field(default_factory=AppearanceConfig)
    pose: PoseConfig = field(default_factory=PoseConfig)
    other_sensors: tuple[Sensor, ...] = ()
    focus: tuple[RegionOfInterest, ...] = ()
    cell_factor: float = 1.0
    bitrate_bps: float | None = None
    live_buffer_s: float = 1.0
    refine: bool = True
    depth_video: DepthVideo = DepthVideo.AUTO
    depth_error: DepthErrorConfig = field(default_factory=DepthErrorConfig)
    depth_weight: float = DEPTH_WEIGHTS[Favor.NEITHER]
    color_video: ColorVideo = ColorVideo.AUTO
    video: VideoConfig = field(default_factory=partial(VideoConfig, min_psnr_db=MIDDLE_PSNR_DB))
    causal: bool = False
    latency_s: float = 1.0
    batch_frames: int | None = None
    threads: int = field(default_factory=default_threads)

    def __post_init__(self) -> None:
        if self.voxel_size_m is not None and not MIN_VOXEL_SIZE_M <= self.voxel_size_m <= MAX_VOXEL_SIZE_M:
            raise ConfigError(
                f"voxel size {self.voxel_size_m} m is not within {MIN_VOXEL_SIZE_M}..{MAX_VOXEL_SIZE_M} m; try 16mm"
            )
        if self.max_depth_m is not None and not self.max_depth_m > 0:
            raise ConfigError(f"maximum depth {self.max_depth_m} m must be positive")
        if not 1 / 16 <= self.cell_factor <= 16:
            raise ConfigError(f"cell factor {self.cell_factor} must be within 1/16..16")
        minimum = MIN_LIVE_BPS if self.causal else MIN_BPS
        if self.bitrate_bps is not None and not self.bitrate_bps >= minimum:
            raise ConfigError(f"a rate of {self.bitrate_bps:g} bit/s is too low; give at least {minimum / 1000:g}k")
        if not 0.1 <= self.live_buffer_s <= 60:
            raise ConfigError(f"a buffer of {self.live_buffer_s} s must be within 0.1..60 s")
        if not MIN_LATENCY_S <= self.latency_s <= MAX_LATENCY_S:
            raise ConfigError(
                f"a latency of {self.latency_s:g} s must be within {MIN_LATENCY_S:g}..{MAX_LATENCY_S:g} s; try 1s"
            )
        if not 0 < self.depth_weight <= MAX_DEPTH_WEIGHT:
            raise ConfigError(
                f"weight {self.depth_weight:g} of depth must be more than 0 and at most {MAX_DEPTH_WEIGHT:g}"
            )
        if self.causal and self.depth_video is DepthVideo.ON:
            raise ConfigError("a live stream cannot have a depth video; leave out --depth-video on or --preset live")
        if self.causal and self.video.lossless:
            raise ConfigError("a live stream cannot be lossless; leave out --lossless or --preset live")
        if self.causal and self.depth_error.kind is not DepthErrorKind.MODEL:
            raise ConfigError(
                "a live stream cannot hold depth within a bound; leave out --depth-error or --preset live"
            )
        if self.video.lossless and self.color_video is not ColorVideo.ON:
            raise ConfigError("colors without loss are a video; give --color-video on")
        if self.video.lossless and self.bitrate_bps is not None:
            raise ConfigError("a lossless video takes the bytes it needs; leave out the rate")
        if self.batch_frames is not None and self.batch_frames < 1:
            raise ConfigError(f"group of {self.batch_frames} frames must have at least one frame")
        if self.threads < 1:
            raise ConfigError(f"number of threads {self.threads} must be at least 1")

    def sensor_of(self, number: int) -> Sensor:
        """Return what is said of the noise of one of several sensors."""
        others = self.other_sensors
        return self.sensor if not number or not others else others[min(number, len(others)) - 1]
