# SPDX-License-Identifier: MIT
"""Headers of the packets: their keys, types and limits, as docs/format.md has them."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from typing import Any, ClassVar, Self

from threedvc.errors import CorruptStream, UnsupportedVersion
from threedvc.limits import (
    MAX_COUNT,
    MAX_FRAME,
    MAX_MAGNIFICATION,
    MAX_OBJECT_ID,
    MAX_RELIEF_BITS,
    MAX_SENSORS,
    MAX_TEXTURE_BITS,
)
from threedvc.stream.header_fields import FieldType, blob, camera, extrinsic, flag, integer, key, names, number, text
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.wire import DIGEST_BYTES

__all__ = [
    "FEATURES",
    "READER_VERSION",
    "BackdropHeader",
    "BackgroundHeader",
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
    "PoseHeader",
    "ReliefHeader",
    "RunHeader",
    "SensorHeader",
    "SensorRunHeader",
    "ShiftHeader",
    "SnapshotHeader",
    "StreamHeader",
    "TextureHeader",
    "check_supported",
]

READER_VERSION = 1
"""Version of the meaning of packets; a stream names the lowest that its reader must have."""
FEATURES: frozenset[str] = frozenset()
"""Optional features that this reader has; a stream may require some by name."""


@dataclass(frozen=True, kw_only=True)
class Header:
    """Base of the header dataclasses: the one place that checks them and turns them into maps and back."""

    packet_type: ClassVar[PacketType]

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            field_type: FieldType = item.metadata["type"]
            try:
                # The dataclass is frozen; this is the one place where a field takes its stored type.
                object.__setattr__(self, item.name, field_type.read(value))
            except (ValueError, OverflowError):
                raise ValueError(
                    f"{self.packet_type.name} header: {item.metadata['key']!r} ({item.name}) = {value!r:.100}"
                    f" is not {field_type.description}"
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
            If a required key is missing or a value is not of its type.
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
        ``width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3``; no depth camera: the color camera's.
    T_color_depth
        First three rows of the extrinsic, row by row (12 numbers); empty: identity.
    depth_scale
        Units per meter of 16-bit depth pictures, 0 = no measurement.
    start_ns, period_num, period_den
        Frame k stands at ``start_ns + k * period_num / period_den`` nanoseconds, rounded to the nearest
        (halves up), unless a CLOCK packet corrects it.
    translation_step_m, rotation_step_rad
        Quantization of poses.
    gray
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
    gray: bool = key("g", flag(), default=False)
    given_world: bool = key("w", flag(), default=False)
    name: str = key("n", text(255), default="")
    sensors: int = key("s", integer(1, MAX_SENSORS), default=1)


@dataclass(frozen=True, kw_only=True)
class SensorHeader(Header):
    """A further sensor of a stream; the first one is described by STREAM, whose fields of the same names mean the same.

    Attributes
    ----------
    T_depth_rig
        First three rows of the transform from the depth camera of the first sensor to that of this one, row by row
        (12 numbers); empty: identity.
    start_ns, period_num, period_den
        Clock of this sensor alone: k counts its own frames.
    """

    packet_type: ClassVar[PacketType] = PacketType.SENSOR

    color_camera: tuple[float, ...] = key("cc", camera())
    depth_camera: tuple[float, ...] = key("dc", camera(optional=True), default=())
    T_color_depth: tuple[float, ...] = key("tcd", extrinsic(), default=())
    T_depth_rig: tuple[float, ...] = key("tdb", extrinsic(), default=())
    depth_scale: float = key("ds", number(1e-6, 1e9))
    start_ns: int = key("t0", integer(-(1 << 63), (1 << 63) - 1), default=0)
    period_num: int = key("pn", integer(1, 10**15))
    period_den: int = key("pd", integer(1, 10**9), default=1)
    gray: bool = key("g", flag(), default=False)
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
        Whether the object's shape is a guess where nothing was measured: it is drawn in color pictures only, and
        behind all others.
    relief_bits
        In how many places of a cell the surface may pass, as a power of two; 0: through its center.
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
    """Colors of the texels of all cells of an object that have none yet, after its update of the same frame."""

    packet_type: ClassVar[PacketType] = PacketType.TEXTURE


@dataclass(frozen=True, kw_only=True)
class GainHeader(SensorRunHeader):
    """Gains of a color camera in `count` of its frames from `frame` on; the last one stays otherwise."""

    packet_type: ClassVar[PacketType] = PacketType.GAIN


@dataclass(frozen=True, kw_only=True)
class ShiftHeader(SensorRunHeader):
    """Where the depth camera of `count` frames of a sensor from `frame` on stood when the color picture was taken.

    Color and depth are seldom taken at the same instant, nor a whole picture at one; the last shift stays otherwise.
    """

    packet_type: ClassVar[PacketType] = PacketType.SHIFT


@dataclass(frozen=True, kw_only=True)
class BackdropHeader(Header):
    """A picture as a `BackgroundHeader` tells of, as earlier writers coded it."""

    packet_type: ClassVar[PacketType] = PacketType.BACKDROP

    frame: int = key("f", integer(0, MAX_FRAME))


@dataclass(frozen=True, kw_only=True)
class BackgroundHeader(Header):
    """A picture that colors the background, as the color camera of `frame` sees it, from that frame on.

    Attributes
    ----------
    codec
        What it is coded by, see `VideoCodec`.
    bits
        Of a sample.
    magnified
        Chroma is 1 + magnified/4 times as large as it is by its formula.
    """

    packet_type: ClassVar[PacketType] = PacketType.BACKGROUND

    frame: int = key("f", integer(0, MAX_FRAME))
    codec: int = key("c", integer(1, 255), default=1)
    bits: int = key("b", integer(8, 16), default=10)
    magnified: int = key("m", integer(0, MAX_MAGNIFICATION), default=0)


@dataclass(frozen=True, kw_only=True)
class DepthHeader(Header):
    """A picture that gives the background its cells, as the depth camera of `frame` sees it."""

    packet_type: ClassVar[PacketType] = PacketType.DEPTH

    frame: int = key("f", integer(0, MAX_FRAME))


@dataclass(frozen=True, kw_only=True)
class FilterHeader(Header):
    """The filter of color pictures from `frame` on."""

    packet_type: ClassVar[PacketType] = PacketType.FILTER

    frame: int = key("f", integer(0, MAX_FRAME))


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
