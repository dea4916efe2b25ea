# SPDX-License-Identifier: MIT
"""Packets: what the encoder emits and the decoder consumes.

A packet is a type, a header (a small map of short keys) and a payload. The container writes packets
to bytes and checks them on the way back; the core neither opens files nor knows about checksums.
Every header is declared once, as a frozen dataclass whose fields name their key in the stream.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import MISSING, dataclass, field, fields
from enum import IntEnum, IntFlag
from typing import Any, ClassVar, Self

from threedvc.errors import CorruptStream, LimitExceeded, UnsupportedVersion
from threedvc.limits import (
    MAX_BATCH_PACKETS,
    MAX_COUNT,
    MAX_FRAME,
    MAX_HEADER_BYTES,
    MAX_OBJECT_ID,
    MAX_PAYLOAD_BYTES,
    MAX_RELIEF_BITS,
    MAX_SENSORS,
    MAX_TEXTURE_BITS,
    MAX_VIDEO_SIDE,
)
from threedvc.stream.header_fields import Kind, blob, camera, extrinsic, flag, integer, key, names, number, text
from threedvc.stream.wire import ByteReader, pack_map, pack_varint, unpack_map

__all__ = [
    "DIGEST_BYTES",
    "FEATURES",
    "READER_VERSION",
    "RESERVED_TYPES",
    "TOP_LEVEL_TYPES",
    "BackdropHeader",
    "BatchHeader",
    "ClockHeader",
    "DepthHeader",
    "EndHeader",
    "FilterHeader",
    "GainHeader",
    "Header",
    "LightHeader",
    "ModelHeader",
    "ObjectHeader",
    "OrderHeader",
    "Packet",
    "PacketFlag",
    "PacketType",
    "PoseHeader",
    "ReliefHeader",
    "RunHeader",
    "SensorHeader",
    "SensorRunHeader",
    "ShiftHeader",
    "SnapshotHeader",
    "StreamHeader",
    "TextureHeader",
    "VideoHeader",
    "check_supported",
    "is_understood",
    "pack_batch",
    "split_batch",
    "type_name",
    "unpack_batch",
]

READER_VERSION = 1
"""Version of the meaning of packets; a stream names the lowest that its reader must have."""

FEATURES: frozenset[str] = frozenset()
"""Optional features that this reader has; a stream may require some by name."""

DIGEST_BYTES = 16
"""Bytes of the digest of the decoded models."""


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
    TEXTURE = 14
    SHIFT = 15
    BACKDROP = 16
    LIGHT = 17
    RELIEF = 18
    FILTER = 19
    DEPTH = 20
    SENSOR = 21
    ORDER = 22
    VIDEO = 23


RESERVED_TYPES = frozenset({PacketType.SNAPSHOT, PacketType.RESIDUAL})
"""Types whose payload has no coding yet: to this reader they are unknown."""

TOP_LEVEL_TYPES = frozenset(
    {
        PacketType.STREAM,
        PacketType.SENSOR,
        PacketType.SNAPSHOT,
        PacketType.BATCH,
        PacketType.INDEX,
        PacketType.END,
    }
)
"""Types that do not stand in a BATCH."""


_KNOWN_NUMBERS = frozenset(int(member) for member in PacketType)


class PacketFlag(IntFlag):
    """Flags of a packet, as stored."""

    CRITICAL = 1
    RANDOM_ACCESS = 2


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

    @property
    def flags(self) -> PacketFlag:
        """The flags as stored."""
        return PacketFlag(PacketFlag.CRITICAL * self.critical | PacketFlag.RANDOM_ACCESS * self.random_access)


def type_name(number: int) -> str:
    """Return the name of a packet type, for messages and reports."""
    return PacketType(number).name if number in _KNOWN_NUMBERS else f"type 0x{number:02x}"


def is_understood(type_number: int, critical: bool) -> bool:
    """Tell whether this reader knows a type of packets; one that it does not know is passed over.

    Raises
    ------
    UnsupportedVersion
        If the type is unknown and critical.
    """
    known = type_number in _KNOWN_NUMBERS and type_number not in RESERVED_TYPES
    if critical and not known:
        raise UnsupportedVersion(
            f"a packet of {type_name(type_number)} is needed to decode and unknown to this version; use a newer 3dvc"
        )
    return known


@dataclass(frozen=True, kw_only=True)
class Header:
    """Base of the header dataclasses: the one place that checks them and turns them into maps and back."""

    packet_type: ClassVar[PacketType]

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            kind: Kind = item.metadata["kind"]
            try:
                # The dataclass is frozen; this is the one place where a field takes its stored type.
                object.__setattr__(self, item.name, kind.read(value))
            except (ValueError, OverflowError):
                raise ValueError(
                    f"{self.packet_type.name} header: {item.metadata['key']!r} ({item.name}) = {value!r:.100}"
                    f" is not {kind.description}"
                ) from None

    def to_map(self) -> dict[str, Any]:
        """Return the map that goes into the stream; default values are left out."""
        values = {}
        for item in fields(self):
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
            If a required key is missing or a value is not of its kind.
        """
        arguments = {}
        for item in fields(cls):
            name = item.metadata["key"]
            if name in values:
                arguments[item.name] = values[name]
            elif item.default is MISSING:
                raise CorruptStream(f"{cls.packet_type.name} header: {name!r} ({item.name}) is missing")
        try:
            return cls(**arguments)
        except ValueError as error:
            raise CorruptStream(str(error)) from None

    def packet(self, payload: bytes = b"", *, critical: bool = True, random_access: bool = False) -> Packet:
        """Wrap the header and a payload into a packet."""
        return Packet(
            type=self.packet_type,
            header=self.to_map(),
            payload=payload,
            critical=critical,
            random_access=random_access,
        )


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
        Frame k stands at ``start_ns + k * period_num / period_den`` nanoseconds, rounded to the nearest
        (halves up), unless a CLOCK packet corrects it.
    translation_step_m, rotation_step_rad
        Quantisation of poses.
    grey
        Whether the pictures have one channel.
    sensors
        Number of sensors; a SENSOR packet for each after the first follows.
    given_world
        Whether the world frame is the input's own; otherwise it is the camera at frame 0.
    name
        Name of the input sequence.
    """

    packet_type: ClassVar[PacketType] = PacketType.STREAM

    min_reader: int = key("v", integer(1, 255), default=1)
    required: tuple[str, ...] = key("req", names(16, 64), default=())
    color_camera: tuple[float, ...] = key("cc", camera())
    depth_camera: tuple[float, ...] = key("dc", camera(optional=True), default=())
    T_color_depth: tuple[float, ...] = key("tcd", extrinsic(), default=())
    depth_scale: float = key("ds", number(1e-6, 1e9))
    start_ns: int = key("t0", integer(-(1 << 63), (1 << 63) - 1), default=0)
    period_num: int = key("pn", integer(1, 10**15))
    period_den: int = key("pd", integer(1, 10**9), default=1)
    translation_step_m: float = key("qt", number(1e-7, 1.0))
    rotation_step_rad: float = key("qr", number(1e-7, 1.0))
    grey: bool = key("g", flag(), default=False)
    given_world: bool = key("w", flag(), default=False)
    name: str = key("n", text(255), default="")
    sensors: int = key("s", integer(1, MAX_SENSORS), default=1)


@dataclass(frozen=True, kw_only=True)
class SensorHeader(Header):
    """A further sensor of a stream; the first one is described by STREAM, whose fields of the same names mean the same.

    Attributes
    ----------
    T_depth_base
        First three rows of the transform from the depth camera of the first sensor to that of this one, row by row
        (12 numbers); empty: identity.
    start_ns, period_num, period_den
        Clock of this sensor alone: k counts its own frames.
    """

    packet_type: ClassVar[PacketType] = PacketType.SENSOR

    color_camera: tuple[float, ...] = key("cc", camera())
    depth_camera: tuple[float, ...] = key("dc", camera(optional=True), default=())
    T_color_depth: tuple[float, ...] = key("tcd", extrinsic(), default=())
    T_depth_base: tuple[float, ...] = key("tdb", extrinsic(), default=())
    depth_scale: float = key("ds", number(1e-6, 1e9))
    start_ns: int = key("t0", integer(-(1 << 63), (1 << 63) - 1), default=0)
    period_num: int = key("pn", integer(1, 10**15))
    period_den: int = key("pd", integer(1, 10**9), default=1)
    grey: bool = key("g", flag(), default=False)
    name: str = key("n", text(255), default="")


@dataclass(frozen=True, kw_only=True)
class OrderHeader(Header):
    """The sensors that take turns from `frame` on, until the next ORDER."""

    packet_type: ClassVar[PacketType] = PacketType.ORDER

    frame: int = key("f", integer(0, MAX_FRAME))


@dataclass(frozen=True, kw_only=True)
class ObjectHeader(Header):
    """One rigid object: its number and its tessellation.

    Attributes
    ----------
    object_id
        Number; 0 is the background, whose frame is the world.
    voxel_size_m
        Edge length of a cell.
    texture_bits
        Texels along an edge of a cell, as a power of two; 0: the object has no texture.
    guessed
        Whether the object's shape is a guess where nothing was measured: it is drawn in colour pictures only, and
        behind all others.
    relief_bits
        In how many places of a cell the surface may pass, as a power of two; 0: through its centre.
    passing
        Whether it stands for things that are there for a moment, such as hands: one after the other, each with cells of
        its own.
    """

    packet_type: ClassVar[PacketType] = PacketType.OBJECT

    object_id: int = key("o", integer(0, MAX_OBJECT_ID))
    voxel_size_m: float = key("h", number(1e-6, 1e3))
    texture_bits: int = key("t", integer(0, MAX_TEXTURE_BITS), default=0)
    guessed: bool = key("g", flag(), default=False)
    relief_bits: int = key("r", integer(0, MAX_RELIEF_BITS), default=0)
    passing: bool = key("p", flag(), default=False)


@dataclass(frozen=True, kw_only=True)
class RunHeader(Header):
    """Base of the headers that speak of `count` consecutive frames from `frame` on."""

    frame: int = key("f", integer(0, MAX_FRAME))
    count: int = key("n", integer(1, MAX_COUNT), default=1)


@dataclass(frozen=True, kw_only=True)
class SensorRunHeader(RunHeader):
    """Base of the headers that speak of `count` consecutive frames of one sensor from `frame` on."""

    sensor: int = key("s", integer(0, MAX_SENSORS - 1), default=0)


@dataclass(frozen=True, kw_only=True)
class PartHeader(Header):
    """Base of the headers of what is told of one object before `frame` is drawn."""

    object_id: int = key("o", integer(0, MAX_OBJECT_ID), default=0)
    frame: int = key("f", integer(0, MAX_FRAME))


@dataclass(frozen=True, kw_only=True)
class ModelHeader(PartHeader):
    """A model update, applied before `frame` is drawn."""

    packet_type: ClassVar[PacketType] = PacketType.MODEL


@dataclass(frozen=True, kw_only=True)
class ReliefHeader(PartHeader):
    """Relief of all cells of an object that have none yet, after its update of the same frame."""

    packet_type: ClassVar[PacketType] = PacketType.RELIEF


@dataclass(frozen=True, kw_only=True)
class TextureHeader(PartHeader):
    """Colours of the texels of all cells of an object that have none yet, after its update of the same frame."""

    packet_type: ClassVar[PacketType] = PacketType.TEXTURE


@dataclass(frozen=True, kw_only=True)
class GainHeader(SensorRunHeader):
    """Gains of a colour camera in `count` of its frames from `frame` on; the last one stays otherwise."""

    packet_type: ClassVar[PacketType] = PacketType.GAIN


@dataclass(frozen=True, kw_only=True)
class ShiftHeader(SensorRunHeader):
    """Where the depth camera of `count` frames of a sensor from `frame` on stood when the colour picture was taken.

    Colour and depth are seldom taken at the same instant, nor a whole picture at one; the last shift stays otherwise.
    """

    packet_type: ClassVar[PacketType] = PacketType.SHIFT


@dataclass(frozen=True, kw_only=True)
class BackdropHeader(Header):
    """A picture that colours the background, as the colour camera of `frame` sees it, from that frame on."""

    packet_type: ClassVar[PacketType] = PacketType.BACKDROP

    frame: int = key("f", integer(0, MAX_FRAME))


@dataclass(frozen=True, kw_only=True)
class DepthHeader(Header):
    """A picture that gives the background its cells, as the depth camera of `frame` sees it."""

    packet_type: ClassVar[PacketType] = PacketType.DEPTH

    frame: int = key("f", integer(0, MAX_FRAME))


@dataclass(frozen=True, kw_only=True)
class FilterHeader(Header):
    """The filter of colour pictures from `frame` on."""

    packet_type: ClassVar[PacketType] = PacketType.FILTER

    frame: int = key("f", integer(0, MAX_FRAME))


@dataclass(frozen=True, kw_only=True)
class VideoHeader(SensorRunHeader):
    """Depth as filmed in `count` frames of a sensor from `frame` on, which stands for the drawn one in these alone.

    Attributes
    ----------
    columns, rows
        Size of its pictures, which cover those of the depth camera.
    nearest_m, ratio
        Depth that the value 0 means, and of each value to the one before.
    complete
        Whether something is everywhere, also where nothing is drawn.
    """

    packet_type: ClassVar[PacketType] = PacketType.VIDEO

    columns: int = key("w", integer(1, MAX_VIDEO_SIDE))
    rows: int = key("h", integer(1, MAX_VIDEO_SIDE))
    nearest_m: float = key("z", number(1e-6, 1e6))
    ratio: float = key("r", number(1, 1.2))
    complete: bool = key("c", flag(), default=False)


@dataclass(frozen=True, kw_only=True)
class LightHeader(PartHeader):
    """The light on an object from `frame` on; it stands still in the world while the object turns."""

    packet_type: ClassVar[PacketType] = PacketType.LIGHT


@dataclass(frozen=True, kw_only=True)
class PoseHeader(RunHeader):
    """Poses at `count` consecutive moments from `frame` on; an object keeps its last pose otherwise.

    A moment is one frame, or those that several sensors took together. Object 0 carries T_camera_world, every other
    object T_world_object.
    """

    packet_type: ClassVar[PacketType] = PacketType.POSE

    object_id: int = key("o", integer(0, MAX_OBJECT_ID), default=0)


@dataclass(frozen=True, kw_only=True)
class ClockHeader(SensorRunHeader):
    """Corrections in nanoseconds of a sensor's regular clock, for `count` frames of its own from `frame` on."""

    packet_type: ClassVar[PacketType] = PacketType.CLOCK


@dataclass(frozen=True, kw_only=True)
class SnapshotHeader(Header):
    """The whole decoded state before `frame` is drawn, and its digest: decoding can start here."""

    packet_type: ClassVar[PacketType] = PacketType.SNAPSHOT

    frame: int = key("f", integer(0, MAX_FRAME))
    digest: bytes = key("d", blob(DIGEST_BYTES))


@dataclass(frozen=True, kw_only=True)
class BatchHeader(Header):
    """Packets of `count` frames from `frame` on, complete: these frames can be drawn."""

    packet_type: ClassVar[PacketType] = PacketType.BATCH

    frame: int = key("f", integer(0, MAX_FRAME))
    count: int = key("n", integer(1, MAX_COUNT))

    @property
    def stop(self) -> int:
        """The frame after the last one."""
        return self.frame + self.count


@dataclass(frozen=True, kw_only=True)
class EndHeader(Header):
    """End of the stream: its number of frames and the digest of the decoded models."""

    packet_type: ClassVar[PacketType] = PacketType.END

    frames: int = key("n", integer(0, MAX_FRAME))
    digest: bytes = key("d", blob(DIGEST_BYTES))


def check_supported(header: StreamHeader) -> None:
    """Refuse a stream whose packets mean something that this reader does not know.

    Raises
    ------
    UnsupportedVersion
        If the stream asks for a newer reader or for a feature that this one lacks.
    """
    if header.min_reader > READER_VERSION:
        raise UnsupportedVersion(
            f"the stream needs reader version {header.min_reader}, this one is {READER_VERSION}; use a newer 3dvc"
        )
    missing = [feature for feature in header.required if feature not in FEATURES]
    if missing:
        raise UnsupportedVersion(f"the stream needs the features {', '.join(missing)}; use a newer 3dvc")


def pack_batch(header: BatchHeader, packets: Sequence[Packet]) -> Packet:
    """Join packets into one BATCH, whose framing takes 4 to 8 bytes for each instead of 28.

    Raises
    ------
    ValueError
        If a packet is of a type that stands at top level only.
    LimitExceeded
        If there are too many packets or bytes for one BATCH.
    """
    if len(packets) > MAX_BATCH_PACKETS:
        raise LimitExceeded(f"{len(packets)} packets are more than the {MAX_BATCH_PACKETS} that fit into one BATCH")
    payload = b"".join(_pack_member(packet) for packet in packets)
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise LimitExceeded(
            f"a BATCH of {len(payload)} bytes is larger than {MAX_PAYLOAD_BYTES}; put fewer frames into one"
        )
    return header.packet(payload)


def split_batch(packet: Packet) -> Iterator[tuple[Packet, int]]:
    """Yield every packet in a BATCH, of unknown types too, with the number of bytes it takes there.

    Raises
    ------
    CorruptStream
        If the payload is not a sequence of packets.
    LimitExceeded
        If there are more than `MAX_BATCH_PACKETS`, or a header is too long.
    """
    reader = ByteReader(packet.payload)
    for _ in range(MAX_BATCH_PACKETS):
        if not reader.remaining:
            return
        start = reader.position
        member = _unpack_member(reader)
        yield member, reader.position - start
    if reader.remaining:
        raise LimitExceeded(f"a BATCH holds more than {MAX_BATCH_PACKETS} packets")


def unpack_batch(packet: Packet) -> list[Packet]:
    """Return the packets in a BATCH; those unknown to this reader are passed over.

    Raises
    ------
    CorruptStream
        If the payload is not a sequence of packets.
    LimitExceeded
        If there are more than `MAX_BATCH_PACKETS`, or a header is too long.
    UnsupportedVersion
        If a packet is critical and of an unknown type.
    """
    return [member for member, _ in split_batch(packet) if is_understood(member.type, member.critical)]


def _pack_member(packet: Packet) -> bytes:
    if packet.type in TOP_LEVEL_TYPES:
        raise ValueError(f"{type_name(packet.type)} cannot stand in a BATCH")
    header = pack_map(packet.header)
    parts = [bytes([packet.type, packet.flags]), pack_varint(len(header)), header]
    return b"".join([*parts, pack_varint(len(packet.payload)), packet.payload])


def _unpack_member(reader: ByteReader) -> Packet:
    number, flags = reader.take(2)
    if number in TOP_LEVEL_TYPES:
        raise CorruptStream(f"{type_name(number)} stands in a BATCH")
    if flags > PacketFlag.CRITICAL | PacketFlag.RANDOM_ACCESS:
        raise CorruptStream(f"{type_name(number)} in a BATCH has impossible flags 0x{flags:02x}")
    size = reader.varint()
    if size > MAX_HEADER_BYTES:
        raise LimitExceeded(f"a header of {size} bytes is longer than the {MAX_HEADER_BYTES} that a reader accepts")
    header = unpack_map(reader.take(size))
    return Packet(
        type=number,
        header=header,
        payload=reader.take(reader.varint()),
        critical=bool(flags & PacketFlag.CRITICAL),
        random_access=bool(flags & PacketFlag.RANDOM_ACCESS),
    )
