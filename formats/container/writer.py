# SPDX-License-Identifier: MIT
"""Packets to a stream of bytes, in one pass: the sink may be a pipe."""

from __future__ import annotations

from dataclasses import replace
from typing import BinaryIO

from threedvc.errors import OutputError
from threedvc.formats.container.framing import pack_packet
from threedvc.formats.container.index import IndexEntry, pack_index
from threedvc.formats.container.layout import INDEX_POINTER, SEQ_MODULUS, pack_file_head
from threedvc.limits import MAX_INDEX_ENTRIES
from threedvc.stream.headers import BatchHeader, SnapshotHeader
from threedvc.stream.packets import Packet, PacketType, type_name

__all__ = ["StreamWriter"]


class StreamWriter:
    """Writes a .3dvc stream; the index is kept on the way and written before END.

    A stream that is closed without END is a truncated one: it decodes up to its last BATCH.

    Parameters
    ----------
    stream
        A binary sink. It is flushed after every BATCH, and never closed here.
    name
        Name for messages.

    Attributes
    ----------
    frames
        Frames up to the end of the last batch that has been written and flushed.
    ended
        Whether END has been written.
    offset
        Bytes written.

    Raises
    ------
    OutputError
        If the sink refuses bytes; all methods raise this too.
    BrokenPipeError
        If nobody reads the pipe any more, which is for the program to judge.
    """

    def __init__(self, stream: BinaryIO, name: str = "stream") -> None:
        self.name = name
        self.frames = 0
        self.ended = False
        self.offset = 0
        self._stream = stream
        self._seq = 0
        self._index: list[IndexEntry] = []
        self._emit(pack_file_head())

    def write(self, packet: Packet) -> None:
        """Write one packet. The first is STREAM, the last END; the INDEX is the writer's own.

        Raises
        ------
        ValueError
            If the packet cannot stand here.
        LimitExceeded
            If it is larger than a reader accepts.
        """
        self._check_order(packet)
        if packet.type == PacketType.END:
            packet = replace(packet, payload=INDEX_POINTER.pack(self.offset))
            self._put(Packet(type=PacketType.INDEX, payload=pack_index(self._index), critical=False))
        self._note_place(packet)
        self._put(packet)
        if packet.type == PacketType.BATCH:
            self.flush()
            self.frames = BatchHeader.from_map(packet.header).stop
        if packet.type == PacketType.END:
            self.ended = True

    def flush(self) -> None:
        """Hand everything written so far on to the sink's other end."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            raise self._refused(error) from None

    def close(self) -> None:
        """Flush; the sink stays open, for it belongs to the caller."""
        self.flush()

    def _check_order(self, packet: Packet) -> None:
        name = type_name(packet.type)
        if self.ended:
            raise ValueError(f"{name} cannot follow END")
        if (packet.type == PacketType.STREAM) != (self._seq == 0):
            raise ValueError(f"{name} is packet {self._seq}; STREAM is the first packet and stands nowhere else")
        if packet.type == PacketType.INDEX or (packet.type == PacketType.END and packet.payload):
            raise ValueError(f"{name} has a payload of the writer's own making")

    def _note_place(self, packet: Packet) -> None:
        if packet.type == PacketType.BATCH:
            frame = BatchHeader.from_map(packet.header).frame
        elif packet.type == PacketType.SNAPSHOT:
            frame = SnapshotHeader.from_map(packet.header).frame
        else:
            return
        if self._index and frame < self._index[-1].frame:
            raise ValueError(f"{type_name(packet.type)} of frame {frame} follows one of {self._index[-1].frame}")
        if len(self._index) < MAX_INDEX_ENTRIES:
            self._index.append(IndexEntry(frame, self.offset, packet.random_access))

    def _put(self, packet: Packet) -> None:
        self._emit(pack_packet(packet, self._seq % SEQ_MODULUS))
        self._seq += 1

    def _emit(self, data: bytes) -> None:
        try:
            self._stream.write(data)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise self._refused(error) from None
        self.offset += len(data)

    def _refused(self, error: OSError) -> OutputError:
        return OutputError(f"{self.name}: cannot be written: {error.strerror or error}")
