# SPDX-License-Identifier: MIT
"""What the writer puts out, and what it refuses to."""

from __future__ import annotations

import errno
import io
from dataclasses import replace

import pytest

from helpers.container_streams import batch, end, packets, records, small_stream, stream_header, stream_of
from threedvc.errors import LimitExceeded, OutputError
from threedvc.formats.container import IndexEntry, StreamWriter, read_index, writer
from threedvc.formats.container.layout import FILE_HEAD_BYTES, MAGIC
from threedvc.stream.headers import SnapshotHeader
from threedvc.stream.packets import Packet, PacketType


class Pipe(io.RawIOBase):
    """A sink that can only be written to, and counts what has been flushed."""

    def __init__(self) -> None:
        self.written = bytearray()
        self.flushed = 0

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        self.written += data
        return len(data)

    def flush(self) -> None:
        self.flushed = len(self.written) if not self.closed else self.flushed


class FullDisk(io.BytesIO):
    """A sink with room for a few bytes."""

    def __init__(self, room: int, number: int = errno.ENOSPC) -> None:
        super().__init__()
        self.room = room
        self.number = number

    def write(self, data: bytes) -> int:  # type: ignore[override]
        if self.tell() + len(data) > self.room:
            raise OSError(self.number, "No space left on device")
        return super().write(data)


def test_head_is_written_at_once() -> None:
    sink = io.BytesIO()
    StreamWriter(sink)
    assert sink.getvalue() == MAGIC + b"\x01\x00\x00"


def test_a_pipe_is_enough() -> None:
    sink = Pipe()
    stream = StreamWriter(sink)  # type: ignore[arg-type]
    for packet in [*packets(), end()]:
        stream.write(packet)
    stream.close()
    assert bytes(sink.written) == small_stream()
    assert sink.flushed == stream.offset == len(sink.written)


def test_every_batch_is_flushed() -> None:
    sink = Pipe()
    stream = StreamWriter(sink)  # type: ignore[arg-type]
    stream.write(packets()[0])
    assert sink.flushed == 0
    for number in range(3):
        stream.write(batch(10 * number))
        assert sink.flushed == len(sink.written)
        assert stream.frames == 10 * (number + 1)


def test_index_lists_batches_and_snapshots() -> None:
    snapshot = SnapshotHeader(frame=10, digest=bytes(16)).packet(b"state", critical=False, random_access=True)
    meta = Packet(type=PacketType.META, header={"a": 1}, critical=False)
    data = stream_of([*packets(1), meta, snapshot, batch(10), end(20)])
    offsets = {(record.packet.type, record.packet.header.get("f")): record.offset for record in records(data)}
    assert read_index(io.BytesIO(data), "k.3dvc").entries == (
        IndexEntry(0, offsets[PacketType.BATCH, 0], False),
        IndexEntry(10, offsets[PacketType.SNAPSHOT, 10], True),
        IndexEntry(10, offsets[PacketType.BATCH, 10], False),
    )


def test_a_full_index_stops_growing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "MAX_INDEX_ENTRIES", 2)
    entries = read_index(io.BytesIO(small_stream()), "k.3dvc").entries
    assert [entry.frame for entry in entries] == [0, 10]


@pytest.mark.parametrize("number", [PacketType.META, PacketType.ATTACHMENT])
def test_texts_are_compressed_where_that_helps(number: PacketType) -> None:
    long = Packet(type=number, payload=b"encoder options " * 50, critical=False)
    short = Packet(type=number, payload=b"options", critical=False)
    none, with_long, with_short = (len(stream_of([*packets(), *extra, end()])) for extra in ([], [long], [short]))
    assert with_long - none < 80
    assert with_short - none == 28 + 1 + len(short.payload)
    content = [record.packet for record in records(stream_of([*packets(), long, short, end()]))]
    assert content[-4:-2] == [long, short]


def test_extreme_compression_is_not_used() -> None:
    zeros = Packet(type=PacketType.ATTACHMENT, payload=bytes(1 << 20), critical=False)
    data = stream_of([*packets(), zeros, end()])
    assert len(data) > 1 << 20
    assert zeros in [record.packet for record in records(data)]


def test_entropy_coded_payloads_are_stored() -> None:
    with_zeros = stream_of(
        [stream_header().packet(), Packet(type=PacketType.MODEL, header={"f": 0}, payload=bytes(99))]
    )
    assert bytes(99) in with_zeros


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([batch(0)], "BATCH is packet 0; STREAM is the first packet and stands nowhere else"),
        ([end()], "END is packet 0; STREAM is the first packet"),
        ([packets()[0], packets()[0]], "STREAM is packet 1; STREAM is the first packet and stands nowhere else"),
        ([*packets(), end(), batch(90)], "BATCH cannot follow END"),
        ([*packets(), Packet(type=PacketType.INDEX)], "INDEX has a payload of the writer's own making"),
        ([*packets(), replace(end(), payload=b"x")], "END has a payload of the writer's own making"),
        ([*packets(), batch(10)], "BATCH of frame 10 follows one of 20"),
    ],
)
def test_wrong_order(content: list[Packet], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        stream_of(content)


def test_large_packets_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("threedvc.formats.container.framing.MAX_PAYLOAD_BYTES", 1000)
    with pytest.raises(LimitExceeded, match="ATTACHMENT payload of 1001 bytes is larger than 1000"):
        stream_of([*packets(), Packet(type=PacketType.ATTACHMENT, payload=bytes(1001))])
    with pytest.raises(LimitExceeded, match=r"a header of \d+ bytes is longer than 4096; shorten its texts"):
        stream_of([*packets(), Packet(type=PacketType.META, header={"a": "x" * 5000})])


def test_a_full_disk_is_named() -> None:
    stream = StreamWriter(FullDisk(FILE_HEAD_BYTES), "k.3dvc")
    with pytest.raises(OutputError, match=r"^k\.3dvc: cannot be written: No space left on device$"):
        stream.write(packets()[0])
    assert stream.frames == 0


def test_a_closed_pipe_is_passed_on() -> None:
    stream = StreamWriter(FullDisk(FILE_HEAD_BYTES, errno.EPIPE), "k.3dvc")
    with pytest.raises(BrokenPipeError):
        stream.write(packets()[0])


@pytest.mark.parametrize(("number", "error"), [(errno.EIO, OutputError), (errno.EPIPE, BrokenPipeError)])
def test_a_failing_flush(number: int, error: type[Exception]) -> None:
    class Unsteady(io.BytesIO):
        def flush(self) -> None:
            raise OSError(number, "Input/output error")

    stream = StreamWriter(Unsteady(), "k.3dvc")
    with pytest.raises(error, match="Input/output error"):
        stream.flush()


def test_frames_without_a_batch_count() -> None:
    stream = StreamWriter(io.BytesIO())
    for packet in [packets()[0], batch(0), batch(90, count=5)]:
        stream.write(packet)
    assert stream.frames == 95
