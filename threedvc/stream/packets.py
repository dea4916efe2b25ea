# SPDX-License-Identifier: MIT
"""Packets: what the encoder emits and the decoder consumes.

A packet is a type, a header (a small map of short keys) and a payload. The container writes packets
to bytes and checks them on the way back; the core neither opens files nor knows about checksums.
Every header is declared once, as a frozen dataclass whose fields name their key in the stream.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import Any

from threedvc.errors import UnsupportedVersion

__all__ = [
    "RESERVED_TYPES",
    "TOP_LEVEL_TYPES",
    "Packet",
    "PacketFlag",
    "PacketType",
    "VideoCodec",
    "is_understood",
    "type_name",
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
    COLOR_VIDEO = 24
    DEPTH_VIDEO = 25
    BACKGROUND = 26


class VideoCodec(IntEnum):
    """What the pictures of a COLOR_VIDEO are coded by; those of a DEPTH_VIDEO or a BACKGROUND are AV1."""

    AV1 = 1
    FFV1 = 2
    JPEG = 3
    AV1_FULL_CHROMA = 4


RESERVED_TYPES = frozenset({PacketType.SNAPSHOT})
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
