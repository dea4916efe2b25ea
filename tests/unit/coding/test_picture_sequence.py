# SPDX-License-Identifier: MIT
"""Runs of gray pictures, predicted from each other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.coding import picture_sequence as coding
from threedvc.coding.picture import avif_file, can_encode_pictures
from threedvc.coding.picture_sequence import decode_sequence, encode_sequence
from threedvc.errors import CorruptStream, LimitExceeded, UnsupportedVersion
from threedvc.limits import MAX_SEQUENCE_SAMPLES
from threedvc.stream.wire import ByteReader

pytestmark = pytest.mark.skipif(not can_encode_pictures(), reason="these builds of OpenCV and Pillow have no AVIF")

SIZE = (37, 23)


def waves(count: int, width: int, height: int) -> NDArray[np.uint8]:
    k, y, x = np.mgrid[:count, :height, :width]
    return np.rint(110 + 50 * np.sin(x / 9 + k / 7) + 40 * np.cos(y / 7 - k / 15)).astype(np.uint8)


def animation(planes: NDArray[np.uint8], quality: int = 60) -> bytes:
    return avif_file(planes, quality, 6, coding.LEAST_SQUARES)


def error(got: NDArray[np.uint8], wanted: NDArray[np.uint8]) -> float:
    return float(np.square(got.astype(float) - wanted).mean())


@pytest.fixture(scope="module")
def payload() -> bytes:
    return encode_sequence(waves(9, *SIZE), 60, thorough=False)


@pytest.fixture(params=["opencv", "pillow"])
def decoder(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(coding, "can_decode_pictures", lambda: request.param == "opencv")
    return str(request.param)


@pytest.mark.parametrize("size", [SIZE, (64, 48), (1, 1), (2, 5), (150, 1)])
@pytest.mark.parametrize("count", [1, 2, 70])
def test_any_number_and_size_come_back(count: int, size: tuple[int, int], decoder: str) -> None:
    wanted = waves(count, *size)
    payload = encode_sequence(wanted, 80, thorough=False)
    got = decode_sequence(payload, count, *size)
    assert got.shape == wanted.shape
    assert got.dtype == np.uint8
    assert got.flags.c_contiguous
    assert got.flags.writeable
    assert error(got, wanted) < 4


@pytest.mark.parametrize("count", [1, 2, 30])
def test_both_decoders_agree(count: int) -> None:
    rough = np.random.default_rng(2).integers(0, 256, (count, *SIZE[::-1])).astype(np.uint8)
    for data in (animation(waves(count, *SIZE)), animation(rough, 20), animation(rough, 100)):
        one, other = coding._by_opencv(data, count), coding._by_pillow(data, count)
        np.testing.assert_array_equal([np.squeeze(frame) for frame in one], other)


def test_the_best_quality_loses_nothing(decoder: str) -> None:
    wanted = np.arange(4 * 256).astype(np.uint8).reshape(4, 16, 16)
    wanted[1] = wanted[0, ::-1]
    np.testing.assert_array_equal(decode_sequence(encode_sequence(wanted, 100), 4, 16, 16), wanted)


def test_equal_pictures_and_cuts_keep_their_place(decoder: str) -> None:
    wanted = np.full((40, 48, 64), 60, np.uint8)
    wanted[20:] = np.random.default_rng(0).integers(100, 256, (48, 64))
    got = decode_sequence(encode_sequence(wanted, 80, thorough=False), 40, 64, 48)
    assert error(got, wanted) < 10


def test_views_of_arrays_are_coded_as_they_look() -> None:
    wanted = waves(6, 74, 46)[::2, ::2, ::-2]
    assert encode_sequence(wanted, 60) == encode_sequence(np.ascontiguousarray(wanted), 60)


def test_prediction_and_stripping_save_bytes() -> None:
    wanted = waves(70, 64, 48)
    payload = encode_sequence(wanted, 60, thorough=False)
    whole = avif_file(wanted, 60, coding.QUICK_SPEED, coding.LEAST_SQUARES)
    assert len(payload) < len(whole) - 1300
    assert len(payload) < sum(len(encode_sequence(plane[None], 60, thorough=False)) for plane in wanted) / 2
    np.testing.assert_array_equal(coding._decoded(whole, 70, 64, 48), decode_sequence(payload, 70, 64, 48))


def test_better_quality_is_nearer_and_larger() -> None:
    wanted = waves(20, 64, 48)
    payloads = [encode_sequence(wanted, quality, thorough=False) for quality in (10, 40, 80)]
    errors = [error(decode_sequence(p, 20, 64, 48), wanted) for p in payloads]
    assert sorted(map(len, payloads)) == list(map(len, payloads))
    assert errors[0] > errors[1] > errors[2]


STRIPPED_AS_USUAL = coding._stripped


def without_a_frame(data: bytes) -> bytes:
    return STRIPPED_AS_USUAL(data)[:-4]


def with_another_picture(data: bytes) -> bytes:
    del data
    return STRIPPED_AS_USUAL(animation(255 - waves(3, *SIZE)))


def of_another_make(data: bytes) -> bytes:
    return STRIPPED_AS_USUAL(data.replace(b"av1C", b"none"))


@pytest.mark.parametrize("strip", [without_a_frame, with_another_picture, of_another_make])
def test_what_cannot_be_put_back_is_not_written(
    strip: Callable[[bytes], bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(coding, "_stripped", strip)
    with pytest.raises(UnsupportedVersion, match="install pillow"):
        encode_sequence(waves(3, *SIZE), 60)


@pytest.mark.parametrize("count", [1, 9])
def test_truncated_payloads_are_refused(count: int, decoder: str) -> None:
    payload = encode_sequence(waves(count, *SIZE), 60, thorough=False)
    for size in range(0, len(payload), 7 if count > 1 else 1):
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            decode_sequence(payload[:size], count, *SIZE)


def test_no_damage_does_worse_than_spoil_pictures(payload: bytes, decoder: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        damaged = bytearray(payload)
        for at in rng.integers(0, len(payload), rng.integers(1, 4)):
            damaged[at] = rng.integers(256)
        try:
            got = decode_sequence(bytes(damaged), 9, *SIZE)
        except CorruptStream:
            continue
        assert got.shape == (9, *SIZE[::-1])
        assert got.dtype == np.uint8


@pytest.mark.parametrize("count", [1, 9])
def test_rubbish_is_refused(count: int) -> None:
    rng = np.random.default_rng(4)
    for size in (0, 1, 2, 30, 3000):
        for first in (b"", b"\0", b"\x81\x00\x1c\x00\x0d\x00\x00\x00"):
            with pytest.raises(CorruptStream):
                decode_sequence(first + rng.bytes(size), count, *SIZE)


@pytest.mark.parametrize(("count", "size"), [(8, SIZE), (10, SIZE), (9, (37, 24)), (9, (36, 23)), (1, SIZE)])
def test_another_number_or_size_is_refused(
    payload: bytes, count: int, size: tuple[int, int], decoder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(coding, "_decoded", lambda *_: pytest.fail("what cannot be right was decoded"))
    with pytest.raises(CorruptStream, match="the stream is damaged"):
        decode_sequence(payload, count, *size)


@pytest.mark.parametrize(("count", "size"), [(0, SIZE), (-1, SIZE), (3, (0, 5)), (3, (5, -1)), (2, (1 << 16, 1))])
def test_impossible_numbers_are_refused(count: int, size: tuple[int, int]) -> None:
    with pytest.raises(CorruptStream, match="impossible"):
        decode_sequence(b"", count, *size)
    if count >= 0 and min(size) >= 0:
        with pytest.raises(ValueError, match="cannot be coded"):
            encode_sequence(np.zeros((count, *size[::-1]), np.uint8), 50)


def test_too_much_is_refused() -> None:
    side = 1 << 11
    count = MAX_SEQUENCE_SAMPLES // side**2 + 1
    with pytest.raises(LimitExceeded, match="samples accepted"):
        decode_sequence(b"", count, side, side)
    with pytest.raises(LimitExceeded, match="samples accepted"):
        encode_sequence(np.broadcast_to(np.uint8(0), (count, side, side)), 50)


@pytest.mark.parametrize("size", [(1, 1), (2, 1), (300, 200), (640, 480), (1920, 1080), (4096, 3), (65535, 65535)])
def test_sizes_are_read_from_sequence_headers(size: tuple[int, int]) -> None:
    width, height = size
    if width * height <= 640 * 480:
        reader = ByteReader(encode_sequence(np.zeros((2, height, width), np.uint8), 50, thorough=False)[4:])
        assert coding._size(reader.take(reader.varint() + 1)) == size
    for level in ("00101", "010000", "111110"):
        sides = [f"{side - 1:b}" for side in size]
        bits = "0" * 24 + level + "".join(f"{len(side) - 1:04b}" for side in sides) + "".join(sides)
        assert coding._size(int(bits.ljust(128, "1"), 2).to_bytes(16, "big")) == size


def test_a_last_frame_that_is_not_shown_is_refused(payload: bytes) -> None:
    with pytest.raises(CorruptStream, match="should be one of 9"):
        decode_sequence(payload + b"\x02\x00ab", 9, *SIZE)
    with pytest.raises(CorruptStream, match="a run of 10 pictures should be one of 9"):
        decode_sequence(payload + b"\x00\x10", 9, *SIZE)


def test_builds_without_avif_say_so(payload: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coding, "can_decode_pictures", lambda: False)
    monkeypatch.setattr(coding.features, "check", lambda _: False)
    assert not coding.can_decode_sequences()
    with pytest.raises(UnsupportedVersion, match="opencv-python-headless"):
        decode_sequence(payload, 9, *SIZE)
