# SPDX-License-Identifier: MIT
"""Packets: what the encoder emits and the decoder consumes.

A packet is a type, a header (a small map of short keys) and a payload. The container writes packets
to bytes and checks them on the way back; the core neither opens files nor knows about checksums.
Every header is declared once, as a frozen dataclass whose fields name their key in the stream.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import Any, ClassVar, Self, TypeVar

from threedvc.errors import CorruptStream

__all__ = [
    "BatchHeader",
    "ClockHeader",
    "EndHeader",
    "ModelHeader",
    "ObjectHeader",
    "Packet",
    "PacketType",
    "PoseHeader",
    "StreamHeader",
]


class PacketType(IntEnum):
    """Types of packets; 0x80 and above are private."""

    STREAM = 1
    OBJECT = 2
    MODEL = 3
    POSE = 4
    GAIN = 5
    SNAPSHOT = 6
    RESIDUAL = 7
    META = 8
    ATTACHMENT = 9
    CLOCK = 10
    BATCH = 11
    INDEX = 12
    END = 13


@dataclass(frozen=True, kw_only=True)
class Packet:
    """One packet.

    Attributes
    ----------
    type
        A `PacketType`, or a number unknown to this reader.
    header
        Map of short string keys to msgpack values.
    payload
        Bytes; their meaning depends on the type.
    critical
        Whether a reader that does not know the type must stop.
    random_access
        Whether decoding can start here.
    """

    type: int
    header: dict[str, Any] = field(default_factory=dict)
    payload: bytes = b""
    critical: bool = True
    random_access: bool = False


H = TypeVar("H", bound="Header")


def key(name: str, **options: Any) -> Any:
    """Declare a header field and its key in the stream."""
    return field(metadata={"key": name}, **options)


class Header:
    """Base of the header dataclasses: the one place that turns them into maps and back."""

    packet_type: ClassVar[PacketType]

    def to_map(self) -> dict[str, Any]:
        """Return the map that goes into the stream; None and default values are left out."""
        values = {}
        for item in fields(self):  # type: ignore[arg-type]
            value = getattr(self, item.name)
            if value != item.default:
                values[item.metadata["key"]] = list(value) if isinstance(value, tuple) else value
        return values

    @classmethod
    def from_map(cls, values: dict[str, Any]) -> Self:
        """Read a header from its map; keys unknown to this reader are passed over.

        Raises
        ------
        CorruptStream
            If a required key is missing or a value is of the wrong kind.
        """
        arguments = {}
        for item in fields(cls):  # type: ignore[arg-type]
            name = item.metadata["key"]
            if name in values:
                value = values[name]
                arguments[item.name] = tuple(value) if isinstance(value, list) else value
        try:
            return cls(**arguments)
        except (TypeError, ValueError) as error:
            raise CorruptStream(f"{cls.__name__} {values!r:.200} is not valid: {error}") from None

    def packet(self, payload: bytes = b"", **flags: bool) -> Packet:
        """Wrap the header and a payload into a packet."""
        return Packet(type=self.packet_type, header=self.to_map(), payload=payload, **flags)


@dataclass(frozen=True, kw_only=True)
class StreamHeader(Header):
    """What a reader must know before anything else.

    Attributes
    ----------
    min_reader
        Lowest reader version that understands the stream.
    required
        Names of features a reader must have.
    color_camera, depth_camera
        ``width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3``; no depth camera: the colour camera's.
    T_color_depth
        First three rows of the extrinsic, row by row (12 numbers); empty: identity.
    depth_scale
        Units per metre of 16-bit depth pictures, 0 = no measurement.
    start_ns, period_num, period_den
        Frame k stands at ``start_ns + k * period_num // period_den`` nanoseconds, unless a CLOCK
        packet corrects it.
    translation_step_m, rotation_step_rad
        Quantisation of poses.
    grey
        Whether the pictures have one channel.
    given_world
        Whether the world frame is the input's own; otherwise it is the camera at frame 0.
    name
        Name of the input sequence.
    """

    packet_type: ClassVar[PacketType] = PacketType.STREAM

    min_reader: int = key("v", default=1)
    required: tuple[str, ...] = key("req", default=())
    color_camera: tuple[float, ...] = key("cc")
    depth_camera: tuple[float, ...] = key("dc", default=())
    T_color_depth: tuple[float, ...] = key("tcd", default=())
    depth_scale: float = key("ds")
    start_ns: int = key("t0", default=0)
    period_num: int = key("pn")
    period_den: int = key("pd", default=1)
    translation_step_m: float = key("qt")
    rotation_step_rad: float = key("qr")
    grey: bool = key("g", default=False)
    given_world: bool = key("w", default=False)
    name: str = key("n", default="")


@dataclass(frozen=True, kw_only=True)
class ObjectHeader(Header):
    """One rigid object: its number and its tessellation.

    Attributes
    ----------
    object_id
        Number; 0 is the background, whose frame is the world.
    voxel_size_m
        Edge length of a cell.
    """

    packet_type: ClassVar[PacketType] = PacketType.OBJECT

    object_id: int = key("o")
    voxel_size_m: float = key("h")


@dataclass(frozen=True, kw_only=True)
class ModelHeader(Header):
    """A model update, applied before `frame` is drawn."""

    packet_type: ClassVar[PacketType] = PacketType.MODEL

    object_id: int = key("o", default=0)
    frame: int = key("f")


@dataclass(frozen=True, kw_only=True)
class PoseHeader(Header):
    """Poses of `count` consecutive frames from `frame` on; an object keeps its last pose otherwise.

    Object 0 carries T_camera_world, every other object T_world_object.
    """

    packet_type: ClassVar[PacketType] = PacketType.POSE

    object_id: int = key("o", default=0)
    frame: int = key("f")
    count: int = key("n", default=1)


@dataclass(frozen=True, kw_only=True)
class ClockHeader(Header):
    """Corrections in nanoseconds of the regular clock, for `count` frames from `frame` on."""

    packet_type: ClassVar[PacketType] = PacketType.CLOCK

    frame: int = key("f")
    count: int = key("n", default=1)


@dataclass(frozen=True, kw_only=True)
class BatchHeader(Header):
    """Packets of `count` frames from `frame` on, complete: these frames can be drawn."""

    packet_type: ClassVar[PacketType] = PacketType.BATCH

    frame: int = key("f")
    count: int = key("n")


@dataclass(frozen=True, kw_only=True)
class EndHeader(Header):
    """End of the stream: its number of frames and the digest of the decoded models."""

    packet_type: ClassVar[PacketType] = PacketType.END

    frames: int = key("n")
    digest: bytes = key("d")
