# SPDX-License-Identifier: MIT
"""Runs of gray pictures as AV1 video, whose decoding is exact everywhere.

A payload holds the frames alone: where each one is shown follows from its first bits, and what an AVIF file says
around them from their number and size. No size but that of the run can stand in it.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from functools import cache
from io import BytesIO
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, features

from threedvc.coding.picture import avif_file, can_decode_pictures
from threedvc.errors import CorruptStream, LimitExceeded, UnsupportedVersion
from threedvc.limits import MAX_SEQUENCE_SAMPLES
from threedvc.stream.wire import ByteReader, pack_varint

__all__ = ["can_decode_sequences", "can_encode_sequences", "decode_sequence", "encode_sequence"]

QUICK_SPEED, THOROUGH_SPEED = 3, 1
"""Of the AV1 encoder: the latter takes four times as long for about 7 % fewer bytes."""
LEAST_SQUARES = {
    "tune": "psnr",
    "arnr-strength": "0",
    "enable-overlay": "0",
    "tune-content": "screen",
    "deltaq-mode": "0",
}
"""What the encoder is to go for: no smoothing over time, none for looks. 2 to 9 % fewer bytes for the same error."""
SEQUENCE_HEADER, FRAME, FRAME_HEADER = 0x0A, 0x32, 0x1A
"""First bytes of the units of AV1 data: the kind, and that the size follows."""
SHOWS_EARLIER, SHOWN = 0x80, 0x10
"""Bits of a frame's first byte. What only shows an earlier frame is a frame header without a frame."""
CONFIG_BYTES = 4
"""Content of the box av1C."""
MAX_SIDE = (1 << 16) - 1
"""Of an AV1 picture, whose sequence header has up to 16 bits for a side less 1."""
BRANDS = b"avis" + bytes(4) + b"avismsf1miaf"
"""Kinds of file that readers look for: animated AVIF of one item or track."""
MATRIX = struct.pack(">9I", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
"""The transform that changes nothing, as ISO/IEC 14496-12 has it."""
UNDETERMINED = 0x55C4 << 16
"""The language."""
FULL_RANGE = b"nclx" + struct.pack(">HHHB", 2, 2, 2, 0x80)
"""Colors of no particular kind, in full range."""


@cache
def can_encode_sequences() -> bool:
    """Tell whether this build of Pillow can write AVIF as it is needed here."""
    if not (features.check("avif") and can_decode_sequences()):
        return False
    try:
        encode_sequence(np.zeros((2, 16, 16), dtype=np.uint8), 50, thorough=False)
    except (UnsupportedVersion, ValueError, OSError):
        return False
    return True


def can_decode_sequences() -> bool:
    """Tell whether this build of OpenCV or of Pillow can read animated AVIF."""
    return can_decode_pictures() or bool(features.check("avif"))


def encode_sequence(planes: NDArray[np.uint8], quality: int, *, thorough: bool = True) -> bytes:
    """Return the payload of a run of pictures.

    Parameters
    ----------
    planes
        (n, h, w) uint8 with n of at least 1.
    quality
        1 to 100, as AVIF encoders take it.
    thorough
        Whether to take four times as long for about 7 % fewer bytes.

    Raises
    ------
    ValueError
        If there is no picture, or its sides are not within 1..65535.
    LimitExceeded
        If there are more than `MAX_SEQUENCE_SAMPLES`.
    UnsupportedVersion
        If what this build of Pillow writes cannot be put into a payload.
    """
    count, height, width = planes.shape
    if not _is_possible(count, width, height):
        raise ValueError(f"{count} pictures of {width}x{height} pixels cannot be coded")
    _check_limit(count, width, height)
    planes = np.repeat(planes, 2, axis=0) if count == 1 else planes  # of one a file would hold a still picture
    data = avif_file(planes, quality, THOROUGH_SPEED if thorough else QUICK_SPEED, LEAST_SQUARES)
    return _checked(data, len(planes), width, height)


def decode_sequence(payload: bytes, count: int, width: int, height: int) -> NDArray[np.uint8]:
    """Return the pictures (count, height, width) uint8 of a payload.

    Raises
    ------
    CorruptStream
        If the payload does not hold so many pictures of this size.
    LimitExceeded
        If there are more than `MAX_SEQUENCE_SAMPLES`.
    UnsupportedVersion
        If neither OpenCV nor Pillow can decode them.
    """
    if not _is_possible(count, width, height):
        raise CorruptStream(f"{count} pictures of {width}x{height} pixels are impossible; the stream is damaged")
    _check_limit(count, width, height)
    return _pictures(payload, max(count, 2), width, height)[:count]


def _checked(data: bytes, count: int, width: int, height: int) -> bytes:
    """Return the payload of an animation; whether that can be put back is tried."""
    with suppress(CorruptStream, ValueError):
        payload = _stripped(data)
        if np.array_equal(_pictures(payload, count, width, height), _decoded(data, count, width, height)):
            return payload
    raise UnsupportedVersion("this build of Pillow writes AVIF of an unusual make; install pillow 11.3 or newer")


def _is_possible(count: int, width: int, height: int) -> bool:
    return count >= 1 and 1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE


def _check_limit(count: int, width: int, height: int) -> None:
    if count * width * height > MAX_SEQUENCE_SAMPLES:
        raise LimitExceeded(
            f"{count} pictures of {width}x{height} pixels are more than the {MAX_SEQUENCE_SAMPLES} samples accepted"
        )


def _pictures(payload: bytes, count: int, width: int, height: int) -> NDArray[np.uint8]:
    return _decoded(_completed(payload, count, width, height), count, width, height)


def _stripped(data: bytes) -> bytes:
    """Leave out of an animation all that `_completed` can do without."""
    config = data.index(b"av1C") + 4
    reader = ByteReader(data[data.index(b"mdat") + 4 :])
    headers, frames = [], []
    while reader.remaining:
        kind = reader.take(1)[0]
        unit = reader.take(reader.varint())
        if kind == SEQUENCE_HEADER:
            headers.append(unit)
        elif kind in (FRAME, FRAME_HEADER):
            frames.append(unit)
    units = (pack_varint(len(unit) - 1) + unit for unit in [*headers[:1], *frames])
    return data[config : config + CONFIG_BYTES] + b"".join(units)


def _completed(payload: bytes, count: int, width: int, height: int) -> bytes:
    config, (header, *frames) = payload[:CONFIG_BYTES], _bodies(payload[CONFIG_BYTES:])
    if _size(header) != (width, height):
        raise CorruptStream(f"a run of pictures is not of {width}x{height} pixels as it must be; the stream is damaged")
    samples, units = [], [_unit(SEQUENCE_HEADER, header)]
    for frame in frames:
        units.append(_unit(FRAME_HEADER if frame[0] & SHOWS_EARLIER else FRAME, frame))
        if frame[0] & (SHOWS_EARLIER | SHOWN):
            samples.append(b"".join(units))
            units = []
    if len(samples) != count or units:
        raise CorruptStream(f"a run of {len(samples)} pictures should be one of {count}; the stream is damaged")
    return _animation(config, samples, width, height)


def _bodies(data: bytes) -> list[bytes]:
    """Return what units hold, without their sizes before them: at least one, and none empty."""
    reader = ByteReader(data)
    bodies: list[bytes] = []
    try:
        while reader.remaining or not bodies:
            bodies.append(reader.take(reader.varint() + 1))
    except CorruptStream as error:
        raise CorruptStream(f"a run of pictures is incomplete: {error}; the stream is damaged") from None
    return bodies


def _unit(kind: int, body: bytes) -> bytes:
    return bytes([kind]) + pack_varint(len(body)) + body


def _size(header: bytes) -> tuple[int, int]:
    """Return width and height in a sequence header of AV1 (sec. 5.5.1 of its specification), or zeros.

    Of profile, still picture, timing, delays and operating points all 24 bits must be 0. Then follow the level, above
    7 with a bit for the tier, the lengths of both sides in bits less 1, and both sides less 1.
    """
    if any(header[:3]):
        return 0, 0
    bits = "".join(f"{byte:08b}" for byte in header[3:16].ljust(13, b"\0"))
    at = 5 + (int(bits[:5], 2) > 7)
    across, down = 1 + int(bits[at : at + 4], 2), 1 + int(bits[at + 4 : at + 8], 2)
    middle = at + 8 + across
    return 1 + int(bits[at + 8 : middle], 2), 1 + int(bits[middle : middle + down], 2)


def _box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I4s", 8 + len(body), kind) + body


def _table(kind: bytes, *numbers: int) -> bytes:
    """Return a box of 32-bit numbers, first of them version and flags."""
    return _box(kind, struct.pack(f">{len(numbers)}I", *numbers))


def _animation(config: bytes, samples: list[bytes], width: int, height: int) -> bytes:
    """Return the AVIF file of AV1 data, one sample per picture, with what ISO/IEC 14496-12 asks for and no more."""
    brands, sizes = _box(b"ftyp", BRANDS), [len(sample) for sample in samples]
    # OpenCV knows such a file only by what comes before the data; how long that is does not depend on where data begin.
    offset = len(brands) + len(_movie(config, sizes, width, height, 0)) + 8
    return brands + _movie(config, sizes, width, height, offset) + _box(b"mdat", *samples)


def _movie(config: bytes, sizes: list[int], width: int, height: int, offset: int) -> bytes:
    count = len(sizes)
    entry = _box(
        b"av01",
        struct.pack(">6xH16xHHII4xH32xHh", 1, width, height, 72 << 16, 72 << 16, 1, 24, -1),
        _box(b"av1C", config),
        _box(b"colr", FULL_RANGE),
        _table(b"ccst", 0, 0x7C << 24),
    )
    tables = _box(
        b"stbl",
        _box(b"stsd", struct.pack(">II", 0, 1), entry),
        _table(b"stts", 0, 1, count, 1),
        _table(b"stsc", 0, 1, 1, count, 1),
        _table(b"stsz", 0, 0, count, *sizes),
        _table(b"stco", 0, 1, offset),
        _table(b"stss", 0, 1, 1),
    )
    references = _box(b"dref", struct.pack(">II", 0, 1), _table(b"url ", 1))
    media = _box(
        b"mdia",
        _table(b"mdhd", 0, 0, 0, 1, count, UNDETERMINED),
        _box(b"hdlr", struct.pack(">8x4s13x", b"pict")),
        _box(b"minf", _table(b"vmhd", 1, 0, 0), _box(b"dinf", references), tables),
    )
    shape = struct.pack(">II", width << 16, height << 16)
    track = _box(b"trak", _box(b"tkhd", struct.pack(">6I16x", 1, 0, 0, 1, 0, count), MATRIX, shape), media)
    head = _box(b"mvhd", struct.pack(">6IH10x", 0, 0, 0, 1, count, 1 << 16, 1 << 8), MATRIX, struct.pack(">24xI", 2))
    return _box(b"moov", head, track)


def _decoded(data: bytes, count: int, width: int, height: int) -> NDArray[np.uint8]:
    if not can_decode_sequences():
        raise UnsupportedVersion(
            "these builds of OpenCV and Pillow cannot read AVIF; install opencv-python-headless 5 or newer"
        )
    frames = _by_opencv(data, count) if can_decode_pictures() else _by_pillow(data, count)
    planes = [frame if frame.ndim == 2 else frame[..., 0] for frame in frames]
    if [plane.shape for plane in planes] != [(height, width)] * count or any(p.dtype != np.uint8 for p in planes):
        raise CorruptStream(f"{count} pictures of {width}x{height} pixels cannot be decoded; the stream is damaged")
    return np.stack(planes)


def _by_opencv(data: bytes, count: int) -> list[NDArray[Any]]:
    # One frame more than there should be, so that it is noticed. OpenCV 4.12 wants a buffer of one row.
    buffer = np.frombuffer(data, dtype=np.uint8)[None]
    try:
        _, frames = cv2.imdecodemulti(buffer, cv2.IMREAD_UNCHANGED, range=(0, count + 1))
    except cv2.error:
        return []
    return [np.asarray(frame) for frame in frames]


def _by_pillow(data: bytes, count: int) -> list[NDArray[Any]]:
    frames: list[NDArray[Any]] = []
    try:
        with Image.open(BytesIO(data), formats=["AVIF"]) as file:
            if getattr(file, "n_frames", 1) != count:
                return []
            for index in range(count):
                file.seek(index)
                frames.append(np.array(file.convert("L")))
    except (OSError, ValueError, SyntaxError, EOFError, RuntimeError, ArithmeticError):
        return []
    return frames
