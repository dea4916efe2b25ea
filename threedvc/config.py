# SPDX-License-Identifier: MIT
"""Choices of the encoder, one frozen dataclass per stage, checked when made."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from threedvc.choices import (
    ColorVideo,
    DepthErrorKind,
    DepthVideo,
    FilterParts,
    Motion,
    Preset,
    SegmentationMode,
    Sensor,
)
from threedvc.errors import ConfigError
from threedvc.limits import MAX_RELIEF_BITS
from threedvc.parallel import default_threads

__all__ = [
    "AppearanceConfig",
    "ColorConfig",
    "ColorVideo",
    "DepthErrorConfig",
    "DepthErrorKind",
    "DepthVideo",
    "EncoderConfig",
    "ExplorationConfig",
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
    "with_preset",
    "with_quality",
    "with_step",
]

MIN_VOXEL_SIZE_M = 0.0005
"""Half a millimetre: depth pictures in millimetres tell no more."""
MAX_VOXEL_SIZE_M = 1.0
"""More is a slip of the unit: of a room few cells would be left."""
MIN_STEP, MAX_STEP = 0.5, 255.0
"""Grey levels: half of one, which rounding hides, and the largest that a stream can tell (4080 sixteenths)."""
MAX_FOCUS = 100.0
"""Steps are divided by its root: ten times as fine as the default is about a level."""
MAX_DEPTH_ERROR_M, MAX_DEPTH_ERROR = 1.0, 0.5
"""Metres, and a share of the depth: with more nothing is left of it."""
MAX_OBJECT = 255
"""Largest label of an 8-bit mask."""
MAX_CANDIDATES = 100_000
"""More is a slip: each view is judged by thousands of rays."""
MIN_BPS = 500
"""With less, ten seconds would not hold what a file takes besides surfaces (`rate_control.HEAD_BYTES`)."""
MIN_LIVE_BPS = 8000
"""A kilobyte a second, of which 30 frames without surfaces take some 270 bytes (`rate_control.FRAME_BYTES`)."""
MIDDLE_QUALITY = 50
"""The default, in the middle of 1 to 100."""
QUALITY_PER_STEP = 16
"""More halve the steps of colours (decision 0010): about three halvings to either side of the middle."""
QUALITY_PER_CELL = 50
"""More halve the edge of cells (decision 0010): once to either side, as it makes four times as many."""
LUMA_STEP = 12.0
"""Grey levels, at the middle quality; by taste: finer steps take bytes for noise."""
CHROMA_STEP = 1.75
"""Times the step of luma; by taste: the eye sees chroma less sharply."""
ROUNDS = {"fast": 0, "medium": 3, "slow": 8}
"""Of alignment, by preset. Measured on the kitchen (decision 0008): three give 0.5 dB, further ones 0.1 dB each."""
MIN_CRF, MAX_COARSENESS, MIDDLE_COARSENESS = 1.0, 76.0, 56.0
"""Coarseness of a video: the finest quantisation of AV1, the coarsest with pictures of half the size, and that of the
middle quality, at which recordings of hand-held cameras have 33 dB and more."""
COARSENESS_PER_QUALITY = 1.1
"""By which quality 90 comes to 40 dB on recordings of noisy cameras, and 32 to the coarsest."""
VIDEO_QUALITY = 32
"""The least with a colour video, the coarsest there is; below are models in their own colours, at the rates of the
paper."""
VIDEO_PRESETS = {"fast": 7, "medium": 4, "slow": 2}
"""Of SVT-AV1, by preset. Measured on the kitchen: 4 takes 0.09 s a picture, 2 takes 2.5 times as long for 7 % fewer
bytes."""


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
    """Bayesian integration of depth and colour.

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
    """Colour coding: quantisation steps in grey levels for luma and chroma; those of the middle quality unless told."""

    luma_step: float = LUMA_STEP
    chroma_step: float = CHROMA_STEP * LUMA_STEP

    def __post_init__(self) -> None:
        if not (MIN_STEP <= self.luma_step <= MAX_STEP and MIN_STEP <= self.chroma_step <= MAX_STEP):
            raise ConfigError(
                f"colour steps {self.luma_step}, {self.chroma_step} must be within {MIN_STEP}..{MAX_STEP}"
            )


@dataclass(frozen=True, kw_only=True)
class AppearanceConfig:
    """Fit of colours, gains and poses to the pictures that the decoder draws; files only.

    Attributes
    ----------
    rounds
        How often poses are aligned with the fitted colours, as the preset ``medium`` does it; 0 fits colours and gains
        alone.
    texture_scale
        Colours along an edge of a cell: 1, 2 or 4. More than one is no better at equal bytes than smaller cells
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
        Metres, or a share of the depth; of no meaning for the others.
    """

    kind: DepthErrorKind = DepthErrorKind.MODEL
    size: float = 0.0

    def __post_init__(self) -> None:
        largest = {DepthErrorKind.ABSOLUTE: MAX_DEPTH_ERROR_M, DepthErrorKind.RELATIVE: MAX_DEPTH_ERROR}.get(self.kind)
        if largest is not None and not 0 < self.size <= largest:
            raise ConfigError(f"a depth error of {self.size:g} must be more than 0 and at most {largest:g}")


@dataclass(frozen=True, kw_only=True)
class RegionOfInterest:
    """Where squared errors of colours count more than elsewhere, or less: an object or a part of the background.

    Attributes
    ----------
    weight
        By how much more.
    number
        The object, or None.
    box_m
        ``x0, x1, y0, y1, z0, z1``, bounds in metres in the background's frame, or None.
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
    """Pose coding: quantisation steps; None: about a third of a pixel."""

    translation_step_m: float | None = None
    rotation_step_rad: float | None = None

    def __post_init__(self) -> None:
        if any(step is not None and not step > 0 for step in (self.translation_step_m, self.rotation_step_rad)):
            raise ConfigError(f"pose steps {self.translation_step_m} m, {self.rotation_step_rad} rad must be positive")


@dataclass(frozen=True, kw_only=True)
class VideoConfig:
    """Coding of a colour video.

    Attributes
    ----------
    coarseness
        From 1, the finest, to 76 in quarters: quantisation of AV1 (its CRF), the last of them with smaller pictures;
        about seven more halve the bytes. Of no meaning with a rate.
    preset
        Work of the encoder, the most at 0.
    lossless
        Whether pictures come back exactly as they were (FFV1), in as many bytes as that takes; coarseness and preset
        mean nothing then.
    """

    coarseness: float = MIDDLE_COARSENESS
    preset: int = VIDEO_PRESETS["medium"]
    lossless: bool = False

    def __post_init__(self) -> None:
        if not (MIN_CRF <= self.coarseness <= MAX_COARSENESS and 4 * self.coarseness == round(4 * self.coarseness)):
            raise ConfigError(
                f"coarseness {self.coarseness:g} of a video must be within {MIN_CRF:g}..{MAX_COARSENESS:g}, in quarters"
            )
        if not 0 <= self.preset <= 13:
            raise ConfigError(f"preset {self.preset} of a video must be within 0..13")


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
        Where errors of colours count more; all that a place lies in are multiplied.
    cell_factor
        By how much wider cells are than the object's distance suggests, 1 at the middle quality; of no meaning with
        `voxel_size_m`.
    bitrate_bps
        Bits per second that the stream shall take, or None. A file comes within 5 %, unless cells and steps have
        reached their bounds; a live stream keeps below it with a buffer of `live_buffer_s`.
    live_buffer_s
        How many seconds' worth of bits a live stream may send at once: as much as a viewer waits for at the start.
    refine
        Calibrate the colour camera and register all frames again once the model is finished; needs
        frames that can be read more than once.
    depth_video
        See `DepthVideo`.
    depth_error
        See `DepthErrorConfig`; the bytes of such depth follow from it.
    color_video, video
        See `ColorVideo` and `VideoConfig`.
    causal
        Send each group as soon as it is fused (live); otherwise fuse everything first.
    batch_frames
        Frames whose packets are written together, or None for one second's worth live and two of a file.
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
    color_video: ColorVideo = ColorVideo.AUTO
    video: VideoConfig = field(default_factory=VideoConfig)
    causal: bool = False
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
        if self.causal and self.depth_video is DepthVideo.ON:
            raise ConfigError("a live stream cannot have a depth video; leave out --depth-video on or --preset live")
        if self.causal and self.color_video is ColorVideo.ON:
            raise ConfigError("a live stream cannot have a colour video; leave out --color-video on or --preset live")
        if self.causal and self.depth_error.kind is not DepthErrorKind.MODEL:
            raise ConfigError(
                "a live stream cannot hold depth within a bound; leave out --depth-error or --preset live"
            )
        if self.video.lossless and self.color_video is not ColorVideo.ON:
            raise ConfigError("colours without loss are a video; give --color-video on")
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


def with_quality(config: EncoderConfig, quality: int) -> EncoderConfig:
    """Return the choices for a quality of 1 to 100; 50 is the default.

    Sixteen more halve the quantisation steps of colours, fifty more the edge of a cell. Below `VIDEO_QUALITY` there is
    no colour video unless it is asked for.

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
        video=replace(config.video, coarseness=_coarseness(quality)),
        color_video=ColorVideo.OFF if too_low else config.color_video,
    )


def _coarseness(quality: int) -> float:
    coarseness = MIDDLE_COARSENESS + COARSENESS_PER_QUALITY * (MIDDLE_QUALITY - quality)
    return min(max(round(4 * coarseness) / 4, MIN_CRF), MAX_COARSENESS)


def with_step(luma_step: float) -> ColorConfig:
    """Return colour steps in their usual relation."""
    return ColorConfig(luma_step=min(luma_step, MAX_STEP), chroma_step=min(CHROMA_STEP * luma_step, MAX_STEP))


def with_preset(config: EncoderConfig, preset: Preset) -> EncoderConfig:
    """Return the choices for an amount of work."""
    if preset is Preset.LIVE:
        return replace(config, causal=True)
    return replace(
        config,
        refine=preset is not Preset.FAST,
        appearance=replace(config.appearance, rounds=ROUNDS[preset]),
        video=replace(config.video, preset=VIDEO_PRESETS[preset]),
    )


@dataclass(frozen=True, kw_only=True)
class RenderConfig:
    """Choices of the decoder's renderer.

    Attributes
    ----------
    supersample
        Rays per pixel side for colour, or None for 2 on small pictures and 1 on large ones.
    filter_parts
        Where the stream's filter of pictures is applied.
    captured_depth, captured_color
        Whether depth and colour as they were captured stand for those of the models, where the stream has a video.
    threads
        Number of threads; pictures do not depend on it.
    """

    supersample: int | None = None
    filter_parts: FilterParts = FilterParts.ALL
    captured_depth: bool = True
    captured_color: bool = True
    threads: int = field(default_factory=default_threads)

    def __post_init__(self) -> None:
        if self.supersample is not None and not 1 <= self.supersample <= 4:
            raise ConfigError(f"supersampling {self.supersample} must be within 1..4")
        if self.threads < 1:
            raise ConfigError(f"number of threads {self.threads} must be at least 1")


@dataclass(frozen=True, kw_only=True)
class ExplorationConfig:
    """Choices of the search for views to record next.

    Attributes
    ----------
    candidates
        Views of each explored object to choose from (decision 0015 ranks as many); the time goes with their number.
    best
        How many to propose: enough to choose another one where the first cannot be reached.
    sensor
        The sensor that will take them; a Kinect, as most recordings are of its kind.
    objects
        Numbers of the objects to explore, 0 for all that rests; None: what moves against the camera.
    threads
        Number of threads; proposals do not depend on it.
    """

    candidates: int = 200
    best: int = 5
    sensor: Sensor = Sensor.KINECT1
    objects: tuple[int, ...] | None = None
    threads: int = field(default_factory=default_threads)

    def __post_init__(self) -> None:
        if not 1 <= self.candidates <= MAX_CANDIDATES:
            raise ConfigError(f"number of candidates {self.candidates} must be within 1..{MAX_CANDIDATES}")
        if self.best < 1:
            raise ConfigError(f"number of proposals {self.best} must be at least 1")
        if self.sensor is Sensor.AUTO:
            raise ConfigError("a stream does not tell the sensor of views to come; name one")
        if self.threads < 1:
            raise ConfigError(f"number of threads {self.threads} must be at least 1")
