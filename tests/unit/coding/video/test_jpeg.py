# SPDX-License-Identifier: MIT
"""Runs of JPEG files, whole and damaged."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from threedvc.coding.video.jpeg import (
    MAX_SCANS,
    JpegFile,
    decode_jpeg_files,
    decoded_rgb,
    encode_jpeg_files,
    parse_jpeg,
)
from threedvc.coding.video.planes import Picture, VideoFormat
from threedvc.errors import CorruptStream
from threedvc.stream.wire import pack_varint

SIZE = VideoFormat(width=70, height=50, bits=8)
GRAY = replace(SIZE, gray=True)
COUNT = 3
EXIF = b"\xff\xe1\x00\x22Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
"""A segment that says that the picture is to be turned by a right angle."""


def jpeg(number: int = 0, *, width: int = 70, height: int = 50, gray: bool = False, progressive: bool = False) -> bytes:
    y, x = np.mgrid[:height, :width]
    picture = np.stack([3 * x + 9 * number, 2 * y + x, 255 - y - x], axis=-1).clip(0, 255).astype(np.uint8)
    choices = [cv2.IMWRITE_JPEG_QUALITY, 80, cv2.IMWRITE_JPEG_PROGRESSIVE, int(progressive)]
    return bytes(cv2.imencode(".jpg", picture[..., 0] if gray else picture, choices)[1])


def pixels(data: bytes) -> Picture:
    found = decoded_rgb(data)
    assert found is not None
    return found


def encoded(files: list[bytes], video: VideoFormat = SIZE) -> bytes | None:
    return encode_jpeg_files([(data, pixels(data)) for data in files], video)


def joined(files: list[bytes]) -> bytes:
    return b"".join(pack_varint(len(data) - 1) + data for data in files)


FILES = [jpeg(number, progressive=number == 1) for number in range(COUNT)]


@pytest.mark.parametrize(("gray", "video"), [(False, SIZE), (True, SIZE), (True, GRAY)])
def test_files_are_kept_and_give_the_same_pixels(gray: bool, video: VideoFormat) -> None:
    files = [jpeg(number, gray=gray, progressive=number == 1) for number in range(COUNT)]
    payload = encoded(files, video)
    assert payload == joined(files)
    np.testing.assert_array_equal(list(decode_jpeg_files(payload, COUNT, video)), [pixels(data) for data in files])


def test_what_files_say_beside_the_pixels_is_kept_and_not_followed() -> None:
    turned = FILES[0][:2] + EXIF + FILES[0][2:] + b"what follows the end"
    assert encoded([turned]) == joined([turned])
    np.testing.assert_array_equal(next(decode_jpeg_files(joined([turned]), 1, SIZE)), pixels(FILES[0]))


def test_what_is_not_all_jpeg_is_not_kept() -> None:
    png = bytes(cv2.imencode(".png", pixels(FILES[0]))[1])
    assert encode_jpeg_files([(FILES[0], pixels(FILES[0])), (None, pixels(FILES[1]))], SIZE) is None
    assert encoded([png]) is None
    assert encoded([jpeg(width=71)]) is None
    assert encoded([FILES[0]], GRAY) is None


def test_pictures_that_were_changed_after_decoding_are_not_kept() -> None:
    assert encode_jpeg_files([(FILES[0], pixels(FILES[0])[:, ::-1])], SIZE) is None


def test_files_larger_than_their_pixels_are_not_kept() -> None:
    assert encoded([FILES[0] + bytes(3 * 70 * 50)]) is None


def test_segments_tell_the_picture() -> None:
    assert parse_jpeg(FILES[0]) == JpegFile(frame=0xC0, width=70, height=50, components=3, bits=8, scans=1)
    found = parse_jpeg(jpeg(gray=True, progressive=True))
    assert (found.frame, found.components) == (0xC2, 1)
    assert 1 < found.scans <= MAX_SCANS


@pytest.mark.parametrize("count", [0, 1, COUNT - 1, COUNT + 1, 1 << 20])
def test_another_number_of_pictures_is_refused(count: int) -> None:
    with pytest.raises(CorruptStream, match=f"a video of {count} pictures"):
        decode_jpeg_files(joined(FILES), count, SIZE)


def test_truncated_payloads_are_refused() -> None:
    payload = joined(FILES)
    for size in range(0, len(payload), 7):
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            decode_jpeg_files(payload[:size], COUNT, SIZE)


def at(data: bytes, offset: int, put: bytes) -> bytes:
    """Return a file with bytes of its frame header exchanged."""
    place = data.index(b"\xff\xc0") + offset
    return data[:place] + put + data[place + len(put) :]


def with_scans(data: bytes, count: int) -> bytes:
    """Return a file whose only scan stands there several times."""
    start = data.index(b"\xff\xda")
    return data[:start] + data[start:-2] * count + data[-2:]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"", "incomplete"),
        (lambda data: b"\x89PNG" + data[4:], "no JPEG"),
        (lambda data: data[:-2], "truncated JPEG"),
        (lambda data: data[:20] + b"\0" + data[20:], "damaged JPEG at byte"),
        (lambda data: jpeg(width=50, height=70), "of 50x70 pixels instead of 70x50"),
        (lambda data: at(data, 5, b"\xff\xff\xff\xff"), "of 65535x65535 pixels"),
        (lambda data: at(data, 5, b"\0\0"), "of 70x0 pixels"),
        (lambda data: at(data, 1, b"\xc3"), "frame 0xc3"),
        (lambda data: at(data, 1, b"\xc9"), "frame 0xc9"),
        (lambda data: at(data, 4, b"\x0c"), "channels of 12 bits"),
        (lambda data: at(data, 9, b"\x04"), "4 channels"),
        (lambda data: b"\xff\xd8\xff\xd9", "of 0x0 pixels"),
        (lambda data: b"\xff\xd8" + b"\xff\xfe\0\2" * (1 << 17) + data[2:], "truncated JPEG"),
        (lambda data: with_scans(data, MAX_SCANS + 1), f"of {MAX_SCANS + 1} scans"),
    ],
)
def test_files_that_lie_are_refused_before_they_are_decoded(change: Callable[[bytes], bytes], message: str) -> None:
    data = change(FILES[2])
    payload = joined([*FILES[:2], data]) if data else joined(FILES[:2]) + b"\0"
    tracemalloc.start()
    with pytest.raises(CorruptStream, match=message):
        decode_jpeg_files(payload, COUNT, SIZE)
    assert tracemalloc.get_traced_memory()[1] < 1 << 22
    tracemalloc.stop()


def test_two_frame_headers_do_not_make_a_picture_larger() -> None:
    header = at(FILES[0], 5, b"\x40\0\x40\0")
    second = header[header.index(b"\xff\xc0") :][:19]
    start = FILES[0].index(b"\xff\xda")
    with pytest.raises(CorruptStream, match="picture 0 of a video cannot be decoded"):
        list(decode_jpeg_files(joined([FILES[0][:start] + second + FILES[0][start:]]), 1, SIZE))


def test_no_damage_does_worse_than_spoil_pictures(rng: np.random.Generator) -> None:
    payload = joined(FILES)
    for _ in range(300):
        damaged = bytearray(payload)
        for place in rng.integers(0, len(payload), rng.integers(1, 4)):
            damaged[place] = rng.integers(256)
        try:
            found = list(decode_jpeg_files(bytes(damaged), COUNT, SIZE))
        except CorruptStream:
            continue
        assert [picture.shape for picture in found] == [(50, 70, 3)] * COUNT
