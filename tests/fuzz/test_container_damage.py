# SPDX-License-Identifier: MIT
"""Damaged and hostile streams: errors of the tree only, and memory in proportion to the bytes there are."""

from __future__ import annotations

import io
import random
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.container_streams import end, packets, raw_packet, records, small_stream, stream_header, stream_of
from threedvc.errors import FormatError, ThreedvcError, TruncatedStream
from threedvc.formats.container import StreamReader, read_index
from threedvc.formats.container.layout import pack_file_head
from threedvc.stream.batch import pack_batch, split_batch, unpack_batch
from threedvc.stream.headers import BatchHeader
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.wire import pack_map, unpack_map

DATA = small_stream()
COMPLETE = list(StreamReader(io.BytesIO(DATA), "k.3dvc"))
STREAM = raw_packet(1, header=pack_map(stream_header().to_map()))


def consume(data: bytes, *, recover: bool = False) -> list[Packet]:
    """Read all there is, opening batches; return the packets before the first error."""
    received: list[Packet] = []
    message = "none"
    try:
        for packet in StreamReader(io.BytesIO(data), "k.3dvc", recover=recover):
            if packet.type == PacketType.BATCH:
                unpack_batch(packet)
            received.append(packet)
    except ThreedvcError as error:
        message = str(error)
    assert message
    assert "\n" not in message
    return received


def test_truncation_at_every_byte() -> None:
    ends = [record.offset + record.size for record in records(DATA) if record.packet.type != PacketType.INDEX]
    for size in range(1, len(DATA)):
        received: list[Packet] = []
        with pytest.raises(TruncatedStream, match=r"^k\.3dvc: ends a"):
            received.extend(StreamReader(io.BytesIO(DATA[:size]), "k.3dvc"))
        if size >= 12:
            assert received == COMPLETE[: sum(place <= size for place in ends)]
        with pytest.raises(FormatError):
            read_index(io.BytesIO(DATA[:size]), "k.3dvc")


def test_every_flipped_bit_is_noticed() -> None:
    for place in range(len(DATA)):
        if place == 10:
            continue  # the minor version may be any
        damaged = bytearray(DATA)
        damaged[place] ^= 1 << (place % 8)
        with pytest.raises(FormatError, match=r"^k\.3dvc: "):
            list(StreamReader(io.BytesIO(bytes(damaged)), "k.3dvc"))


def test_recovery_from_every_flipped_byte_loses_one_packet_at_most() -> None:
    for place in range(12, len(DATA)):
        damaged = DATA[:place] + bytes([DATA[place] ^ 0xFF]) + DATA[place + 1 :]
        received = consume(damaged, recover=True)
        assert len(received) >= len(COMPLETE) - 1
        assert all(packet in COMPLETE for packet in received)


def test_random_damage() -> None:
    generator = random.Random(1995)
    for _ in range(300):
        damaged = bytearray(DATA)
        for _ in range(generator.randint(1, 8)):
            place = generator.randrange(len(damaged))
            match generator.randrange(3):
                case 0:
                    damaged[place] = generator.randrange(256)
                case 1:
                    del damaged[place : place + generator.randint(1, 40)]
                case _:
                    damaged[place:place] = generator.randbytes(generator.randint(1, 40))
            if not damaged:
                break
        for recover in (False, True):
            assert all(packet in COMPLETE for packet in consume(bytes(damaged), recover=recover))


@given(st.binary(max_size=200))
def test_any_bytes(data: bytes) -> None:
    consume(data)
    consume(pack_file_head() + data, recover=True)


@given(
    number=st.integers(0, 255),
    flags=st.integers(0, 255),
    header=st.binary(max_size=40),
    payload=st.binary(max_size=40),
    header_size=st.none() | st.integers(0, 2**16 - 1),
    payload_size=st.none() | st.integers(0, 2**32 - 1),
    raw_size=st.none() | st.integers(0, 2**32 - 1),
)
def test_any_packet_with_right_checksums(
    number: int,
    flags: int,
    header: bytes,
    payload: bytes,
    header_size: int | None,
    payload_size: int | None,
    raw_size: int | None,
) -> None:
    packet = raw_packet(
        number,
        flags=flags,
        header=header,
        payload=payload,
        seq=1,
        header_size=header_size,
        payload_size=payload_size,
        raw_size=raw_size,
    )
    for recover in (False, True):
        consume(pack_file_head() + STREAM + packet, recover=recover)


@given(st.binary(max_size=60))
def test_any_header(data: bytes) -> None:
    try:
        values = unpack_map(data)
    except FormatError:
        return
    assert pack_map(values) == data


@given(st.binary(max_size=100))
def test_any_batch(payload: bytes) -> None:
    packet = BatchHeader(frame=0, count=1).packet(payload)
    try:
        members = [member for member, _ in split_batch(packet)]
    except FormatError:
        return
    assert pack_batch(BatchHeader(frame=0, count=1), members) == packet


def peak_bytes(data: bytes, *, recover: bool = False) -> int:
    tracemalloc.start()
    try:
        consume(data, recover=recover)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


FIXED_BYTES = 4 << 20  # a header of 4096 bytes may open 1024 lists of 256 items before msgpack refuses it
BATCH_HEADER = pack_map(BatchHeader(frame=0, count=1).to_map())


@pytest.mark.parametrize(
    "packet",
    [
        raw_packet(3, seq=1, payload_size=1 << 26),
        raw_packet(3, seq=1, payload_size=2**32 - 1),
        raw_packet(8, seq=1, flags=4, payload=bytes.fromhex("28b52ffd a4 00000004") + bytes(40), raw_size=1 << 26),
        raw_packet(8, seq=1, flags=4, payload=bytes.fromhex("28b52ffd a4 00000004") + bytes(40), raw_size=10000),
        raw_packet(3, seq=1, header=b"\x81\xa1a" + b"\xdc\xff\xff" * 1360),
        raw_packet(3, seq=1, header=b"\x81\xa1a" + b"\xdc\x01\x00" * 1360),
        raw_packet(3, seq=1, header=b"\x81\xa1a" + b"\xde\x01\x00\xa0" * 1020),
        raw_packet(3, seq=1, header=b"\xdf\xff\xff\xff\xff"),
        raw_packet(3, seq=1, header=b"\x81\xa1a\xc6\xff\xff\xff\xff"),
        raw_packet(11, seq=1, header=BATCH_HEADER, payload=b"\x04\x01\x01\x80\xff\xff\xff\xff\x0f"),
        raw_packet(11, seq=1, header=BATCH_HEADER, payload=b"\x04\x01\xff\x1f" + bytes(100)),
    ],
)
def test_absurd_lengths_allocate_nothing(packet: bytes) -> None:
    data = pack_file_head() + STREAM + packet
    consume(data)
    for recover in (False, True):
        assert peak_bytes(data, recover=recover) < FIXED_BYTES + 20 * len(data)


def test_expansion_is_bounded() -> None:
    zeros = Packet(type=PacketType.ATTACHMENT, payload=bytes(100_000), critical=False)
    data = stream_of([*packets(), zeros, end()])
    assert peak_bytes(data) < 10 * len(data)
