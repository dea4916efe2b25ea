# SPDX-License-Identifier: MIT
"""AV1 as a rival: pictures go through it, coarser settings are smaller, a missing package is named."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import av1
from av1 import MissingCodec, VideoCodec
from planes import InverseDepth
from threedvc.metrics.picture_quality import psnr

WIDTH, HEIGHT, FRAMES = 96, 70, 4


@pytest.fixture
def codec() -> VideoCodec:
    """Return a codec; skip where there is none."""
    try:
        av1.library()
    except MissingCodec as error:
        pytest.skip(str(error))
    return VideoCodec(width=WIDTH, height=HEIGHT, fps=29.97, crf=30, preset=10)


def scaled(codec: VideoCodec, scale: int) -> VideoCodec:
    return VideoCodec(width=WIDTH, height=HEIGHT, fps=29.97, crf=codec.crf, scale=scale, preset=codec.preset)


def pictures() -> list[np.ndarray]:
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    return [
        np.stack(
            [128 + 80 * np.sin((columns + 2 * k) / 11), 128 + 60 * np.cos(rows / 9), 40 + columns], axis=-1
        ).astype(np.uint8)
        for k in range(FRAMES)
    ]


class TestColor:
    @pytest.mark.parametrize("scale", [1, 2, 4])
    def test_pictures_come_back(self, codec: VideoCodec, scale: int) -> None:
        chosen = scaled(codec, scale)
        seen = list(chosen.decode_color(chosen.encode_color(pictures())))
        assert [picture.shape for picture in seen] == [(HEIGHT, WIDTH, 3)] * FRAMES
        assert min(psnr(a, b) for a, b in zip(pictures(), seen, strict=True)) > 28

    def test_smaller_pictures_take_fewer_bytes(self, codec: VideoCodec) -> None:
        sizes = [scaled(codec, scale).encode_color(pictures()).size for scale in (1, 2, 4)]
        assert sizes == sorted(sizes, reverse=True)

    def test_gray_stays_gray(self, codec: VideoCodec) -> None:
        gray = [np.repeat(picture[..., :1], 3, axis=2) for picture in pictures()]
        coded = codec.encode_color(gray, gray=True)
        assert coded.size < codec.encode_color(pictures()).size
        for given, seen in zip(gray, codec.decode_color(coded, gray=True), strict=True):
            assert np.ptp(seen.astype(int), axis=2).max() == 0
            assert psnr(given, seen) > 30

    def test_one_key_frame_and_no_container(self, codec: VideoCodec) -> None:
        coded = codec.encode_color(pictures())
        assert [packet.is_keyframe for packet in coded.packets] == [True] + [False] * (FRAMES - 1)
        assert coded.size == sum(packet.size for packet in coded.packets) - 2 * FRAMES


class TestDepth:
    def test_depth_comes_back_and_has_no_holes(self, codec: VideoCodec) -> None:
        columns = np.arange(WIDTH, dtype=np.float32)
        depth = [np.tile(1 + columns / 50 + k / 100, (HEIGHT, 1)).astype(np.float32) for k in range(FRAMES)]
        given = [picture.copy() for picture in depth]
        for picture in given:
            picture[20:30, 40:60] = 0
        mapping = InverseDepth.covering(1.0, 3.0)
        seen = list(codec.decode_depth(codec.encode_depth(given, mapping), mapping))
        errors = [np.abs(b - a)[a > 0] for a, b in zip(given, seen, strict=True)]
        assert np.median(np.concatenate(errors)) < 0.01
        assert min(picture.min() for picture in seen) > 0.9


def test_sizes_are_even() -> None:
    codec = VideoCodec(width=101, height=51, fps=30, crf=30, scale=4)
    assert codec.size == (26, 12)


def test_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingCodec, match=r"AV1 needs PyAV; install the extra \[bench\]"):
        av1.library()
