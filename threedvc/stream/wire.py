# SPDX-License-Identifier: MIT
"""Bytes of small things: canonical msgpack maps and variable-length integers.

A map has exactly one encoding: keys sorted, the shortest form of every number and length, no
extension types. A reader can therefore refuse whatever differs, and equal streams are equal bytes.
"""

from __future__ import annotations

import math
from typing import Any

import msgpack

from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.limits import MAX_HEADER_BYTES, MAX_HEADER_DEPTH, MAX_HEADER_ITEMS

__all__ = [
    "DIGEST_BYTES",
    "MAX_VARINT_BYTES",
    "ByteReader",
    "pack_map",
    "pack_signed_varint",
    "pack_varint",
    "unpack_map",
]

DIGEST_BYTES = 16
"""Bytes of a digest of decoded state, the first of SHA-256: damage is found, forgery is not what it is for."""
MAX_VARINT_BYTES = 10
"""Groups of 7 bits that 64 bits take."""
INTEGRAL_FLOAT_BOUND = 2.0**31
"""Integers below it take at most 5 bytes of msgpack, a float64 takes 9."""


def pack_map(values: dict[str, Any]) -> bytes:
    """Return the canonical msgpack bytes of a header map.

    Floats with an integral value below 2^31 in magnitude are written as integers (1 to 5 bytes),
    all others as float64 (9 bytes).

    Parameters
    ----------
    values
        String keys; values are None, bool, int of 64 bits, finite float, str, bytes, and lists
        and maps of these.

    Raises
    ------
    ValueError
        If a value cannot be stored.
    LimitExceeded
        If the map takes more than `MAX_HEADER_BYTES`.
    """
    data = _pack(values)
    if len(data) > MAX_HEADER_BYTES:
        raise LimitExceeded(f"a header of {len(data)} bytes is longer than {MAX_HEADER_BYTES}; shorten its texts")
    return data


def unpack_map(data: bytes) -> dict[str, Any]:
    """Read a header map; inverse of `pack_map`, save that integral floats come back as integers.

    Raises
    ------
    LimitExceeded
        If there are more than `MAX_HEADER_BYTES`.
    CorruptStream
        If the bytes are not the canonical encoding of a map.
    """
    if len(data) > MAX_HEADER_BYTES:
        raise LimitExceeded(
            f"a header of {len(data)} bytes is longer than the {MAX_HEADER_BYTES} that a reader accepts"
        )
    try:
        values = msgpack.unpackb(data, max_array_len=MAX_HEADER_ITEMS, max_map_len=MAX_HEADER_ITEMS)
        if isinstance(values, dict) and _pack(values) == data:
            return values
    except (ValueError, msgpack.UnpackException) as error:
        raise CorruptStream(f"a header cannot be read: {error}") from None
    raise CorruptStream(f"a header of {len(data)} bytes is not a canonical msgpack map")


def _pack(values: dict[str, Any]) -> bytes:
    try:
        data: bytes = msgpack.packb(_canonical(values, 1), use_bin_type=True)
    except OverflowError:
        raise ValueError(f"header {values!r:.200} holds an integer of more than 64 bits") from None
    return data


def _canonical(value: Any, depth: int) -> Any:
    if value is None or isinstance(value, bool | int | str | bytes):
        return value
    if isinstance(value, float):
        return _canonical_float(value)
    if depth > MAX_HEADER_DEPTH:
        raise ValueError(f"maps and lists are nested deeper than {MAX_HEADER_DEPTH}")
    if isinstance(value, list | tuple) and len(value) <= MAX_HEADER_ITEMS:
        return [_canonical(item, depth + 1) for item in value]
    if isinstance(value, dict) and len(value) <= MAX_HEADER_ITEMS and all(isinstance(name, str) for name in value):
        return {name: _canonical(value[name], depth + 1) for name in sorted(value)}
    raise ValueError(f"{value!r:.100} of type {type(value).__name__} cannot stand in a header")


def _canonical_float(value: float) -> float | int:
    if not math.isfinite(value):
        raise ValueError(f"the number {value} is not finite")
    if value.is_integer() and abs(value) < INTEGRAL_FLOAT_BOUND:
        return int(value)
    return value


def pack_varint(value: int) -> bytes:
    """Return an integer of 0..2^64-1 in groups of 7 bits, lowest first; the top bit says that more follow."""
    if not 0 <= value < 1 << 64:
        raise ValueError(f"{value} is not within 0..2^64-1")
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def pack_signed_varint(value: int) -> bytes:
    """Return a signed integer as a varint: 0, -1, 1, -2, ... become 0, 1, 2, 3, ..."""
    return pack_varint(value * 2 if value >= 0 else -value * 2 - 1)


class ByteReader:
    """Reads a payload from its beginning; whatever asks for more than is there raises CorruptStream."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.position = 0

    @property
    def remaining(self) -> int:
        """Number of bytes not yet read."""
        return len(self._data) - self.position

    def take(self, size: int) -> bytes:
        """Return the next `size` bytes."""
        if size > self.remaining:
            raise CorruptStream(f"{size} bytes are wanted at byte {self.position} of a payload of {len(self._data)}")
        self.position += size
        return self._data[self.position - size : self.position]

    def varint(self) -> int:
        """Return the next variable-length integer; only its shortest form is accepted."""
        value = 0
        for place in range(MAX_VARINT_BYTES):
            byte = self.take(1)[0]
            value |= (byte & 0x7F) << (7 * place)
            if byte < 0x80:
                if (byte == 0 and place > 0) or value >= 1 << 64:
                    break
                return value
        raise CorruptStream(f"no valid variable-length integer stands before byte {self.position} of a payload")

    def signed_varint(self) -> int:
        """Return the next integer written by `pack_signed_varint`."""
        value = self.varint()
        return value >> 1 if not value & 1 else -(value + 1 >> 1)
