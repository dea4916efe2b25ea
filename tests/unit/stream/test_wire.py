# SPDX-License-Identifier: MIT
"""Canonical maps and variable-length integers."""

from __future__ import annotations

import datetime
import math
from typing import Any

import pytest

from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.stream.wire import ByteReader, pack_map, pack_signed_varint, pack_varint, unpack_map


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({}, "80"),
        ({"b": 1, "a": 2}, "82 a161 02 a162 01"),
        ({"a": 1.0}, "81 a161 01"),
        ({"a": -0.0}, "81 a161 00"),
        ({"a": -3.0}, "81 a161 fd"),
        ({"a": 0.5}, "81 a161 cb3fe0000000000000"),
        ({"a": 2.0**31}, "81 a161 cb41e0000000000000"),
        ({"a": 2.0**31 - 1}, "81 a161 ce7fffffff"),
        ({"a": 128, "b": 70000}, "82 a161 cc80 a162 ce00011170"),
        ({"a": (1, [True, None])}, "81 a161 92 01 92 c3 c0"),
        ({"a": b"xy", "b": "xy"}, "82 a161 c4027879 a162 a27879"),
        ({"é": 0, "z": 0}, "82 a17a 00 a2c3a9 00"),
    ],
)
def test_canonical_bytes(values: dict[str, Any], expected: str) -> None:
    assert pack_map(values) == bytes.fromhex(expected)


@pytest.mark.parametrize(
    "value",
    [math.nan, math.inf, 1 << 64, -(1 << 63) - 1, {1: 2}, {1, 2}, datetime.datetime(2020, 1, 1), "\ud800", [[[[1]]]]],
    ids=repr,
)
def test_values_that_cannot_be_stored(value: object) -> None:
    with pytest.raises(ValueError, match=r"."):
        pack_map({"a": value})


def test_depth_limit_counts_the_header() -> None:
    assert unpack_map(pack_map({"a": [[[1]]]})) == {"a": [[[1]]]}
    with pytest.raises(ValueError, match="nested deeper than 4"):
        pack_map({"a": [[[[]]]]})


def test_size_limits() -> None:
    with pytest.raises(LimitExceeded, match="a header of 5004 bytes is longer than 4096"):
        pack_map({"": "x" * 4999})
    with pytest.raises(LimitExceeded, match="a header of 4097 bytes is longer than the 4096"):
        unpack_map(bytes(4097))
    with pytest.raises(ValueError, match="of type list cannot stand in a header"):
        pack_map({"a": [0] * 257})


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x80\x80",
        b"\x81\xa1a",
        b"\xc0",
        b"\x90",
        bytes.fromhex("82 a162 01 a161 02"),
        bytes.fromhex("82 a161 01 a161 01"),
        bytes.fromhex("81 a161 cc01"),
        bytes.fromhex("81 a161 d3 0000000000000001"),
        bytes.fromhex("81 a161 ca 3f000000"),
        bytes.fromhex("81 a161 cb 3ff0000000000000"),
        bytes.fromhex("81 a161 cb 8000000000000000"),
        bytes.fromhex("81 a161 cb 7ff8000000000000"),
        bytes.fromhex("81 a161 d9 01 61"),
        bytes.fromhex("de 0001 a161 01"),
        bytes.fromhex("81 c40161 01"),
        bytes.fromhex("81 01 01"),
        bytes.fromhex("81 a161 d6ff 00000000"),
        bytes.fromhex("81 a161 d401 00"),
        bytes.fromhex("81 a161 a1 ff"),
        bytes.fromhex("81 a161 dd ffffffff"),
        bytes.fromhex("81 a161 9191919191 00"),
        bytes.fromhex("81 a161") + b"\x91" * 4000,
        bytes.fromhex("df ffffffff"),
        bytes.fromhex("81 90 00"),
        b"\xc1",
    ],
    ids=lambda data: data[:12].hex(),
)
def test_whatever_is_not_canonical_is_refused(data: bytes) -> None:
    with pytest.raises(CorruptStream, match=r"^a header (cannot be read|of \d+ bytes is not)"):
        unpack_map(data)


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0, "00"), (127, "7f"), (128, "8001"), (300, "ac02"), (2**32 - 1, "ffffffff0f"), (2**64 - 1, "ff" * 9 + "01")],
)
def test_varints(value: int, expected: str) -> None:
    assert pack_varint(value) == bytes.fromhex(expected)
    reader = ByteReader(bytes.fromhex(expected) + b"rest")
    assert reader.varint() == value
    assert reader.take(4) == b"rest"
    assert reader.remaining == 0


@pytest.mark.parametrize("value", [-1, 1 << 64])
def test_varint_range(value: int) -> None:
    with pytest.raises(ValueError, match=rf"{value} is not within 0\.\.2\^64-1"):
        pack_varint(value)


@pytest.mark.parametrize("data", ["8000", "80", "ff" * 9 + "02", "80" * 10 + "01", "ff" * 20, ""])
def test_bad_varints(data: str) -> None:
    with pytest.raises(CorruptStream, match="payload"):
        ByteReader(bytes.fromhex(data)).varint()


def test_signed_varints() -> None:
    values = [0, -1, 1, -2, 2, -(1 << 63), (1 << 63) - 1]
    data = b"".join(map(pack_signed_varint, values))
    assert data[:5] == bytes(range(5))
    reader = ByteReader(data)
    assert [reader.signed_varint() for _ in values] == values
    assert reader.remaining == 0


def test_a_reader_takes_no_more_than_there_is() -> None:
    reader = ByteReader(b"abc")
    assert reader.take(2) == b"ab"
    with pytest.raises(CorruptStream, match="2 bytes are wanted at byte 2 of a payload of 3"):
        reader.take(2)
    assert reader.remaining == 1
