# SPDX-License-Identifier: MIT
"""What the reader delivers, what it refuses, and what it recovers."""

from __future__ import annotations

import io
from collections.abc import Callable
from itertools import pairwise

import pytest
import zstandard

from helpers.container_streams import batch, end, packets, raw_packet, records, small_stream, stream_header, stream_of
from threedvc.errors import BadMagic, CorruptStream, FormatError, LimitExceeded, TruncatedStream, UnsupportedVersion
from threedvc.formats.container import FILE_HEAD_BYTES, SkippedRange, StreamReader
from threedvc.formats.container.layout import PACKET_HEAD, SYNC, pack_file_head
from threedvc.stream.batch import unpack_batch
from threedvc.stream.headers import BatchHeader, EndHeader, ModelHeader
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.wire import pack_map

STREAM = raw_packet(1, header=pack_map(stream_header().to_map()))


class Trickle(io.RawIOBase):
    """A source like a slow pipe: a byte or two at a time, no seeking."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        piece, self.data = self.data[: min(size, 2)], self.data[min(size, 2) :]
        return piece


def read(data: bytes) -> list[Packet]:
    return list(StreamReader(io.BytesIO(data), "k.3dvc"))


def recovered(data: bytes) -> tuple[list[Packet], list[SkippedRange]]:
    reader = StreamReader(io.BytesIO(data), "k.3dvc", recover=True)
    return list(reader), reader.skipped


def places() -> dict[str, int]:
    names = ["STREAM", "BATCH0", "BATCH1", "BATCH2", "INDEX", "END"]
    return dict(zip(names, [record.offset for record in records(small_stream())], strict=True))


def test_round_trip() -> None:
    content = read(small_stream())
    assert content[:-1] == packets()
    assert EndHeader.from_map(content[-1].header) == EndHeader.from_map(end().header)


def test_a_slow_pipe_is_enough() -> None:
    reader = StreamReader(Trickle(small_stream()), "k.3dvc")  # type: ignore[arg-type]
    assert list(reader)[:-1] == packets()
    assert (reader.packets, reader.frames) == (6, 30)


def test_records_cover_the_file() -> None:
    data = small_stream()
    content = records(data)
    assert [record.packet.type for record in content] == [1, 11, 11, 11, 12, 13]
    assert content[0].offset == FILE_HEAD_BYTES
    for before, after in pairwise(content):
        assert before.offset + before.size == after.offset
    assert content[-1].offset + content[-1].size == len(data)


def test_parts_of_a_batch_account_for_every_byte() -> None:
    data = small_stream()
    record = records(data)[1]
    whole, *members = record.parts()
    assert [part.packet for part in members] == unpack_batch(record.packet)
    assert whole.packet is record.packet
    assert whole.size == 28 + len(pack_map(record.packet.header))
    assert whole.size + sum(part.size for part in members) == record.size
    for part in members:
        assert data[part.offset] == part.packet.type
        assert data[part.offset : part.offset + part.size].endswith(part.packet.payload)
    stream = records(data)[0]
    assert stream.parts() == [stream]


def test_unknown_packets() -> None:
    private = Packet(type=0x90, header={"x": 1}, payload=b"secret", critical=False)
    reserved = Packet(type=PacketType.SNAPSHOT, header={"f": 20, "d": bytes(16)}, payload=b"later", critical=False)
    data = stream_of([*packets(), private, reserved, end()])
    assert read(data)[:-1] == packets()
    assert private in [record.packet for record in records(data)]
    with pytest.raises(UnsupportedVersion, match=r"^k\.3dvc: packet 4 at byte \d+: a packet of type 0x90 is needed"):
        read(stream_of([*packets(), Packet(type=0x90), end()]))


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        (b"", BadMagic, "k.3dvc: not a .3dvc stream: begins with nothing (empty)"),
        (b"\x89PNG\r\n\x1a\n" + bytes(99), BadMagic, "k.3dvc: not a .3dvc stream: begins with 89 50 4e 47"),
        (small_stream().replace(b"\r\n", b"\n"), BadMagic, "k.3dvc: not a .3dvc stream: begins with 89 33 44 56 43 0a"),
        (b"\x893D", TruncatedStream, "k.3dvc: ends after 3 bytes, within the head of the file; nothing can be read"),
        (pack_file_head()[:-1], TruncatedStream, "k.3dvc: ends after 11 bytes, within the head of the file"),
        (b"\x893DVC\r\n\x1a\n\x02\x00\x00", UnsupportedVersion, "k.3dvc: is of format 2.0, this reader knows 1.x"),
        (b"\x893DVC\r\n\x1a\n\x01\x00\x07", CorruptStream, "k.3dvc: byte 11 is 0x07 instead of 0"),
    ],
)
def test_heads_of_files(data: bytes, error: type[FormatError], message: str) -> None:
    with pytest.raises(error) as caught:
        StreamReader(io.BytesIO(data), "k.3dvc")
    assert str(caught.value).startswith(message)


def test_a_newer_minor_version_is_read() -> None:
    data = bytearray(small_stream())
    data[10] = 9
    assert read(bytes(data))[:-1] == packets()


def test_newer_meaning_is_refused() -> None:
    newer = stream_of([stream_header(min_reader=7).packet(), end(0)])
    with pytest.raises(UnsupportedVersion, match=r"^k\.3dvc: packet 0 at byte 12: the stream needs reader version 7"):
        read(newer)
    with pytest.raises(UnsupportedVersion, match="needs the features light"):
        read(stream_of([stream_header(required=("light",)).packet(), end(0)]))


def test_truncation_delivers_what_is_complete() -> None:
    data = small_stream()
    starts = places()
    received: list[Packet] = []
    with pytest.raises(TruncatedStream) as caught:
        received.extend(StreamReader(io.BytesIO(data[: starts["BATCH2"] + 50]), "k.3dvc"))
    assert received == packets(2)
    assert str(caught.value) == (
        f"k.3dvc: ends at byte {starts['BATCH2'] + 50} without END; 3 packets with 20 frames could be read"
    )


def flip(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data, at: flip(data, at), "packet 2 at byte {at}: no packet begins here: found b7 3d c5 5e instead"),
        (lambda data, at: flip(data, at + 9), "packet 2 at byte {at}: the checksum of its head is wrong"),
        (lambda data, at: flip(data, at + 60), "packet 2 at byte {at}: the checksum of its content is wrong"),
        (
            lambda data, at: data[:at] + data[places()["BATCH2"] :],
            "packet 2 at byte {at}: packet 3 stands where packet 2",
        ),
        (lambda data, at: data[:at] + b"?" + data[at:], "packet 2 at byte {at}: no packet begins here"),
    ],
)
def test_damage_is_located(damage: Callable[[bytes, int], bytes], message: str) -> None:
    at = places()["BATCH1"]
    with pytest.raises(CorruptStream) as caught:
        read(damage(small_stream(), at))
    assert str(caught.value).startswith("k.3dvc: " + message.format(at=at))
    assert str(caught.value).endswith("; the file is damaged")


def test_nothing_follows_end() -> None:
    data = small_stream()
    with pytest.raises(CorruptStream, match=rf"^k\.3dvc: bytes follow END, from byte {len(data)} on"):
        read(data + b"\0")
    assert recovered(data + bytes(7))[1] == [SkippedRange(len(data), 7, "bytes follow END")]


@pytest.mark.parametrize(
    ("packet", "error", "message"),
    [
        (raw_packet(3, seq=1, header_size=4097), LimitExceeded, "a header of 4097 bytes is longer than 4096"),
        (raw_packet(3, seq=1, payload_size=1 << 27), LimitExceeded, "a payload of 134217728 bytes is larger"),
        (raw_packet(3, seq=1, payload_size=2**32 - 1), LimitExceeded, "a payload of 4294967295 bytes is larger"),
        (raw_packet(8, seq=1, flags=4, payload=b"ab", raw_size=1 << 27), LimitExceeded, "a payload of 134217728 bytes"),
        (raw_packet(8, seq=1, flags=4, payload=b"ab", raw_size=513), LimitExceeded, "claims 513 after decompression"),
        (raw_packet(8, seq=1, raw_size=1), LimitExceeded, None),
        (raw_packet(8, seq=1, payload=b"ab", raw_size=1), CorruptStream, "an uncompressed payload of 2 bytes claims 1"),
        (raw_packet(3, seq=1, flags=17), CorruptStream, "flags 0x11 have bits set that must be 0"),
        (raw_packet(8, seq=1, flags=9, payload=b"ab"), UnsupportedVersion, "is compressed by unknown codec 2"),
        (raw_packet(8, seq=1, flags=4, payload=b"ab"), CorruptStream, "its payload cannot be decompressed"),
        (raw_packet(3, seq=1, header=b"\x81"), CorruptStream, "a header cannot be read"),
        (raw_packet(3, seq=1, header=b""), CorruptStream, "a header cannot be read"),
        (raw_packet(3, seq=1, header=b"\xc0"), CorruptStream, "a header of 1 bytes is not a canonical msgpack map"),
        (raw_packet(11, seq=1), CorruptStream, "BATCH header: 'f' (frame) is missing"),
        (raw_packet(1, seq=1), CorruptStream, "STREAM is packet 1, and only the first one is STREAM"),
    ],
)
def test_hostile_packets(packet: bytes, error: type[FormatError], message: str | None) -> None:
    with pytest.raises(FormatError) as caught:
        read(pack_file_head() + STREAM + packet)
    if message is not None:
        assert type(caught.value) is error
        assert str(caught.value).startswith(f"k.3dvc: packet 1 at byte {12 + len(STREAM)}: ")
        assert message in str(caught.value)


def test_compressed_payloads_must_hold_what_they_claim() -> None:
    stored = zstandard.ZstdCompressor().compress(b"facts " * 40)
    for payload, size in ((stored, 239), (stored, 241), (stored + b"more", 240), (stored[:-1], 240)):
        data = pack_file_head() + STREAM + raw_packet(8, seq=1, flags=4, payload=payload, raw_size=size)
        with pytest.raises(CorruptStream, match="payload"):
            read(data)


def test_stream_comes_first() -> None:
    with pytest.raises(CorruptStream, match="MODEL is packet 0, and only the first one is STREAM"):
        read(pack_file_head() + raw_packet(3))


def test_an_unreadable_source_is_named() -> None:
    class Broken(io.BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            raise OSError(5, "Input/output error")

    with pytest.raises(FormatError, match=r"^k\.3dvc: cannot be read at byte 0: Input/output error$"):
        StreamReader(Broken(), "k.3dvc")


def test_a_source_that_breaks_on_the_way_is_named() -> None:
    class Breaking(io.BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            if self.tell() >= 100:
                raise OSError(5, "Input/output error")
            return super().read(size)

    for recover in (False, True):
        reader = StreamReader(Breaking(small_stream()), "k.3dvc", recover=recover)
        with pytest.raises(FormatError, match=r"^k\.3dvc: cannot be read at byte \d+: Input/output error$"):
            list(reader)


def test_recovery_of_an_intact_stream_skips_nothing() -> None:
    content, skipped = recovered(small_stream())
    assert content[:-1] == packets()
    assert skipped == []


@pytest.mark.parametrize("distance", [0, 5, 9, 23, 24, 60])
def test_recovery_goes_on_behind_damage(distance: int) -> None:
    starts = places()
    content, skipped = recovered(flip(small_stream(), starts["BATCH1"] + distance))
    assert content[:-1] == [packets()[0], batch(0), batch(20)]
    assert [(part.offset, part.size) for part in skipped] == [
        (starts["BATCH1"], starts["BATCH2"] - starts["BATCH1"]),
        (starts["BATCH2"], 0),
    ]
    assert skipped[1].reason == "packet 3 stands where packet 2 should"


def test_recovery_where_bytes_are_missing_or_too_many() -> None:
    starts, data = places(), small_stream()
    without = data[: starts["BATCH1"] + 30] + data[starts["BATCH1"] + 40 :]
    assert recovered(without)[0][:-1] == [packets()[0], batch(0), batch(20)]
    more = data[: starts["BATCH1"]] + SYNC + bytes(100) + data[starts["BATCH1"] :]
    content, skipped = recovered(more)
    assert content[:-1] == packets()
    assert [(part.offset, part.size) for part in skipped] == [(starts["BATCH1"], 104)]


def test_recovery_without_a_head_of_the_file() -> None:
    data = small_stream()
    content, skipped = recovered(b"garbage" + data[9:])
    assert content[:-1] == packets()
    assert [(part.offset, part.size) for part in skipped] == [(0, 10)]


def test_recovery_takes_no_packet_twice() -> None:
    starts, data = places(), small_stream()
    again = data[: starts["BATCH2"]] + data[starts["BATCH0"] :]
    content, skipped = recovered(again)
    assert content[:-1] == packets()
    assert [(part.offset, part.size) for part in skipped] == [(starts["BATCH2"], starts["BATCH2"] - starts["BATCH0"])]


def test_recovery_does_not_take_a_stream_in_a_payload_for_the_stream() -> None:
    attached = Packet(type=PacketType.MODEL, header={"f": 0}, payload=small_stream())
    data = stream_of([*packets(), attached, end()])
    content, skipped = recovered(flip(data, records(data)[4].offset + PACKET_HEAD.size + 1))
    assert [packet.type for packet in content] == [1, 11, 11, 11, 13]
    assert skipped


def test_recovery_says_that_a_stream_is_cut() -> None:
    data = flip(small_stream(), places()["BATCH2"] + 40)[: places()["INDEX"]]
    reader = StreamReader(io.BytesIO(data), "k.3dvc", recover=True)
    with pytest.raises(TruncatedStream, match=f"ends at byte {len(data)} without END; 3 packets with 20 frames"):
        list(reader)


def test_sequence_numbers_wrap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("threedvc.formats.container.writer.SEQ_MODULUS", 4)
    monkeypatch.setattr("threedvc.formats.container.reader.SEQ_MODULUS", 4)
    assert len(read(stream_of([*packets(8), end(80)]))) == 10


def test_batches_may_be_huge_in_count_only_with_their_bytes() -> None:
    header = BatchHeader(frame=0, count=1).to_map()
    data = pack_file_head() + STREAM + raw_packet(11, seq=1, header=pack_map(header), payload_size=1 << 26)
    with pytest.raises(TruncatedStream, match="1 packets with 0 frames could be read"):
        read(data)


def test_unbatched_packets_pass() -> None:
    update = ModelHeader(frame=0).packet(b"update")
    assert read(stream_of([packets()[0], update, end(0)]))[1] == update
