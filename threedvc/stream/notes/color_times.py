# SPDX-License-Identifier: MIT
"""Times of color pictures that were not taken with the depth picture of their frame, in a META packet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import ClassVar

from threedvc.errors import CorruptStream
from threedvc.limits import MAX_COUNT, MAX_FRAME
from threedvc.stream.compressed_payload import compress, decompress
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.wire import MAX_VARINT_BYTES, ByteReader, pack_signed_varint, pack_varint

__all__ = ["NOTE", "ColorTimes", "color_times_packet", "unpack_color_times"]

FIRST_FRAME = "f"
MAX_BYTES = MAX_VARINT_BYTES * MAX_COUNT
"""Bytes of a packet's varints."""
MAX_OFFSET_NS = 1 << 62
"""Half the range of signed 64-bit times."""


def color_times_packet(first: int, offsets_ns: Sequence[int]) -> Packet:
    """Pack how much later than its depth picture the color picture of consecutive frames was taken.

    Parameters
    ----------
    first
        Number of the first of these frames.
    offsets_ns
        Nanoseconds, one for each frame, at most `MAX_COUNT`.
    """
    steps = [later - earlier for earlier, later in pairwise([0, *offsets_ns])]
    parts = [pack_varint(len(offsets_ns)), *(pack_signed_varint(step) for step in steps)]
    header = {"k": ColorTimes.kind, FIRST_FRAME: first}
    return Packet(type=PacketType.META, header=header, payload=compress(b"".join(parts)), critical=False)


def unpack_color_times(packet: Packet) -> Mapping[int, int]:
    """Read a packet made by `color_times_packet`: the offsets by number of frame.

    Raises
    ------
    CorruptStream
        If it is malformed.
    """
    first = packet.header.get(FIRST_FRAME)
    if not isinstance(first, int) or not 0 <= first <= MAX_FRAME:
        raise CorruptStream(f"the color pictures' times begin at frame {first!r}")
    reader = ByteReader(decompress(packet.payload, MAX_BYTES, "a packet of times of color pictures"))
    count = reader.varint()
    if count > MAX_COUNT:
        raise CorruptStream(f"times of {count} color pictures are more than {MAX_COUNT}")
    offsets = list(accumulate(reader.signed_varint() for _ in range(count)))
    if reader.remaining or any(abs(offset) > MAX_OFFSET_NS for offset in offsets):
        raise CorruptStream(f"the times of {count} color pictures are malformed")
    return {first + index: offset for index, offset in enumerate(offsets)}


class ColorTimes:
    """The times of color pictures in a stream, for frames that are still to come."""

    kind: ClassVar[str] = "color times"

    def __init__(self) -> None:
        self._offsets_ns: dict[int, int] = {}

    def add(self, packet: Packet) -> None:
        """Note the times of a packet."""
        self._offsets_ns.update(unpack_color_times(packet))

    def take_offset_ns(self, frame: int) -> int:
        """Return how much later than its depth picture the color picture of a frame was taken, and forget it."""
        return self._offsets_ns.pop(frame, 0)


NOTE = ColorTimes
