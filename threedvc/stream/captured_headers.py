# SPDX-License-Identifier: MIT
"""Headers of the packets that hold pictures as captured: color, depth, and depth within a bound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from threedvc.limits import MAX_MAGNIFICATION, MAX_TILE_BYTES, MAX_VIDEO_SIDE
from threedvc.stream.header_fields import bitmap, flag, integer, key, number
from threedvc.stream.headers import SensorRunHeader
from threedvc.stream.packets import PacketType

__all__ = ["ColorVideoHeader", "DepthVideoHeader", "ResidualHeader", "VideoHeader"]


@dataclass(frozen=True, kw_only=True)
class VideoHeader(SensorRunHeader):
    """What a `DepthVideoHeader` tells, of the eight bits that earlier writers coded depth in."""

    packet_type: ClassVar[PacketType] = PacketType.VIDEO

    columns: int = key("w", integer(1, MAX_VIDEO_SIDE))
    rows: int = key("h", integer(1, MAX_VIDEO_SIDE))
    nearest_m: float = key("z", number(1e-6, 1e6))
    ratio: float = key("r", number(1, 1.2))
    complete: bool = key("c", flag(), default=False)


@dataclass(frozen=True, kw_only=True)
class PictureRunHeader(SensorRunHeader):
    """Base of the headers of videos.

    Attributes
    ----------
    columns, rows
        Size of the pictures, which cover those of the camera.
    codec
        What the pictures are coded by, see `VideoCodec`.
    bits
        Of a sample.
    """

    columns: int = key("w", integer(1, MAX_VIDEO_SIDE))
    rows: int = key("h", integer(1, MAX_VIDEO_SIDE))
    codec: int = key("c", integer(1, 255), default=1)
    bits: int = key("b", integer(8, 16), default=10)


@dataclass(frozen=True, kw_only=True)
class ColorVideoHeader(PictureRunHeader):
    """Color as filmed in `count` frames of a sensor from `frame` on, which stands for the drawn one in these alone.

    Attributes
    ----------
    magnified
        Chroma is 1 + magnified/4 times as large as it is by its formula.
    """

    packet_type: ClassVar[PacketType] = PacketType.COLOR_VIDEO

    magnified: int = key("m", integer(0, MAX_MAGNIFICATION), default=0)


@dataclass(frozen=True, kw_only=True)
class DepthVideoHeader(PictureRunHeader):
    """Depth as filmed in `count` frames of a sensor from `frame` on, which stands for the drawn one in these alone.

    Attributes
    ----------
    nearest_m, ratio
        Depth that the value 0 means, and of each value to the one before, with law 1 on an average.
    complete
        Whether something is everywhere, also where nothing is drawn.
    tiles
        Where the pictures are shown, see `threedvc.render.captured_depth.pack_tiles`; empty: everywhere.
    law
        How depths go with values, see `threedvc.render.captured_depth.DepthLaw`.
    """

    packet_type: ClassVar[PacketType] = PacketType.DEPTH_VIDEO

    nearest_m: float = key("z", number(1e-6, 1e6))
    ratio: float = key("r", number(1, 1.05))
    complete: bool = key("a", flag(), default=False)
    tiles: bytes = key("t", bitmap(MAX_TILE_BYTES), default=b"")
    law: int = key("l", integer(0, 1), default=0)


@dataclass(frozen=True, kw_only=True)
class ResidualHeader(SensorRunHeader):
    """Depth as measured in `count` frames of a sensor from `frame` on, which stands for the drawn one in these alone.

    Attributes
    ----------
    kind
        What the bound of its error is measured in: 0 meters, 1 shares of the depth, 2 levels of the sensor, 3 nothing,
        as there is no error.
    bound
        Meters, or a share.
    saturated
        Whether it is told which pixels without a measurement hold the largest raw depth in place of 0.
    """

    packet_type: ClassVar[PacketType] = PacketType.RESIDUAL

    kind: int = key("k", integer(0, 3), default=3)
    bound: float = key("e", number(0.0, 100.0), default=0.0)
    saturated: bool = key("u", flag(), default=False)
