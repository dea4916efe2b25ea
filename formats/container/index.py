# SPDX-License-Identifier: MIT
"""The INDEX: where in the file the frames begin."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import BinaryIO, NamedTuple

from threedvc.errors import CorruptStream, FormatError, LimitExceeded, TruncatedStream
from threedvc.formats.container.framing import unpack_body
from threedvc.formats.container.layout import (
    CRC,
    FILE_HEAD_BYTES,
    INDEX_POINTER,
    PACKET_HEAD,
    check_file_head,
    unpack_packet_head,
)
from threedvc.formats.container.source import ByteSource
from threedvc.limits import MAX_INDEX_ENTRIES
from threedvc.stream.packets import Packet, PacketType, type_name
from threedvc.stream.wire import ByteReader, pack_varint

__all__ = ["IndexEntry", "StreamIndex", "pack_index", "read_index", "unpack_index"]


class IndexEntry(NamedTuple):
    """One BATCH or SNAPSHOT: its first frame, its place in the file, whether decoding can start there."""

    frame: int
    offset: int
    random_access: bool


@dataclass(frozen=True)
class StreamIndex:
    """The entries of an INDEX, by rising frame and offset."""

    entries: tuple[IndexEntry, ...]


def pack_index(entries: Iterable[IndexEntry]) -> bytes:
    """Return the payload of an INDEX: two variable-length integers for each entry.

    The first is twice the rise of the frame plus 1 if decoding can start there, the second the rise
    of the offset.
    """
    out = bytearray()
    frame = offset = 0
    for entry in entries:
        out += pack_varint((entry.frame - frame) << 1 | entry.random_access)
        out += pack_varint(entry.offset - offset)
        frame, offset = entry.frame, entry.offset
    return bytes(out)


def unpack_index(payload: bytes) -> tuple[IndexEntry, ...]:
    """Read the payload of an INDEX; inverse of `pack_index`.

    Raises
    ------
    CorruptStream
        If it is not a sequence of pairs of integers.
    LimitExceeded
        If there are more than `MAX_INDEX_ENTRIES`.
    """
    reader = ByteReader(payload)
    entries: list[IndexEntry] = []
    frame = offset = 0
    while reader.remaining:
        if len(entries) == MAX_INDEX_ENTRIES:
            raise LimitExceeded(f"an INDEX holds more than {MAX_INDEX_ENTRIES} entries")
        rise = reader.varint()
        frame += rise >> 1
        offset += reader.varint()
        entries.append(IndexEntry(frame, offset, bool(rise & 1)))
    return tuple(entries)


def read_index(stream: BinaryIO, name: str) -> StreamIndex:
    """Read the INDEX of a complete file, going straight to its end.

    Parameters
    ----------
    stream
        A seekable binary stream; its position is not kept.
    name
        Name for messages.

    Raises
    ------
    TruncatedStream
        If the file does not end with END: it was cut short or is being written.
    FormatError
        If it cannot be read, or is not a .3dvc stream.
    """
    try:
        return StreamIndex(unpack_index(_find_index(stream).payload))
    except FormatError as error:
        raise type(error)(f"{name}: {error}") from None
    except OSError as error:
        raise FormatError(f"{name}: frames cannot be looked up in it: {error.strerror or error}") from None


def _find_index(stream: BinaryIO) -> Packet:
    size = stream.seek(0, os.SEEK_END)
    check_file_head(_source_at(stream, 0).take(FILE_HEAD_BYTES))
    source = _source_at(stream, _index_offset(stream, size))
    index = _take_packet(source, PacketType.INDEX)
    _take_packet(source, PacketType.END)
    if source.offset != size:
        raise CorruptStream(f"{size - source.offset} bytes follow END; the file is damaged")
    return index


def _index_offset(stream: BinaryIO, size: int) -> int:
    tail = INDEX_POINTER.size + CRC.size
    source = _source_at(stream, max(size - tail, 0))
    offset: int = INDEX_POINTER.unpack(source.take(tail)[: INDEX_POINTER.size].rjust(INDEX_POINTER.size))[0]
    if not FILE_HEAD_BYTES <= offset <= size - tail:
        raise TruncatedStream("has no END; it was cut short or is still being written")
    return offset


def _source_at(stream: BinaryIO, offset: int) -> ByteSource:
    stream.seek(offset)
    return ByteSource(stream, offset)


def _take_packet(source: ByteSource, expected: PacketType) -> Packet:
    head = unpack_packet_head(source.exactly(PACKET_HEAD.size))
    if head.type != expected:
        raise CorruptStream(f"{type_name(head.type)} stands where {expected.name} should")
    return unpack_body(head, source.exactly(head.body_size))
