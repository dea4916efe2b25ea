# SPDX-License-Identifier: MIT
"""Gray pictures of eight bits as earlier writers coded them: parts of AVIF files, which are AV1 inside.

A BACKDROP holds one, of luma with chroma below it, a VIDEO a run of depth pictures. They are read and not written any
more; what they decode to must not change (docs/coding.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.video.av1 import decode_pictures
from threedvc.coding.video.av1_units import (
    SequenceFormat,
    read_sequence_header,
    read_still_header,
    still_header_of,
    unpack_units,
)
from threedvc.coding.video.planes import Picture, Samples
from threedvc.errors import CorruptStream

__all__ = ["EARLIER_BITS", "decode_earlier_run", "decode_earlier_still"]

EARLIER_BITS = 8
"""Of a sample."""
STRIPPED = 1
"""Lowest bit of a picture's first byte if not an AVIF file follows, or its AV1 data alone after four bytes."""
MAX_MAGNIFIED = 3
"""Chroma is magnified by 1 + m/4 with m up to this."""
CONFIG_BYTES = 4
"""Content of the box av1C, which stands before AV1 data and tells nothing that these do not."""
BOX_HEAD = Struct(">I4s")
"""Size and kind of a box of an AVIF file (ISO/IEC 14496-12)."""
MIN_RUN = 2
"""A single picture of a run stands in it twice."""


def decode_earlier_run(payload: bytes, count: int, width: int, height: int) -> Iterator[Samples]:
    """Check the payload of a VIDEO, and return an iterator that decodes its pictures (height, width) uint16 in turn.

    Raises
    ------
    CorruptStream
        If the payload does not hold so many pictures of this size; while iterating, if one cannot be decoded.
    UnsupportedVersion
        If this build of PyAV cannot read AV1.
    """
    held = max(count, MIN_RUN)
    header, pictures = unpack_units(payload[CONFIG_BYTES:], held)
    if len(pictures) != held:
        raise CorruptStream(f"a run of {len(pictures)} pictures should be one of {held}; the stream is damaged")
    found = _checked(read_sequence_header(header), width, height)
    return (planes[0] for _, planes in zip(range(count), decode_pictures(pictures, found), strict=False))


def decode_earlier_still(payload: bytes, width: int, height: int, gray: bool) -> Picture:
    """Return the picture (height, width, 3) uint8 RGB of the payload of a BACKDROP.

    Raises
    ------
    CorruptStream
        If the payload is no such picture.
    UnsupportedVersion
        If this build of PyAV cannot read AV1.
    """
    if not payload or payload[0] >> 1 > MAX_MAGNIFIED:
        raise CorruptStream("a picture is of an unknown make; the stream is damaged")
    data = payload[1 + CONFIG_BYTES :] if payload[0] & 1 == STRIPPED else _content(payload[1:])
    rows = height if gray else height + -(-height // 2)
    columns = width if gray else 2 * -(-width // 2)
    found = _checked(read_still_header(still_header_of(data)), columns, rows)
    ((plane,),) = decode_pictures([data], found)
    return _picture(plane, width, height, gray, payload[0] >> 1)


def _checked(found: SequenceFormat, width: int, height: int) -> SequenceFormat:
    expected = SequenceFormat(width, height, EARLIER_BITS, True, False)
    if found != expected:
        raise CorruptStream(
            f"pictures of {found.width}x{found.height} samples of {found.bits} bits{'' if found.gray else ' in color'}"
            f"{' and noise' * found.grain} should have {width}x{height} gray ones of 8 bits; the stream is damaged"
        )
    return found


def _content(file: bytes) -> bytes:
    """Return the AV1 data of an AVIF file of one picture: the content of its box mdat, where nothing else is.

    No number in the file but the sizes of its outermost boxes is followed.
    """
    place = 0
    while place + BOX_HEAD.size <= len(file):
        size, kind = BOX_HEAD.unpack_from(file, place)
        if kind == b"mdat" and place + size == len(file):
            return file[place + BOX_HEAD.size :]
        place += max(size, BOX_HEAD.size)
    raise CorruptStream("a picture is no AVIF file of one picture; the stream is damaged")


def _picture(plane: Samples, width: int, height: int, gray: bool, magnified: int) -> Picture:
    values = plane.astype(np.int32)
    luma = values[:height, :width]
    if gray:
        return np.repeat(luma[..., None], 3, axis=2).astype(np.uint8)
    half = values.shape[1] // 2
    doubled = (_doubled(values[height:, k * half : (k + 1) * half] - 128)[:height, :width] for k in (0, 1))
    co, cg = ((8 * each + 4 + magnified) // (2 * (4 + magnified)) for each in doubled)
    # Co is half of R - B, Cg a quarter of 2 G - R - B; Y - Cg is (R + B) / 2.
    rest = luma - cg
    return np.clip(np.stack([rest + co, luma + cg, rest - co], axis=-1), 0, 255).astype(np.uint8)


def _doubled(plane: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return a plane of twice the size, interpolated with weights 3/4 and 1/4."""
    for axis in (0, 1):
        before = np.concatenate([plane.take([0], axis), plane.take(range(plane.shape[axis] - 1), axis)], axis)
        after = np.concatenate([plane.take(range(1, plane.shape[axis]), axis), plane.take([-1], axis)], axis)
        pairs = np.stack([(3 * plane + before + 2) >> 2, (3 * plane + after + 2) >> 2], axis + 1)
        shape = list(plane.shape)
        shape[axis] *= 2
        plane = pairs.reshape(shape)
    return plane
