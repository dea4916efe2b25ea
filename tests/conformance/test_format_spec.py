# SPDX-License-Identifier: MIT
"""docs/format.md against the code: every table, and the example byte by byte."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest

from helpers.container_streams import DIGEST, records, stream_header, stream_of
from threedvc import errors, limits
from threedvc.decoder.packet_handlers import HANDLERS
from threedvc.formats.container import layout
from threedvc.formats.container.framing import COMPRESSED_TYPES
from threedvc.model.decoded_model import DecodedModel, models_digest
from threedvc.model.model_update import ModelUpdate
from threedvc.stream.batch import pack_batch
from threedvc.stream.header_fields import FieldType
from threedvc.stream.header_reader import BATCH_TYPES, HEADER_TYPES
from threedvc.stream.headers import BatchHeader, EndHeader, Header, ObjectHeader, PoseHeader
from threedvc.stream.packets import RESERVED_TYPES, TOP_LEVEL_TYPES, PacketFlag, PacketType, is_understood
from threedvc.stream.wire import DIGEST_BYTES, pack_varint

Rows = list[dict[str, str]]


HEADERS = list(HEADER_TYPES.values())


def header_classes(base: type[Header]) -> list[type[Header]]:
    """Return a header class, if it is that of a packet, and all that are derived from it."""
    derived = [header for each in base.__subclasses__() for header in header_classes(each)]
    return [base, *derived] if hasattr(base, "packet_type") else derived


@pytest.fixture(scope="module")
def spec(repository: Path) -> str:
    return (repository / "docs" / "format.md").read_text(encoding="utf-8")


def section(spec: str, heading: str) -> str:
    match = re.search(rf"^#+ {re.escape(heading)}\n(.*?)(?=^#+ |\Z)", spec, re.MULTILINE | re.DOTALL)
    assert match, f"docs/format.md has no section {heading!r}"
    return match.group(1)


def table(spec: str, heading: str) -> Rows:
    lines = [line for line in section(spec, heading).splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert len(cells) > 2, f"section {heading!r} has no table"
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def unquoted(text: str) -> str:
    return text.removeprefix("`").removesuffix("`")


def test_file_head(spec: str) -> None:
    rows = table(spec, "File")
    head = layout.pack_file_head()
    assert [int(row["size"]) for row in rows] == [9, 1, 1, 1]
    for row in rows:
        part = head[int(row["offset"]) : int(row["offset"]) + int(row["size"])]
        value = unquoted(row["meaning"].split(";")[0])
        assert part == (bytes.fromhex(value) if row["type"] == "bytes" else bytes([int(value)])), row["field"]
    assert len(head) == layout.FILE_HEAD_BYTES == sum(int(row["size"]) for row in rows)


def test_packet_head(spec: str) -> None:
    types = {"4s": "bytes", "B": "u8", "H": "u16", "I": "u32"}
    rows = table(spec, "Packet head")
    offset = 0
    for row, (name, code) in zip(rows, layout.PACKET_HEAD_FIELDS, strict=True):
        size = struct.calcsize("<" + code)
        assert (row["field"], int(row["offset"]), int(row["size"]), row["type"]) == (name, offset, size, types[code])
        offset += size
    assert offset == layout.PACKET_HEAD.size
    assert bytes.fromhex(unquoted(rows[0]["meaning"])) == layout.SYNC
    between = [name for name, _ in layout.PACKET_HEAD_FIELDS][1:-1]
    assert between == list(layout.PacketHead._fields)


def test_packet_body(spec: str) -> None:
    rows = table(spec, "Packet body")
    head = layout.PacketHead(type=1, flags=1, header_size=5, payload_size=7, raw_size=7, seq=0)
    sizes = {"header_size": head.header_size, "payload_size": head.payload_size, "4": 4}
    offset = layout.PACKET_HEAD.size
    for row in rows:
        terms = row["offset"].split(" + ")
        assert sum(sizes.get(term, 0) or int(term) for term in terms) == offset
        offset += sizes[row["size"]]
    assert offset == layout.PACKET_HEAD.size + head.body_size


def test_flags_and_codecs(spec: str) -> None:
    rows = table(spec, "Flags")
    named = {row["name"]: 1 << int(row["bits"]) for row in rows if row["name"].isupper()}
    assert named == {flag.name: flag.value for flag in PacketFlag}
    codec_bits = next(row["bits"] for row in rows if row["name"] == "codec")
    assert int(codec_bits.split("-")[0]) == layout.CODEC_SHIFT
    assert int(codec_bits.split("-")[1]) + 1 == layout.KNOWN_FLAGS.bit_length()
    codecs = {row["name"]: int(row["number"]) for row in table(spec, "Payload codecs")}
    assert codecs == {codec.name: codec.value for codec in layout.Codec}
    compressed = re.search(r"Writers compress only (.*?), and", section(spec, "Payload codecs"))
    assert compressed
    assert set(re.findall("[A-Z]{2,}", compressed.group(1))) == {member.name for member in COMPRESSED_TYPES}


def test_packet_types(spec: str) -> None:
    rows = table(spec, "Packet types")
    assert {row["name"]: int(row["number"]) for row in rows} == {member.name: member.value for member in PacketType}
    assert {row["name"] for row in rows if row["flag"] == "reserved"} == {member.name for member in RESERVED_TYPES}
    assert {row["name"] for row in rows if row["place"] == "top"} == {member.name for member in TOP_LEVEL_TYPES}
    headers = {header.packet_type.name for header in HEADERS}
    assert {row["name"] for row in rows if row["header"].startswith("Header: ")} == headers
    for row in rows:
        for column in ("header", "payload"):
            if ":" in row[column]:
                assert section(spec, row[column])


def test_understood_types(spec: str) -> None:
    understood = {row["name"] for row in table(spec, "Packet types") if row["flag"] != "reserved"}
    assert understood == {member.name for member in PacketType if is_understood(member, critical=False)}


@pytest.mark.parametrize("header", HEADERS, ids=lambda header: header.packet_type.name)
def test_header_fields(spec: str, header: type[Header]) -> None:
    rows = table(spec, f"Header: {header.packet_type.name}")
    for row, field in zip(rows, dataclasses.fields(header), strict=True):
        field_type: FieldType = field.metadata["type"]
        assert unquoted(row["key"]) == field.metadata["key"]
        assert row["field"] == field.name
        assert row["type"] == field_type.description
        required = field.default is dataclasses.MISSING
        told = "required" if required else f"`{json.dumps(field.default, default=bytes.hex)}`"
        assert row["default"] == told, field.name
        assert row["meaning"]


def test_every_header_is_registered() -> None:
    assert {header: header.packet_type for header in header_classes(Header)} == {
        header: number for number, header in HEADER_TYPES.items()
    }


def test_every_header_in_a_batch_has_a_handler() -> None:
    assert {header.packet_type for header in HANDLERS} == BATCH_TYPES


def test_keys_are_unique() -> None:
    for header in HEADERS:
        keys = [field.metadata["key"] for field in dataclasses.fields(header)]
        assert len(set(keys)) == len(keys), header.packet_type.name


def test_batch_framing(spec: str) -> None:
    member = PoseHeader(frame=200, count=3).packet(b"x" * 300)
    payload = pack_batch(BatchHeader(frame=200, count=3), [member]).payload
    rows = table(spec, "Payload: BATCH")
    assert [row["field"] for row in rows] == ["type", "flags", "m", "header", "n", "payload"]
    assert payload[:2] == bytes([PacketType.POSE, PacketFlag.CRITICAL])
    header_size = payload[2]
    assert payload[3 + header_size :] == pack_varint(300) + b"x" * 300
    assert len(pack_varint(2**32 - 1)) == int(rows[2]["size"].split(" to ")[1])
    assert len(pack_varint(2**64 - 1)) == int(table(spec, "Payload: INDEX")[0]["size"].split(" to ")[1])


def test_end_pointer(spec: str) -> None:
    (row,) = table(spec, "Payload: END")
    assert (int(row["size"]), row["type"]) == (layout.INDEX_POINTER.size, "u64")


def test_limits(spec: str) -> None:
    assert {row["name"]: int(row["value"]) for row in table(spec, "Limits")} == {
        name: getattr(limits, name) for name in limits.__all__
    }


def test_digest(spec: str) -> None:
    text = section(spec, "Digest")
    assert text.lstrip().startswith(f"The first {DIGEST_BYTES} bytes of the SHA-256")
    cells = np.array([[-1, -1, -1], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5]], dtype=np.int32)
    colors = np.arange(15, dtype=np.int16).reshape(5, 3) * 17 - 1
    model = DecodedModel(0.016)
    model.apply(
        ModelUpdate(
            added=cells,
            added_colors=colors,
            removed=np.zeros((0, 3), np.int32),
            recolored=np.zeros((0, 3), np.int32),
            recolored_colors=np.zeros((0, 3), np.int16),
        )
    )
    flat_cells, flat_colors = cells.ravel().tolist(), colors.ravel().tolist()
    of_model = hashlib.sha256(struct.pack("<d15i15h", 0.016, *flat_cells, *flat_colors)).digest()[:16]
    expected = b"".join(struct.pack("<I", number) + of_model for number in (0, 7))
    assert models_digest({7: model, 0: model}) == hashlib.sha256(expected).digest()[:16]


def test_errors_exist(spec: str) -> None:
    for row in table(spec, "Reading"):
        assert issubclass(getattr(errors, row["error"].split(",")[0]), errors.FormatError)


def test_example(spec: str) -> None:
    listing = section(spec, "Example").split("```")[1]
    numbers = "".join(re.match(r"(?: *[0-9a-f]{2}(?![0-9a-zA-Z:]))*", line)[0] for line in listing.splitlines())
    expected = stream_of(
        [
            stream_header().packet(),
            pack_batch(
                BatchHeader(frame=0, count=1),
                [ObjectHeader(object_id=0, voxel_size_m=0.5).packet(), PoseHeader(frame=0).packet()],
            ),
            EndHeader(frames=1, digest=DIGEST).packet(),
        ]
    )
    assert bytes.fromhex(numbers).hex(" ") == expected.hex(" ")
    assert str(len(expected)) in section(spec, "Example")
    assert [record.packet.type for record in records(expected)] == [1, 11, 12, 13]
