# SPDX-License-Identifier: MIT
"""A payload as parts, each after its size less 1."""

from __future__ import annotations

from collections.abc import Iterable

from threedvc.errors import CorruptStream
from threedvc.stream.wire import ByteReader, pack_varint

__all__ = ["pack_parts", "unpack_parts"]


def pack_parts(parts: Iterable[bytes]) -> bytes:
    """Return the payload of some parts, none of which is empty."""
    return b"".join(pack_varint(len(part) - 1) + part for part in parts)


def unpack_parts(payload: bytes, count: int, pictures: int) -> list[bytes]:
    """Return so many parts of the payload of a video of so many pictures.

    Raises
    ------
    CorruptStream
        If it does not hold just these.
    """
    reader = ByteReader(payload)
    try:
        parts = [reader.take(reader.varint() + 1) for _ in range(count)]
    except CorruptStream as error:
        raise CorruptStream(f"a video of {pictures} pictures is incomplete: {error}; the stream is damaged") from None
    if reader.remaining:
        raise CorruptStream(f"{reader.remaining} bytes follow a video of {pictures} pictures; the stream is damaged")
    return parts
