# SPDX-License-Identifier: MIT
"""Single pictures as AV1."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.coding.video import av1
from threedvc.coding.video.av1 import can_encode_av1
from threedvc.coding.video.planes import VideoFormat
from threedvc.coding.video.still import STILL_BITS, CodedStill, decode_still, encode_still
from threedvc.errors import CorruptStream, UnsupportedVersion

pytestmark = [
    pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1"),
    pytest.mark.usefixtures("quick_av1"),
]


def scene(width: int, height: int) -> NDArray[np.uint8]:
    y, x = np.mgrid[:height, :width]
    channels = [120 + 80 * np.sin(x / 9), 110 + 60 * np.cos(y / 7), 90 + 50 * np.sin((x + y) / 11)]
    return np.stack(channels, axis=-1).astype(np.uint8)


def decoded(coded: CodedStill, width: int, height: int, gray: bool = False) -> NDArray[np.uint8]:
    video = VideoFormat(width=width, height=height, bits=STILL_BITS, magnified=coded.magnified, gray=gray)
    return decode_still(coded.payload, video)


@pytest.fixture(scope="module")
def coded(quick_av1: None) -> CodedStill:
    return encode_still(scene(63, 47), 30, False)


@pytest.mark.parametrize("size", [(64, 48), (63, 48), (64, 47), (33, 31), (1, 1), (2, 5)])
@pytest.mark.parametrize("gray", [False, True])
def test_any_size_comes_back(size: tuple[int, int], gray: bool) -> None:
    wanted = scene(*size)
    if gray:
        wanted = np.repeat(wanted[..., :1], 3, axis=2)
    got = decoded(encode_still(wanted, 15, gray), *size, gray)
    assert got.shape == wanted.shape
    assert got.dtype == np.uint8
    assert np.abs(got.astype(int) - wanted).mean() < 6


def test_finer_is_nearer_and_larger() -> None:
    wanted = scene(160, 120)
    stills = [encode_still(wanted, crf, False) for crf in (60, 40, 20)]
    errors = [np.square(decoded(each, 160, 120).astype(float) - wanted).mean() for each in stills]
    sizes = [len(each.payload) for each in stills]
    assert sizes == sorted(sizes)
    assert errors[0] > errors[1] > errors[2]


def test_chroma_is_magnified_as_far_as_it_is_not_clipped() -> None:
    dull, vivid = scene(64, 48) // 2 + 60, scene(64, 48)
    vivid[:8, :8], vivid[:8, 8:16] = (255, 0, 0), (0, 0, 255)
    assert encode_still(dull, 20, False).magnified == 2
    assert encode_still(vivid, 20, False).magnified == 0


def test_truncated_payloads_are_refused(coded: CodedStill) -> None:
    for size in range(0, len(coded.payload), 5):
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            decoded(coded._replace(payload=coded.payload[:size]), 63, 47)


def test_no_damage_does_worse_than_spoil_the_picture(coded: CodedStill, rng: np.random.Generator) -> None:
    refused = 0
    for _ in range(150):
        damaged = bytearray(coded.payload)
        for at in rng.integers(0, len(damaged), rng.integers(1, 4)):
            damaged[at] = rng.integers(256)
        try:
            assert decoded(coded._replace(payload=bytes(damaged)), 63, 47).shape == (47, 63, 3)
        except CorruptStream:
            refused += 1
    assert refused > 10


@pytest.mark.parametrize(("width", "height", "bits"), [(65, 47, 10), (63, 50, 10), (63, 47, 8), (63, 47, 16)])
def test_another_format_is_refused(coded: CodedStill, width: int, height: int, bits: int) -> None:
    with pytest.raises(CorruptStream, match="a video of 64x48 samples of 10 bits should have"):
        decode_still(coded.payload, VideoFormat(width=width, height=height, bits=bits))


def test_builds_without_av1_say_so(coded: CodedStill, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(av1, "_decoder_name", lambda: None)
    with pytest.raises(UnsupportedVersion, match="install av"):
        decoded(coded, 63, 47)
