# SPDX-License-Identifier: MIT
"""One packet to bytes and back."""

from __future__ import annotations

from typing import Final

import zstandard

from threedvc.errors import CorruptStream, LimitExceeded, UnsupportedVersion
from threedvc.formats.container.checksum import crc32c
from threedvc.formats.container.layout import CODEC_SHIFT, CRC, Codec, PacketHead, pack_packet_head
from threedvc.limits import MAX_EXPANSION, MAX_PAYLOAD_BYTES
from threedvc.stream.packets import Packet, PacketFlag, PacketType, type_name
from threedvc.stream.wire import pack_map, unpack_map

__all__ = ["pack_packet", "unpack_body"]

COMPRESSED_TYPES: Final = frozenset({PacketType.META, PacketType.ATTACHMENT, PacketType.INDEX})
ZSTD_LEVEL: Final = 9
"""Of Zstandard; by taste, between its speed and its size."""


def pack_packet(packet: Packet, seq: int) -> bytes:
    """Return a packet as bytes.

    Texts and tables (META, ATTACHMENT, INDEX) are compressed where that makes them smaller; all
    other payloads are entropy coded already.

    Raises
    ------
    ValueError
        If a header value cannot be stored.
    LimitExceeded
        If header or payload is larger than a reader accepts.
    """
    if len(packet.payload) > MAX_PAYLOAD_BYTES:
        raise LimitExceeded(
            f"{type_name(packet.type)} payload of {len(packet.payload)} bytes is larger than {MAX_PAYLOAD_BYTES}"
        )
    codec, stored = _compress(packet) if packet.type in COMPRESSED_TYPES else (Codec.NONE, packet.payload)
    header = pack_map(packet.header)
    head = PacketHead(
        type=packet.type,
        flags=packet.flags | codec << CODEC_SHIFT,
        header_size=len(header),
        payload_size=len(stored),
        raw_size=len(packet.payload),
        seq=seq,
    )
    body = header + stored
    return pack_packet_head(head) + body + CRC.pack(crc32c(body))


def unpack_body(head: PacketHead, body: bytes) -> Packet:
    """Check and read what follows the head of a packet.

    Parameters
    ----------
    head
        The checked head.
    body
        ``head.body_size`` bytes.

    Raises
    ------
    CorruptStream
        If the checksum, the header or the compressed payload is wrong.
    UnsupportedVersion
        If the payload is compressed by an unknown codec.
    """
    data = body[: -CRC.size]
    if CRC.unpack(body[-CRC.size :])[0] != crc32c(data):
        raise CorruptStream("the checksum of its content is wrong")
    return Packet(
        type=head.type,
        header=unpack_map(data[: head.header_size]),
        payload=_decompress(head, data[head.header_size :]),
        critical=bool(head.flags & PacketFlag.CRITICAL),
        random_access=bool(head.flags & PacketFlag.RANDOM_ACCESS),
    )


def _compress(packet: Packet) -> tuple[Codec, bytes]:
    stored = zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(packet.payload)
    if len(packet.payload) / MAX_EXPANSION <= len(stored) < len(packet.payload):
        return Codec.ZSTD, stored
    return Codec.NONE, packet.payload


def _decompress(head: PacketHead, stored: bytes) -> bytes:
    if head.codec == Codec.NONE:
        return stored
    if head.codec != Codec.ZSTD:
        raise UnsupportedVersion(f"its payload is compressed by unknown codec {head.codec}; use a newer 3dvc")
    try:
        # The size in the Zstandard frame rules its allocation, so it must be the one already checked.
        if zstandard.frame_content_size(stored) == head.raw_size:
            return zstandard.ZstdDecompressor().decompress(stored, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise CorruptStream(f"its payload cannot be decompressed: {error}") from None
    raise CorruptStream(f"its compressed payload does not hold the {head.raw_size} bytes that it claims")
