# SPDX-License-Identifier: MIT
"""Runs of pictures without loss, whole and damaged."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from threedvc.coding.video import ffv1
from threedvc.coding.video.ffv1 import can_encode_ffv1, decode_ffv1, encode_ffv1
from threedvc.coding.video.planes import ExactColor, Picture, VideoFormat
from threedvc.errors import CorruptStream, UnsupportedVersion
from threedvc.stream.wire import ByteReader, pack_varint

pytestmark = pytest.mark.skipif(not can_encode_ffv1(), reason="this build of PyAV has no FFV1")

SIZE = VideoFormat(width=70, height=50, bits=8)
LARGE = VideoFormat(width=400, height=300, bits=8)
COUNT = 5


def noisy(video: VideoFormat, count: int) -> list[Picture]:
    rng = np.random.default_rng(5)
    y, x = np.mgrid[: video.height, : video.width]
    smooth = np.stack([x + y, 2 * x, 255 - y], axis=-1)
    pictures = [(smooth + 3 * k + rng.integers(0, 9, smooth.shape)).astype(np.uint8) for k in range(count)]
    return [picture[..., :1].repeat(3, axis=-1) for picture in pictures] if video.gray else pictures


def encoded(video: VideoFormat, count: int = COUNT, threads: int = 1) -> bytes:
    return encode_ffv1(noisy(video, count), video, threads)


def decoded(payload: bytes, count: int = COUNT, video: VideoFormat = SIZE) -> list[Picture]:
    return list(decode_ffv1(payload, count, video))


def parts_of(payload: bytes) -> list[bytes]:
    reader, parts = ByteReader(payload), []
    while reader.remaining:
        parts.append(reader.take(reader.varint() + 1))
    return parts


def joined(parts: list[bytes]) -> bytes:
    return b"".join(pack_varint(len(part) - 1) + part for part in parts)


@pytest.fixture(scope="module")
def payload() -> bytes:
    return encoded(SIZE)


@pytest.mark.parametrize("gray", [False, True])
@pytest.mark.parametrize(
    ("width", "height", "count"),
    [(1, 1, 1), (3, 2, 2), (37, 23, 5), (70, 50, 40), (352, 288, 2), (353, 2, 2), (640, 480, 3), (1100, 1000, 1)],
)
def test_pictures_come_back_exactly(width: int, height: int, count: int, gray: bool) -> None:
    video = VideoFormat(width=width, height=height, bits=8, gray=gray)
    got = decoded(encoded(video, count), count, video)
    np.testing.assert_array_equal(got, noisy(video, count))
    assert all(picture.dtype == np.uint8 and picture.flags.writeable for picture in got)


@pytest.mark.parametrize("gray", [False, True])
def test_any_levels_come_back(gray: bool) -> None:
    video = VideoFormat(width=64, height=48, bits=8, gray=gray)
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 256, (48, 64, 1 if gray else 3), dtype=np.uint8) for _ in range(3)]
    pictures = [picture.repeat(3, axis=-1) if gray else 255 * (picture > 127) for picture in pictures]
    pictures = [picture.astype(np.uint8) for picture in [*pictures, 0 * pictures[0], 0 * pictures[0] + 255]]
    got = decoded(encode_ffv1(pictures, video, 1), len(pictures), video)
    np.testing.assert_array_equal(got, pictures)


@pytest.mark.parametrize("video", [SIZE, LARGE, replace(LARGE, gray=True)])
def test_payloads_and_pictures_do_not_depend_on_threads(video: VideoFormat, monkeypatch: pytest.MonkeyPatch) -> None:
    payload = encoded(video)
    assert encoded(video, threads=3) == encoded(video, threads=16) == payload
    for threads in (1, 3, 16):
        monkeypatch.setattr(ffv1, "default_threads", lambda threads=threads: threads)
        np.testing.assert_array_equal(decoded(payload, COUNT, video), noisy(video, COUNT))


def test_pictures_are_compressed() -> None:
    color, gray = (len(encoded(video, 20)) for video in (LARGE, replace(LARGE, gray=True)))
    assert color < 0.6 * 20 * 3 * 400 * 300  # of 24 bits a pixel 3 * log2(9) = 9.5 are noise
    assert gray < 0.4 * color


def test_pictures_of_another_make_are_not_written() -> None:
    with pytest.raises(ValueError, match="should be one of 70x50"):
        encode_ffv1(noisy(LARGE, 1), SIZE, 1)
    with pytest.raises(ValueError, match="should be one of 70x50"):
        encode_ffv1([picture.astype(np.uint16) for picture in noisy(SIZE, 1)], SIZE, 1)  # type: ignore[misc]
    with pytest.raises(UnsupportedVersion, match="cannot write pictures of 1x400"):
        encoded(VideoFormat(width=1, height=400, bits=8))


def test_truncated_payloads_are_refused(payload: bytes) -> None:
    for size in range(0, len(payload), 97):
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            decode_ffv1(payload[:size], COUNT, SIZE)
    with pytest.raises(CorruptStream, match="1 bytes follow"):
        decode_ffv1(payload + b"\0", COUNT, SIZE)


@pytest.mark.parametrize("count", [0, 1, COUNT - 1, COUNT + 1, 1 << 20])
def test_another_number_of_pictures_is_refused(payload: bytes, count: int) -> None:
    with pytest.raises(CorruptStream, match=f"a video of {count} pictures"):
        decode_ffv1(payload, count, SIZE)


def test_every_damaged_byte_is_found(payload: bytes) -> None:
    record = len(parts_of(payload)[0])
    rng = np.random.default_rng(3)
    for at in [*range(record), *rng.integers(0, len(payload), 200)]:
        damaged = bytearray(payload)
        damaged[at] ^= rng.integers(1, 256)
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            decoded(bytes(damaged))


def test_sizes_of_slices_that_lie_are_refused() -> None:
    record, picture = parts_of(encoded(LARGE, 1))
    assert ffv1._checked_slices(0, picture) == 4
    for size in (0, 1, len(picture) - 7, 0xFFFFFF):
        lying = picture[:-8] + size.to_bytes(3, "big") + picture[-5:]
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            decode_ffv1(joined([record, lying]), 1, LARGE)
    for short in (b"\0", bytes(7), bytes(8), bytes(800)):
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            decoded(joined([record, short]), 1, LARGE)


def test_pictures_of_too_many_slices_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    few = parts_of(encoded(LARGE, 1))
    monkeypatch.setattr(ffv1, "_slice_count", lambda video: 400)
    many = parts_of(encoded(LARGE, 1))
    with pytest.raises(CorruptStream, match="not of 1 to 16 slices"):
        decode_ffv1(joined(many), 1, LARGE)
    # Of few slices that the record says there are many, a decoder makes a picture or none.
    for record, picture in ((many[0], few[1]), (parts_of(encoded(SIZE, 1))[0], few[1])):
        with suppress(CorruptStream):
            assert len(decoded(joined([record, picture]), 1, LARGE)) == 1


def test_missing_and_exchanged_pictures_do_no_worse_than_spoil_others(payload: bytes) -> None:
    record, *pictures = parts_of(payload)
    with pytest.raises(CorruptStream, match="picture 0 of a video cannot be decoded"):
        decoded(joined([record, *pictures[1:]]), COUNT - 1)
    assert len(decoded(joined([record, pictures[0], *pictures[:0:-1]]))) == COUNT
    assert len(decoded(joined([record, *pictures[:2], *pictures[3:]]), COUNT - 1)) == COUNT - 1


def test_another_layout_is_refused(payload: bytes) -> None:
    gray = replace(SIZE, gray=True)
    with pytest.raises(CorruptStream, match=r"\(bgr0\) instead of 70x50 \(gray\)"):
        decoded(payload, COUNT, gray)
    with pytest.raises(CorruptStream, match=r"\(gray\) instead of 70x50 \(bgr0\)"):
        decoded(encoded(gray))


@pytest.mark.parametrize(("width", "height"), [(71, 50), (50, 70), (1, 1), (640, 480), (4096, 4096)])
def test_another_size_spoils_pictures_or_is_refused(payload: bytes, width: int, height: int) -> None:
    other = VideoFormat(width=width, height=height, bits=8)
    with suppress(CorruptStream):
        assert {picture.shape for picture in decoded(payload, COUNT, other)} == {(height, width, 3)}


def test_nothing_is_said_on_the_way(payload: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    decoded(encoded(SIZE))
    record, *pictures = parts_of(payload)
    for hostile in ([bytes(20), *pictures], [record, pictures[1]], [record[:-1], pictures[0]]):
        with pytest.raises(CorruptStream):
            decoded(joined(hostile), len(hostile) - 1)
    assert capfd.readouterr() == ("", "")


def test_builds_without_ffv1_say_so(payload: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ffv1, "can_decode_ffv1", lambda: False)
    with pytest.raises(UnsupportedVersion, match="install av"):
        decode_ffv1(payload, COUNT, SIZE)
    monkeypatch.setattr(ffv1, "can_encode_ffv1", lambda: False)
    with pytest.raises(UnsupportedVersion, match="install av"):
        encoded(SIZE)


def test_exact_colors_are_shown_as_they_are_and_interpolated_elsewhere() -> None:
    (picture,) = noisy(SIZE, 1)
    color = ExactColor(picture=picture)
    np.testing.assert_array_equal(color.shown(70, 50, 2), picture)
    flat = ExactColor(picture=np.full((50, 70, 3), (9, 120, 255), dtype=np.uint8))
    np.testing.assert_array_equal(flat.shown(33, 101, 2), np.full((101, 33, 3), (9, 120, 255)))
    larger = color.shown(140, 100, 2)
    assert np.abs(larger[::2, ::2].astype(int) - picture).mean() < 6
    np.testing.assert_array_equal(larger, color.shown(140, 100, 1))
