# SPDX-License-Identifier: MIT
"""A stream of bytes to checked packets, in one pass: the source may be a pipe."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from threedvc.errors import CorruptStream, FormatError, TruncatedStream, UnsupportedVersion
from threedvc.formats.container.framing import unpack_body
from threedvc.formats.container.layout import (
    CRC,
    FILE_HEAD_BYTES,
    PACKET_HEAD,
    SEQ_MODULUS,
    SYNC,
    PacketHead,
    check_file_head,
    unpack_packet_head,
)
from threedvc.formats.container.source import CHUNK_BYTES, ByteSource
from threedvc.stream.batch import split_batch
from threedvc.stream.headers import BatchHeader, StreamHeader, check_supported
from threedvc.stream.packets import Packet, PacketFlag, PacketType, is_understood, type_name

__all__ = ["Record", "SkippedRange", "StreamReader"]


@dataclass(frozen=True)
class Record:
    """A packet and the bytes of the file that it takes, framing included."""

    packet: Packet
    offset: int
    size: int

    def parts(self) -> list[Record]:
        """Divide a BATCH into its packets; the sizes of the parts sum up to its own.

        The first part is the BATCH itself with what remains: its head, header and checksum. Any
        other record is its own only part.
        """
        if self.packet.type != PacketType.BATCH:
            return [self]
        members = list(split_batch(self.packet))
        framing = self.size - sum(size for _, size in members)
        parts = [Record(self.packet, self.offset, framing)]
        place = self.offset + self.size - CRC.size - len(self.packet.payload)
        for member, size in members:
            parts.append(Record(member, place, size))
            place += size
        return parts


@dataclass(frozen=True)
class SkippedRange:
    """Bytes that recovery passed over, and why; no bytes where packets are missing altogether."""

    offset: int
    size: int
    reason: str


class StreamReader:
    """Reads a .3dvc stream; iterating yields the packets that a decoder has to know.

    Packets of unknown types are passed over if the stream allows it; the INDEX is the container's
    own. `records` yields them all.

    Parameters
    ----------
    stream
        A binary source.
    name
        Name for messages.
    recover
        Whether to go on after damage with the next packet that is intact, instead of raising.

    Attributes
    ----------
    frames
        Frames up to the end of the last batch read so far.
    packets
        Packets read so far.
    skipped
        What recovery passed over.

    Raises
    ------
    BadMagic
        If the source is not a .3dvc stream.
    UnsupportedVersion
        If it asks for another reader; iterating raises this too.
    TruncatedStream
        If it ends before END; iterating raises this after the last complete packet.
    CorruptStream, LimitExceeded
        While iterating, if the stream is damaged.
    """

    def __init__(self, stream: BinaryIO, name: str, *, recover: bool = False) -> None:
        self.name = name
        self.frames = 0
        self.packets = 0
        self.skipped: list[SkippedRange] = []
        self._recover = recover
        self._source = ByteSource(stream)
        self._next_seq = 0
        self._begin()

    def __iter__(self) -> Iterator[Packet]:
        for record in self.records():
            packet = record.packet
            if packet.type != PacketType.INDEX and is_understood(packet.type, packet.critical):
                yield packet

    def records(self) -> Iterator[Record]:
        """Yield every packet with its place and size, up to and including END."""
        ended = False
        try:
            while not ended:
                record = self._next_record()
                ended = record.packet.type == PacketType.END
                yield record
            self._check_nothing_follows()
        except OSError as error:
            raise self._unreadable(error) from None

    def _begin(self) -> None:
        data = b""
        try:
            data = self._source.take(FILE_HEAD_BYTES)
            check_file_head(data)
        except OSError as error:
            raise self._unreadable(error) from None
        except FormatError as error:
            if isinstance(error, UnsupportedVersion) or not self._recover:
                raise type(error)(f"{self.name}: {error}") from None
            self._source.give_back(data)
            self._resynchronize(error)

    def _next_record(self) -> Record:
        while True:
            offset = self._source.offset
            try:
                return self._read_record()
            except UnsupportedVersion as error:
                raise UnsupportedVersion(f"{self.name}: packet {self._next_seq} at byte {offset}: {error}") from None
            except FormatError as error:
                if not self._recover:
                    raise self._located(error, offset) from None
                self._resynchronize(error)

    def _read_record(self) -> Record:
        offset = self._source.offset
        taken = self._source.take(PACKET_HEAD.size)
        try:
            if len(taken) < PACKET_HEAD.size:
                raise TruncatedStream("the packet is incomplete")
            head = unpack_packet_head(taken)
            is_understood(head.type, bool(head.flags & PacketFlag.CRITICAL))
            body = self._source.take(head.body_size)
            taken += body
            if len(body) < head.body_size:
                raise TruncatedStream("the packet is incomplete")
            packet = unpack_body(head, body)
            self._accept(head, packet, offset)
        except FormatError:
            self._source.give_back(taken)
            raise
        return Record(packet, offset, len(taken))

    def _accept(self, head: PacketHead, packet: Packet, offset: int) -> None:
        """Check the packet's place in the stream and count it."""
        if not self._recover and (head.type == PacketType.STREAM) != (self.packets == 0):
            raise CorruptStream(f"{type_name(head.type)} is packet {self.packets}, and only the first one is STREAM")
        if head.type == PacketType.STREAM:
            check_supported(StreamHeader.from_map(packet.header))
        frames = BatchHeader.from_map(packet.header).stop if head.type == PacketType.BATCH else self.frames
        self._check_sequence(head.seq, offset)
        self._next_seq = (head.seq + 1) % SEQ_MODULUS
        self.packets += 1
        self.frames = frames

    def _check_sequence(self, seq: int, offset: int) -> None:
        missing = (seq - self._next_seq) % SEQ_MODULUS
        if missing == 0:
            return
        reason = f"packet {seq} stands where packet {self._next_seq} should"
        if not self._recover or missing >= SEQ_MODULUS // 2:
            raise CorruptStream(reason)
        self.skipped.append(SkippedRange(offset, 0, reason))

    def _resynchronize(self, error: FormatError) -> None:
        """Move to the next sync word after the present byte and note what lies between."""
        start = self._source.offset
        self._source.take(1)
        found = self._source.skip_to(SYNC)
        self._skip(start, self._source.offset - start, str(error))
        if not found:
            raise self._truncated()

    def _skip(self, offset: int, size: int, reason: str) -> None:
        if self.skipped and self.skipped[-1].offset + self.skipped[-1].size == offset and self.skipped[-1].size:
            last = self.skipped.pop()
            offset, size, reason = last.offset, last.size + size, last.reason
        if size:
            self.skipped.append(SkippedRange(offset, size, reason))

    def _check_nothing_follows(self) -> None:
        start = self._source.offset
        if not self._source.take(1):
            return
        if not self._recover:
            raise CorruptStream(f"{self.name}: bytes follow END, from byte {start} on; the file is damaged")
        while self._source.take(CHUNK_BYTES):
            pass
        self._skip(start, self._source.offset - start, "bytes follow END")

    def _located(self, error: FormatError, offset: int) -> FormatError:
        if isinstance(error, TruncatedStream):
            return self._truncated()
        return type(error)(f"{self.name}: packet {self._next_seq} at byte {offset}: {error}; the file is damaged")

    def _unreadable(self, error: OSError) -> FormatError:
        return FormatError(f"{self.name}: cannot be read at byte {self._source.end}: {error.strerror or error}")

    def _truncated(self) -> TruncatedStream:
        return TruncatedStream(
            f"{self.name}: ends at byte {self._source.end} without END;"
            f" {self.packets} packets with {self.frames} frames could be read"
        )
