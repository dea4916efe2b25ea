# SPDX-License-Identifier: MIT
"""Times of colour pictures that were not taken with the depth picture of their frame, in a META packet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise

import zstandard

from threedvc.errors import CorruptStream
from threedvc.limits import MAX_COUNT, MAX_FRAME
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.wire import MAX_VARINT_BYTES, META_ZSTD_LEVEL, ByteReader, pack_signed_varint, pack_varint

__all__ = ["color_times_packet", "unpack_color_times"]

KIND = "color times"
FIRST_FRAME = "f"
MAX_BYTES = MAX_VARINT_BYTES * MAX_COUNT
"""Bytes of a packet's varints."""
MAX_OFFSET_NS = 1 << 62
"""Half the range of signed 64-bit times."""


def color_times_packet(first: int, offsets_ns: Sequence[int]) -> Packet:
    """Pack how much later than its depth picture the colour picture of consecutive frames was taken.

    Parameters
    ----------
    first
        Number of the first of these frames.
    offsets_ns
        Nanoseconds, one for each frame, at most `MAX_COUNT`.
    """
    steps = [later - earlier for earlier, later in pairwise([0, *offsets_ns])]
    parts = [pack_varint(len(offsets_ns)), *(pack_signed_varint(step) for step in steps)]
    payload = zstandard.ZstdCompressor(level=META_ZSTD_LEVEL).compress(b"".join(parts))
    return Packet(type=PacketType.META, header={"k": KIND, FIRST_FRAME: first}, payload=payload, critical=False)


def unpack_color_times(packet: Packet) -> Mapping[int, int] | None:
    """Read a packet made by `color_times_packet`: the offsets by number of frame; None if it is another kind of META.

    Raises
    ------
    CorruptStream
        If it is malformed.
    """
    if packet.header.get("k") != KIND:
        return None
    first = packet.header.get(FIRST_FRAME)
    if not isinstance(first, int) or not 0 <= first <= MAX_FRAME:
        raise CorruptStream(f"the colour pictures' times begin at frame {first!r}")
    reader = ByteReader(_decompressed(packet.payload))
    count = reader.varint()
    if count > MAX_COUNT:
        raise CorruptStream(f"times of {count} colour pictures are more than {MAX_COUNT}")
    offsets = list(accumulate(reader.signed_varint() for _ in range(count)))
    if reader.remaining or any(abs(offset) > MAX_OFFSET_NS for offset in offsets):
        raise CorruptStream(f"the times of {count} colour pictures are malformed")
    return {first + index: offset for index, offset in enumerate(offsets)}


def _decompressed(payload: bytes) -> bytes:
    try:
        # The size that the Zstandard frame states rules its allocation, whatever limit is passed.
        size = zstandard.frame_content_size(payload)
        if not 0 <= size <= MAX_BYTES:
            raise CorruptStream(f"times of colour pictures state {size} bytes, at most {MAX_BYTES} are accepted")
        return zstandard.ZstdDecompressor().decompress(payload, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise CorruptStream(f"times of colour pictures cannot be read: {error}") from None
