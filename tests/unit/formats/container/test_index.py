# SPDX-License-Identifier: MIT
"""The INDEX and the way to it from the end of a file."""

from __future__ import annotations

import io
import os
from pathlib import Path

import pytest

from helpers.container_streams import batch, end, packets, records, small_stream, stream_of
from threedvc.errors import BadMagic, CorruptStream, FormatError, LimitExceeded, TruncatedStream
from threedvc.formats.container import IndexEntry, index, read_index
from threedvc.formats.container.index import pack_index, unpack_index

ENTRIES = (
    IndexEntry(0, 100, True),
    IndexEntry(0, 300, False),
    IndexEntry(30, 70000, False),
    IndexEntry(60, 1 << 40, True),
)


def test_payload() -> None:
    assert unpack_index(pack_index(ENTRIES)) == ENTRIES
    assert pack_index(ENTRIES[:2]).hex(" ") == "01 64 00 c8 01"
    assert unpack_index(b"") == ()


def test_damaged_payloads(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CorruptStream, match="1 bytes are wanted"):
        unpack_index(pack_index(ENTRIES)[:3])
    monkeypatch.setattr(index, "MAX_INDEX_ENTRIES", 3)
    with pytest.raises(LimitExceeded, match="an INDEX holds more than 3 entries"):
        unpack_index(pack_index(ENTRIES))


def test_offsets_lead_to_the_batches() -> None:
    data = small_stream()
    batches = {record.packet.header["f"]: record.offset for record in records(data) if record.packet.type == 11}
    assert {entry.frame: entry.offset for entry in read_index(io.BytesIO(data), "k.3dvc").entries} == batches


def test_only_head_index_and_end_are_read() -> None:
    class Counting(io.BytesIO):
        taken = 0

        def read(self, size: int | None = -1) -> bytes:
            data = super().read(size)
            self.taken += len(data)
            return data

    source = Counting(
        stream_of([*packets(1), *(batch(frame, payload=bytes(5000)) for frame in range(10, 200, 10)), end()])
    )
    read_index(source, "k.3dvc")
    assert source.taken < 300


@pytest.mark.parametrize("missing", [1, 30, 61, 100, 300])
def test_cut_files_have_no_index(missing: int) -> None:
    with pytest.raises(FormatError, match=r"^k\.3dvc: "):
        read_index(io.BytesIO(small_stream()[:-missing]), "k.3dvc")


def test_messages() -> None:
    data = small_stream()
    no_end = stream_of(packets())
    for content, error, message in (
        (no_end, TruncatedStream, "k.3dvc: has no END; it was cut short or is still being written"),
        (data[:12], TruncatedStream, "k.3dvc: has no END; it was cut short or is still being written"),
        (data[:8], TruncatedStream, "k.3dvc: ends after 8 bytes, within the head of the file; nothing can be read"),
        (b"", BadMagic, "k.3dvc: not a .3dvc stream: begins with nothing (empty)"),
        (
            data[:-12] + (12).to_bytes(8, "little") + data[-4:],
            CorruptStream,
            "k.3dvc: STREAM stands where INDEX should",
        ),
        (
            data[:-12] + (len(data) - 12).to_bytes(8, "little") + data[-4:],
            TruncatedStream,
            f"k.3dvc: ends at byte {len(data)}, 12 bytes too early",
        ),
        (data + data[-12:], CorruptStream, "k.3dvc: 12 bytes follow END; the file is damaged"),
    ):
        with pytest.raises(error) as caught:
            read_index(io.BytesIO(content), "k.3dvc")
        assert str(caught.value) == message


def test_pipes_have_no_place_to_look_up(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.close(writing)
    with open(reading, "rb") as pipe, pytest.raises(FormatError, match=r"^-: frames cannot be looked up in it: "):
        read_index(pipe, "-")
