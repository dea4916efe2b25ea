# SPDX-License-Identifier: MIT
"""The fixed parts of a stream: the head of the file, the head of a packet, the trailers.

Each is declared once; reader, writer and the check of docs/format.md use the same declaration. All
numbers are little-endian.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final, NamedTuple

from threedvc.errors import BadMagic, CorruptStream, LimitExceeded, TruncatedStream, UnsupportedVersion
from threedvc.formats.container.checksum import crc32c
from threedvc.limits import MAX_EXPANSION, MAX_HEADER_BYTES, MAX_PAYLOAD_BYTES

__all__ = [
    "CODEC_SHIFT",
    "CRC",
    "FILE_HEAD_BYTES",
    "INDEX_POINTER",
    "MAGIC",
    "MAJOR",
    "MINOR",
    "PACKET_HEAD",
    "PACKET_HEAD_FIELDS",
    "SEQ_MODULUS",
    "SYNC",
    "Codec",
    "PacketHead",
    "check_file_head",
    "pack_file_head",
    "pack_packet_head",
    "unpack_packet_head",
]

MAGIC: Final = b"\x893DVC\r\n\x1a\n"
MAJOR: Final = 1
"""Of the format: a reader refuses another one."""
MINOR: Final = 0
"""Of the format: a reader takes any."""
FILE_HEAD: Final = struct.Struct("<9sBBB")
FILE_HEAD_BYTES: Final = FILE_HEAD.size

SYNC: Final = b"\xa7\x3d\xc5\x5e"
PACKET_HEAD_FIELDS: Final = (
    ("sync", "4s"),
    ("type", "B"),
    ("flags", "B"),
    ("header_size", "H"),
    ("payload_size", "I"),
    ("raw_size", "I"),
    ("seq", "I"),
    ("crc", "I"),
)
PACKET_HEAD: Final = struct.Struct("<" + "".join(code for _, code in PACKET_HEAD_FIELDS))
CRC: Final = struct.Struct("<I")
INDEX_POINTER: Final = struct.Struct("<Q")

KNOWN_FLAGS: Final = 0x0F
"""The four lower bits; those above must be 0, so that a later version can use them."""
CODEC_SHIFT: Final = 2
"""Where the codec stands in the flags: bits 2 and 3."""
SEQ_MODULUS: Final = 1 << 32
"""Numbers of packets are 32 bits of their head, and begin anew."""


class Codec(IntEnum):
    """How a payload is compressed; bits 2 and 3 of a packet's flags."""

    NONE = 0
    ZSTD = 1


class PacketHead(NamedTuple):
    """The head of a packet without its sync word and checksum.

    Attributes
    ----------
    type, flags
        As stored.
    header_size, payload_size
        Bytes that follow in the stream.
    raw_size
        Bytes of the payload after decompression.
    seq
        Number of the packet, from 0, modulo 2^32.
    """

    type: int
    flags: int
    header_size: int
    payload_size: int
    raw_size: int
    seq: int

    @property
    def codec(self) -> int:
        """Number of the payload's codec."""
        return self.flags >> CODEC_SHIFT

    @property
    def body_size(self) -> int:
        """Bytes of the packet after its head: header, payload and checksum."""
        return self.header_size + self.payload_size + CRC.size


def pack_file_head() -> bytes:
    """Return the first bytes of a stream: magic, version, one zero byte."""
    return FILE_HEAD.pack(MAGIC, MAJOR, MINOR, 0)


def check_file_head(data: bytes) -> None:
    """Check the first `FILE_HEAD_BYTES` of a stream, or fewer if it has no more.

    Raises
    ------
    BadMagic
        If this is not a .3dvc stream.
    TruncatedStream
        If it may be one and ends too early.
    UnsupportedVersion
        If it is of another major version.
    CorruptStream
        If the byte after the version is not zero.
    """
    if not data or not data.startswith(MAGIC[: len(data)]):
        raise BadMagic(f"not a .3dvc stream: begins with {data[: len(MAGIC)].hex(' ') or 'nothing (empty)'}")
    if len(data) < FILE_HEAD_BYTES:
        raise TruncatedStream(f"ends after {len(data)} bytes, within the head of the file; nothing can be read")
    _, major, minor, zero = FILE_HEAD.unpack(data)
    if major != MAJOR:
        raise UnsupportedVersion(f"is of format {major}.{minor}, this reader knows {MAJOR}.x; use another 3dvc")
    if zero:
        raise CorruptStream(f"byte {FILE_HEAD_BYTES - 1} is 0x{zero:02x} instead of 0; the file is damaged")


def pack_packet_head(head: PacketHead) -> bytes:
    """Return the head of a packet as bytes, with sync word and checksum."""
    data = PACKET_HEAD.pack(SYNC, *head, 0)[: -CRC.size]
    return data + CRC.pack(crc32c(data))


def unpack_packet_head(data: bytes) -> PacketHead:
    """Read and check the head of a packet; inverse of `pack_packet_head`.

    Parameters
    ----------
    data
        `PACKET_HEAD.size` bytes.

    Raises
    ------
    CorruptStream
        If sync word, checksum or flags are wrong.
    LimitExceeded
        If a length is beyond what a reader accepts.
    """
    sync, *numbers, crc = PACKET_HEAD.unpack(data)
    if sync != SYNC:
        raise CorruptStream(f"no packet begins here: found {sync.hex(' ')} instead of {SYNC.hex(' ')}")
    if crc != crc32c(data[: -CRC.size]):
        raise CorruptStream("the checksum of its head is wrong")
    head = PacketHead(*numbers)
    _check_sizes(head)
    return head


def _check_sizes(head: PacketHead) -> None:
    if head.flags & ~KNOWN_FLAGS:
        raise CorruptStream(f"flags 0x{head.flags:02x} have bits set that must be 0")
    if head.header_size > MAX_HEADER_BYTES:
        raise LimitExceeded(f"a header of {head.header_size} bytes is longer than {MAX_HEADER_BYTES}")
    if max(head.payload_size, head.raw_size) > MAX_PAYLOAD_BYTES:
        size = max(head.payload_size, head.raw_size)
        raise LimitExceeded(f"a payload of {size} bytes is larger than {MAX_PAYLOAD_BYTES}")
    if head.codec == Codec.NONE and head.raw_size != head.payload_size:
        raise CorruptStream(f"an uncompressed payload of {head.payload_size} bytes claims {head.raw_size}")
    if head.raw_size > MAX_EXPANSION * head.payload_size:
        raise LimitExceeded(
            f"a payload of {head.payload_size} bytes claims {head.raw_size} after decompression,"
            f" more than {MAX_EXPANSION} times"
        )
