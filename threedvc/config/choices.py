# SPDX-License-Identifier: MIT
"""Choices that have a name each."""

from __future__ import annotations

from enum import StrEnum

__all__ = [
    "ColorVideo",
    "DepthErrorKind",
    "DepthVideo",
    "Favor",
    "FilterParts",
    "Motion",
    "Preset",
    "SegmentationMode",
    "Sensor",
]


class Motion(StrEnum):
    """Where poses come from."""

    AUTO = "auto"
    KNOWN = "known"
    TRACK = "track"


class DepthVideo(StrEnum):
    """Whether a file carries a video of depth that the models do not tell, see `threedvc.render.captured_depth`.

    AUTO: if the stream gains more by it than it costs; the preset FAST has none. ON: as far as the rate leaves room.
    A live stream cannot have one.
    """

    AUTO = "auto"
    ON = "on"
    OFF = "off"


class DepthErrorKind(StrEnum):
    """How far decoded depth may lie from what was measured.

    MODEL: as far as the models, or a video, do. ABSOLUTE: some meters. RELATIVE: a share of the depth. LEVEL: to the
    next depth that the sensor tells at all. LOSSLESS: not at all.
    """

    MODEL = "model"
    ABSOLUTE = "absolute"
    RELATIVE = "relative"
    LEVEL = "level"
    LOSSLESS = "lossless"


class ColorVideo(StrEnum):
    """Whether a stream carries a video of the color pictures in place of the models' colors.

    AUTO: if the frames look better so at as many bytes; live, if the rate has room for one.
    """

    AUTO = "auto"
    ON = "on"
    OFF = "off"


class Favor(StrEnum):
    """What gets more of the bytes than usual."""

    NEITHER = "neither"
    COLOR = "color"
    DEPTH = "depth"


class Sensor(StrEnum):
    """Noise of the depth sensor, see `threedvc.frames.sensor_model`."""

    AUTO = "auto"
    IDEAL = "ideal"
    KINECT1 = "kinect1"
    REALSENSE = "realsense"
    LIDAR = "lidar"


class Preset(StrEnum):
    """How much work an encoder does.

    LIVE sends each group of frames as soon as it is fused. FAST fuses every frame first and fits colors to the drawn
    pictures. MEDIUM also calibrates the color camera and refines all poses. SLOW goes on with that for longer.
    """

    LIVE = "live"
    FAST = "fast"
    MEDIUM = "medium"
    SLOW = "slow"


class SegmentationMode(StrEnum):
    """How a frame is divided into objects; MOTION finds out what moves on its own.

    AUTO takes masks where there are some. Else it looks for motion in a file whose poses are refined, and divides it if
    something moves; a stream that is sent as it comes is not divided.
    """

    AUTO = "auto"
    NONE = "none"
    DEPTH = "depth"
    MASKS = "masks"
    MOTION = "motion"


class FilterParts(StrEnum):
    """Where the filter of drawn pictures works."""

    ALL = "all"
    NONE = "none"
    SILHOUETTES = "silhouettes"
    SURFACES = "surfaces"

    @property
    def at_silhouettes(self) -> bool:
        """Whether it works at silhouettes and near them."""
        return self in (FilterParts.ALL, FilterParts.SILHOUETTES)

    @property
    def on_surfaces(self) -> bool:
        """Whether it works elsewhere."""
        return self in (FilterParts.ALL, FilterParts.SURFACES)
