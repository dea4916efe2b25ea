# SPDX-License-Identifier: MIT
"""Packets, their headers, and batches of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from helpers.container_streams import CAMERA, DIGEST, stream_header
from threedvc.errors import CorruptStream, LimitExceeded, UnsupportedVersion
from threedvc.stream import batch, headers, packets
from threedvc.stream.batch import pack_batch, read_batch, split_batch, unpack_batch
from threedvc.stream.headers import (
    BatchHeader,
    ClockHeader,
    EndHeader,
    Header,
    ModelHeader,
    ObjectHeader,
    PoseHeader,
    SnapshotHeader,
    StreamHeader,
    check_supported,
)
from threedvc.stream.packets import Packet, PacketFlag, PacketType, is_understood, type_name
from threedvc.stream.wire import pack_map, unpack_map

EXTRINSIC = (1, 0, 0, 0.025, 0, 0, -1, 0, 0, 1, 0, -0.001)
HEADERS: list[Header] = [
    stream_header(),
    stream_header(
        min_reader=2,
        required=("residual",),
        depth_camera=CAMERA,
        T_color_depth=EXTRINSIC,
        start_ns=-5,
        gray=True,
        given_world=True,
        name="küche 300",
    ),
    ObjectHeader(object_id=65535, voxel_size_m=0.008),
    ModelHeader(frame=0),
    ModelHeader(object_id=3, frame=2**31 - 1),
    PoseHeader(frame=7, count=2**20),
    ClockHeader(frame=7, count=30),
    SnapshotHeader(frame=900, digest=DIGEST),
    BatchHeader(frame=30, count=1),
    EndHeader(frames=0, digest=DIGEST),
]


@pytest.mark.parametrize("header", HEADERS, ids=lambda header: type(header).__name__)
def test_headers_survive_the_stream(header: Header) -> None:
    assert type(header).from_map(unpack_map(pack_map(header.to_map()))) == header


def test_defaults_are_left_out() -> None:
    assert PoseHeader(frame=4).to_map() == {"f": 4}
    assert PoseHeader(object_id=0, frame=0, count=1).to_map() == {"f": 0}
    assert ModelHeader(object_id=2, frame=4).to_map() == {"o": 2, "f": 4}


def test_unknown_keys_are_passed_over() -> None:
    assert PoseHeader.from_map({"f": 4, "later": [1, 2]}) == PoseHeader(frame=4)


def test_stored_types() -> None:
    header = StreamHeader.from_map(unpack_map(pack_map(stream_header().to_map())))
    assert type(header.depth_scale) is float
    assert {type(number) for number in header.color_camera} == {float}


@pytest.mark.parametrize(
    ("header", "values", "message"),
    [
        (PoseHeader, {}, "POSE header: 'f' (frame) is missing"),
        (PoseHeader, {"f": -1}, "POSE header: 'f' (frame) = -1 is not int 0..2147483647"),
        (PoseHeader, {"f": True}, "POSE header: 'f' (frame) = True is not int 0..2147483647"),
        (PoseHeader, {"f": 1.0}, "POSE header: 'f' (frame) = 1.0 is not int 0..2147483647"),
        (PoseHeader, {"f": None}, "POSE header: 'f' (frame) = None is not int 0..2147483647"),
        (PoseHeader, {"f": [1]}, "POSE header: 'f' (frame) = [1] is not int 0..2147483647"),
        (PoseHeader, {"f": 0, "n": 0}, "POSE header: 'n' (count) = 0 is not int 1..1048576"),
        (PoseHeader, {"f": 0, "n": 1 << 20 | 1}, "POSE header: 'n' (count) = 1048577 is not int 1..1048576"),
        (ModelHeader, {"f": 0, "o": 65536}, "MODEL header: 'o' (object_id) = 65536 is not int 0..65535"),
        (ObjectHeader, {"o": 0, "h": 0}, "OBJECT header: 'h' (voxel_size_m) = 0 is not float 1e-06..1000"),
        (ObjectHeader, {"o": 0, "h": math.nan}, "OBJECT header: 'h' (voxel_size_m) = nan is not float 1e-06..1000"),
        (ObjectHeader, {"o": 0, "h": 10**400}, "OBJECT header: 'h' (voxel_size_m) = 1000"),
        (ObjectHeader, {"o": 0, "h": False}, "OBJECT header: 'h' (voxel_size_m) = False is not float 1e-06..1000"),
        (ObjectHeader, {"o": 0, "h": "16mm"}, "OBJECT header: 'h' (voxel_size_m) = '16mm' is not float 1e-06..1000"),
        (EndHeader, {"n": 1, "d": b"short"}, "END header: 'd' (digest) = b'short' is not bin of 16 bytes"),
        (EndHeader, {"n": 1, "d": "x" * 16}, "END header: 'd' (digest) = 'xxxxxxxxxxxxxxxx' is not bin of 16 bytes"),
    ],
)
def test_impossible_values_are_named(header: type[Header], values: dict[str, Any], message: str) -> None:
    with pytest.raises(CorruptStream) as caught:
        header.from_map(values)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("cc", CAMERA[:10]),
        ("cc", ()),
        ("cc", (*CAMERA, 0.0)),
        ("cc", (0, *CAMERA[1:])),
        ("cc", (4.5, *CAMERA[1:])),
        ("cc", (16385, *CAMERA[1:])),
        ("cc", (4, 3, -5, *CAMERA[3:])),
        ("cc", (4, 3, math.inf, *CAMERA[3:])),
        ("cc", ("4", *CAMERA[1:])),
        ("cc", 11),
        ("dc", CAMERA[:5]),
        ("tcd", EXTRINSIC[:9]),
        ("tcd", (2, *EXTRINSIC[1:])),
        ("tcd", (math.nan, *EXTRINSIC[1:])),
        ("ds", 0),
        ("pn", 0),
        ("pd", 0),
        ("t0", 1 << 63),
        ("qt", -0.5),
        ("g", 1),
        ("w", "yes"),
        ("n", "x" * 256),
        ("n", "ö" * 128),
        ("n", b"bytes"),
        ("v", 0),
        ("req", "one"),
        ("req", [1]),
        ("req", ["f"] * 17),
        ("req", ["f" * 65]),
    ],
)
def test_stream_header_refuses(key: str, value: object) -> None:
    with pytest.raises(CorruptStream, match=rf"^STREAM header: '{key}' \(\w+\) = .* is not "):
        StreamHeader.from_map({**stream_header().to_map(), key: value})


def test_encoder_cannot_make_an_impossible_header() -> None:
    with pytest.raises(ValueError, match=r"POSE header: 'n' \(count\) = 0 is not int 1\.\.1048576"):
        PoseHeader(frame=1, count=0)
    with pytest.raises(ValueError, match="MODEL header"):
        ModelHeader(frame=np.int64(3))  # type: ignore[arg-type]


def test_support_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    check_supported(stream_header())
    with pytest.raises(UnsupportedVersion, match="needs reader version 2, this one is 1; use a newer 3dvc"):
        check_supported(stream_header(min_reader=2))
    unknown = stream_header(required=("holes", "gold"))
    with pytest.raises(UnsupportedVersion, match="needs the features holes, gold; use a newer 3dvc"):
        check_supported(unknown)
    monkeypatch.setattr(headers, "FEATURES", frozenset({"holes", "gold"}))
    check_supported(unknown)


def test_understood_types() -> None:
    assert is_understood(PacketType.MODEL, critical=True)
    assert not is_understood(0x99, critical=False)
    assert not is_understood(PacketType.SNAPSHOT, critical=False)
    with pytest.raises(UnsupportedVersion, match="a packet of type 0x99 is needed to decode"):
        is_understood(0x99, critical=True)
    with pytest.raises(UnsupportedVersion, match="a packet of SNAPSHOT is needed to decode"):
        is_understood(PacketType.SNAPSHOT, critical=True)


def test_names_and_flags() -> None:
    assert [type_name(number) for number in (1, 13, 99, 0x80)] == ["STREAM", "END", "type 0x63", "type 0x80"]
    assert Packet(type=2).flags == PacketFlag.CRITICAL
    assert Packet(type=2, critical=False).flags == 0
    assert ModelHeader(frame=1).packet(critical=False, random_access=True).flags == PacketFlag.RANDOM_ACCESS


HEADER = BatchHeader(frame=30, count=30)
MEMBERS = [
    ObjectHeader(object_id=1, voxel_size_m=0.004).packet(),
    ModelHeader(object_id=1, frame=30).packet(b"m" * 1000, random_access=True),
    PoseHeader(object_id=1, frame=30, count=30).packet(b"pose"),
    Packet(type=PacketType.META, header={"k": "v"}, payload=b"text", critical=False),
]


def test_batch_round_trip() -> None:
    joined = pack_batch(HEADER, MEMBERS)
    assert joined.type == PacketType.BATCH
    assert BatchHeader.from_map(joined.header) == HEADER
    assert unpack_batch(joined) == MEMBERS
    assert unpack_batch(pack_batch(HEADER, [])) == []


def test_headers_of_a_batch_are_read_at_once() -> None:
    members = read_batch(pack_batch(HEADER, MEMBERS))
    assert [member.packet for member in members] == MEMBERS
    assert [member.header for member in members] == [
        ObjectHeader(object_id=1, voxel_size_m=0.004),
        ModelHeader(object_id=1, frame=30),
        PoseHeader(object_id=1, frame=30, count=30),
        None,
    ]
    with pytest.raises(CorruptStream, match=r"POSE header: 'f' \(frame\) is missing"):
        read_batch(pack_batch(HEADER, [*MEMBERS, Packet(type=PacketType.POSE)]))


def test_batch_framing_is_small() -> None:
    sizes = [size for _, size in split_batch(pack_batch(HEADER, MEMBERS))]
    assert sum(sizes) == len(pack_batch(HEADER, MEMBERS).payload)
    for member, size in zip(MEMBERS, sizes, strict=True):
        assert size - len(member.payload) - len(pack_map(member.header)) <= 5


def test_batch_passes_unknown_members_over_but_counts_them() -> None:
    joined = pack_batch(HEADER, [Packet(type=0x90, payload=b"private", critical=False), *MEMBERS])
    assert unpack_batch(joined) == MEMBERS
    assert [member.type for member, _ in split_batch(joined)] == [0x90, 2, 3, 4, 8]
    with pytest.raises(UnsupportedVersion, match="type 0x90"):
        unpack_batch(pack_batch(HEADER, [Packet(type=0x90)]))


@pytest.mark.parametrize("number", sorted(packets.TOP_LEVEL_TYPES))
def test_batches_hold_no_top_level_packets(number: PacketType) -> None:
    with pytest.raises(ValueError, match=f"{number.name} cannot stand in a BATCH"):
        pack_batch(HEADER, [Packet(type=number)])
    nested = HEADER.packet(bytes([number, 1, 1, 0x80, 0]))
    with pytest.raises(CorruptStream, match=f"{number.name} stands in a BATCH"):
        unpack_batch(nested)


@pytest.mark.parametrize(
    ("payload", "error", "message"),
    [
        (b"\x04", CorruptStream, "2 bytes are wanted at byte 0 of a payload of 1"),
        (b"\x04\x05\x01\x80\x00", CorruptStream, "POSE in a BATCH has impossible flags 0x05"),
        (b"\x04\x01\x81\x20\x80\x00", LimitExceeded, "a header of 4097 bytes is longer than the 4096"),
        (b"\x04\x01\x81\x00\x80\x00", CorruptStream, "no valid variable-length integer"),
        (b"\x04\x01\x01\x80\xff\xff\xff\xff\x0f", CorruptStream, "4294967295 bytes are wanted at byte 9"),
        (b"\x04\x01\x01\x80" + b"\xff" * 12, CorruptStream, "no valid variable-length integer"),
        (b"\x04\x01\x01\xc0\x00", CorruptStream, "a header of 1 bytes is not a canonical msgpack map"),
    ],
)
def test_damaged_batches(payload: bytes, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        unpack_batch(HEADER.packet(payload))


def test_batch_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "MAX_BATCH_PACKETS", 3)
    with pytest.raises(LimitExceeded, match="4 packets are more than the 3 that fit into one BATCH"):
        pack_batch(HEADER, MEMBERS)
    three = pack_batch(HEADER, MEMBERS[:3])
    assert unpack_batch(three) == MEMBERS[:3]
    with pytest.raises(LimitExceeded, match="a BATCH holds more than 3 packets"):
        unpack_batch(HEADER.packet(three.payload + three.payload))
    monkeypatch.setattr(batch, "MAX_PAYLOAD_BYTES", 1000)
    with pytest.raises(LimitExceeded, match="is larger than 1000; put fewer frames into one"):
        pack_batch(HEADER, MEMBERS[:3])
