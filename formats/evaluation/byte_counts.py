# SPDX-License-Identifier: MIT
"""Where the bytes of a stream go: by type of packet, by object, by frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

from threedvc.formats.container import FILE_HEAD_BYTES, Record
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.header_reader import read_header
from threedvc.stream.headers import BatchHeader, ClockHeader, DepthHeader, Header, ModelHeader, ObjectHeader, PoseHeader
from threedvc.stream.packets import Packet, type_name

__all__ = ["ByteCounts", "PacketTotal"]

READ_TYPES = frozenset(
    header_type.packet_type
    for header_type in (BatchHeader, ClockHeader, ColorVideoHeader, DepthHeader, ModelHeader, ObjectHeader, PoseHeader)
)
"""Types of packets whose header tells of which frames or object their bytes are; all others follow the one before."""


@dataclass(frozen=True, kw_only=True)
class PacketTotal:
    """Number and size of the packets of one type."""

    count: int
    bytes: int


@dataclass(frozen=True)
class _Share:
    """Bytes that serve `count` frames from `frame` on."""

    frame: int
    count: int
    size: int


@dataclass(kw_only=True)
class ByteCounts:
    """Sizes of the packets of a stream, framing included.

    Attributes
    ----------
    packets
        Totals by name of type, in order of appearance; a BATCH counts without the packets in it.
    object_bytes, poses
        Bytes and frames with a pose, by object.
    """

    packets: dict[str, PacketTotal] = field(default_factory=dict)
    object_bytes: Counter[int] = field(default_factory=Counter)
    poses: Counter[int] = field(default_factory=Counter)
    _shares: list[_Share] = field(default_factory=lambda: [_Share(0, 1, FILE_HEAD_BYTES)])

    def counted(self, records: Iterable[Record]) -> Iterator[Packet]:
        """Count packets, and those in a BATCH, on their way from a reader to a decoder."""
        for record in records:
            for part in record.parts():
                self.add(part)
            yield record.packet

    def add(self, part: Record) -> None:
        """Count one packet."""
        packet = part.packet
        name = type_name(packet.type)
        total = self.packets.get(name, PacketTotal(count=0, bytes=0))
        self.packets[name] = PacketTotal(count=total.count + 1, bytes=total.bytes + part.size)
        header = read_header(packet) if packet.type in READ_TYPES else None
        self._shares.append(self._share(header, part.size))
        if isinstance(header, ObjectHeader | ModelHeader | PoseHeader):
            self.object_bytes[header.object_id] += part.size
        if isinstance(header, DepthHeader):
            self.object_bytes[0] += part.size
        if isinstance(header, PoseHeader):
            self.poses[header.object_id] += header.count

    def frame_bytes(self, frames: int, file_bytes: int) -> list[int]:
        """Divide the bytes of the file among its frames; packets of several frames are divided evenly.

        Parameters
        ----------
        frames
            Number of frames; without any the list is empty.
        file_bytes
            Sum to reach: what belongs to no packet, such as the rest of one that is cut, counts for
            the last frame.
        """
        if not frames:
            return []
        sizes = [0] * frames
        for share in self._shares:
            first = min(share.frame, frames - 1)
            count = min(share.count, frames - first)
            for step in range(count):
                sizes[first + step] += share.size * (step + 1) // count - share.size * step // count
        sizes[-1] += file_bytes - sum(sizes)
        return sizes

    def _share(self, header: Header | None, size: int) -> _Share:
        if isinstance(header, BatchHeader | ClockHeader | ColorVideoHeader | PoseHeader):
            return _Share(header.frame, header.count, size)
        if isinstance(header, ModelHeader | DepthHeader):
            return _Share(header.frame, 1, size)
        # A packet that names no frame serves those of the packet before it.
        return replace(self._shares[-1], size=size)
