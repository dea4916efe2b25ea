# SPDX-License-Identifier: MIT
"""Backdrops: AVIF pictures of one gray plane."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.coding import picture as picture_coding
from threedvc.coding.picture import can_encode_pictures, decode_picture, encode_picture
from threedvc.errors import CorruptStream, UnsupportedVersion

pytestmark = pytest.mark.skipif(not can_encode_pictures(), reason="these builds of OpenCV and Pillow have no AVIF")


def scene(width: int, height: int) -> NDArray[np.uint8]:
    y, x = np.mgrid[:height, :width]
    channels = [120 + 80 * np.sin(x / 9), 110 + 60 * np.cos(y / 7), 90 + 50 * np.sin((x + y) / 11)]
    return np.stack(channels, axis=-1).astype(np.uint8)


@pytest.mark.parametrize("size", [(64, 48), (63, 48), (64, 47), (33, 31), (1, 1), (2, 5)])
@pytest.mark.parametrize("gray", [False, True])
def test_any_size_comes_back(size: tuple[int, int], gray: bool) -> None:
    wanted = scene(*size)
    if gray:
        wanted = np.repeat(wanted[..., :1], 3, axis=2)
    payload = encode_picture(wanted, 90, gray)
    got = decode_picture(payload, *size, gray)
    assert got.shape == wanted.shape
    assert got.dtype == np.uint8
    assert np.abs(got.astype(int) - wanted).mean() < 6


def test_chroma_is_magnified_as_far_as_it_is_not_clipped() -> None:
    dull, vivid = scene(64, 48) // 2 + 60, scene(64, 48)
    vivid[:8, :8], vivid[:8, 8:16] = (255, 0, 0), (0, 0, 255)
    for wanted, magnified in ((dull, 3), (vivid, 0)):
        payload = encode_picture(wanted, 95, False)
        assert payload[0] >> 1 == magnified
        assert np.abs(decode_picture(payload, 64, 48, False).astype(int) - wanted).mean() < 4


def test_better_quality_is_nearer_and_larger() -> None:
    wanted = scene(160, 120)
    payloads = [encode_picture(wanted, quality, False) for quality in (10, 40, 80)]
    errors = [np.square(decode_picture(p, 160, 120, False).astype(float) - wanted).mean() for p in payloads]
    assert sorted(map(len, payloads)) == list(map(len, payloads))
    assert errors[0] > errors[1] > errors[2]


def test_the_usual_frame_of_the_file_is_left_out() -> None:
    wanted = scene(100, 80)
    payload = encode_picture(wanted, 40, False)
    make, magnified = payload[0] & 1, payload[0] & ~1
    assert make == picture_coding.STRIPPED
    whole = picture_coding._completed(bytes([make]) + payload[1:], 100, 120)
    assert len(payload) < len(whole) - 260
    other = bytes([picture_coding.WHOLE | magnified]) + whole
    np.testing.assert_array_equal(decode_picture(other, 100, 80, False), decode_picture(payload, 100, 80, False))


def test_a_file_of_another_make_is_kept_whole() -> None:
    planes = picture_coding._planes(scene(100, 80), False)
    odd = cv2.imencode(".avif", np.repeat(planes[..., None], 3, axis=2))[1].tobytes()
    assert picture_coding._stripped(odd, 100, 120) == bytes([picture_coding.WHOLE]) + odd


def test_bytes_go_where_they_save_squared_error() -> None:
    rng = np.random.default_rng(1)
    wanted = scene(160, 120)
    for _ in range(40):
        corners = rng.integers(0, (160, 120), (3, 2), dtype=np.int32)
        cv2.fillPoly(wanted, [corners], rng.integers(0, 255, 3).tolist())
    planes = picture_coding._planes(wanted, False)
    whole = cv2.imencode(".avif", planes, [cv2.IMWRITE_AVIF_QUALITY, 30, cv2.IMWRITE_AVIF_SPEED, 3])[1].tobytes()
    usual = bytes([picture_coding.WHOLE]) + whole
    # From about as many bytes downwards: the first that takes no more.
    payloads = (encode_picture(wanted, quality, False, thorough=False) for quality in range(28, 4, -4))
    ours = next(payload for payload in payloads if len(payload) < len(usual) - 260)
    errors = [np.square(decode_picture(p, 160, 120, False).astype(float) - wanted).mean() for p in (ours, usual)]
    assert errors[0] < errors[1]


@pytest.mark.parametrize(
    "payload", [b"", b"\x07abc", b"\x08abc", b"\x00", b"\x00no picture", b"\x01", b"\x01\x81\x00\x1c\x00rubbish"]
)
def test_rubbish_is_refused(payload: bytes) -> None:
    with pytest.raises(CorruptStream):
        decode_picture(payload, 32, 32, False)


def test_another_size_is_refused() -> None:
    whole = b"\x00" + cv2.imencode(".avif", np.zeros((24, 20), np.uint8))[1].tobytes()
    with pytest.raises(CorruptStream, match="16x16"):
        decode_picture(whole, 16, 16, True)


def test_a_picture_that_lies_about_its_size_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = b"\x00" + cv2.imencode(".avif", np.zeros((24, 20), np.uint8))[1].tobytes()

    def never(*_: object) -> None:
        raise AssertionError("a picture of the wrong size was decoded")

    monkeypatch.setattr(cv2, "imdecode", never)
    with pytest.raises(CorruptStream, match="16x16 samples"):
        decode_picture(whole, 16, 16, True)


def test_a_build_without_avif_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    payload = encode_picture(scene(16, 16), 40, False)
    monkeypatch.setattr(picture_coding, "can_decode_pictures", lambda: False)
    with pytest.raises(UnsupportedVersion, match="opencv-python-headless"):
        decode_picture(payload, 16, 16, False)
