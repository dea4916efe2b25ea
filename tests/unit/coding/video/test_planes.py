# SPDX-License-Identifier: MIT
"""Pictures to samples of a video, and back."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.video import shown_picture
from threedvc.coding.video.planes import (
    MAX_MAGNIFIED,
    Planes,
    VideoFormat,
    picture_of,
    planes_of,
    spare_magnification,
)

RNG = np.random.default_rng(5)


def smooth(width: int, height: int) -> NDArray[np.uint8]:
    y, x = np.mgrid[:height, :width]
    waves = [110 + 60 * np.sin(x / 9 + k) + 40 * np.cos(y / (7 + k)) for k in range(3)]
    return np.rint(np.stack(waves, axis=-1)).astype(np.uint8)


def rough(video: VideoFormat) -> Planes:
    top = 1 << video.bits
    shapes = ((video.height, video.width), video.chroma_shape, video.chroma_shape)
    return Planes(*(RNG.integers(0, top, shape).astype(np.uint16) for shape in shapes))


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("shown", [(1, 1), (5, 3), (17, 10), (20, 31)])
@pytest.mark.parametrize("coded", [(17, 10), (8, 9), (1, 1)])
def test_pictures_are_those_of_the_reference(coded: tuple[int, int], shown: tuple[int, int], bits: int) -> None:
    for magnified, full in ((0, False), (3, False), (1, True)):
        video = VideoFormat(width=coded[0], height=coded[1], bits=bits, magnified=magnified, full_chroma=full)
        planes = rough(video)
        wanted = shown_picture(planes, shown, bits, magnified, full_chroma=full)
        for threads in (1, 3):
            np.testing.assert_array_equal(picture_of(planes, video, *shown, threads), wanted)


@pytest.mark.parametrize("size", [(64, 48), (37, 23), (1, 1), (2, 5)])
@pytest.mark.parametrize("bits", [8, 10])
def test_pictures_come_back(size: tuple[int, int], bits: int) -> None:
    wanted = smooth(*size)
    for magnified in range(spare_magnification(wanted) + 1):
        video = VideoFormat(width=size[0], height=size[1], bits=bits, magnified=magnified)
        got = picture_of(planes_of(wanted, video), video, *size, 1)
        assert np.abs(got.astype(int) - wanted).max() <= 6
        assert np.abs(got.astype(int) - wanted).mean() < 2


@pytest.mark.parametrize("size", [(16, 12), (5, 3), (1, 1)])
def test_full_chroma_loses_no_more_than_rounding(size: tuple[int, int]) -> None:
    wanted = RNG.integers(0, 256, (size[1], size[0], 3)).astype(np.uint8)
    video = VideoFormat(width=size[0], height=size[1], bits=10, full_chroma=True)
    planes = planes_of(wanted, video)
    assert {plane.shape for plane in planes} == {video.chroma_shape} == {(size[1], size[0])}
    got = picture_of(planes, video, *size, 1)
    assert np.abs(got.astype(int) - wanted).max() <= 1


def test_gray_pictures_come_back_exactly() -> None:
    wanted = np.repeat(RNG.integers(0, 256, (9, 12, 1)), 3, axis=2).astype(np.uint8)
    for gray in (False, True):
        video = VideoFormat(width=12, height=9, bits=8, magnified=2, gray=gray)
        np.testing.assert_array_equal(picture_of(planes_of(wanted, video), video, 12, 9, 1), wanted)


def test_chroma_of_a_gray_video_means_nothing() -> None:
    video = VideoFormat(width=9, height=7, bits=10, gray=True)
    picture = picture_of(rough(video), video, 9, 7, 1)
    np.testing.assert_array_equal(picture, np.repeat(picture[..., :1], 3, axis=2))


@pytest.mark.parametrize("color", [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 0, 255), (255, 255, 255), (90, 70, 60)])
def test_no_magnification_clips(color: tuple[int, int, int]) -> None:
    picture = np.full((8, 8, 3), color, np.uint8)
    magnified = spare_magnification(picture)
    assert magnified == (MAX_MAGNIFIED if len(set(color)) == 1 or max(color) < 255 else 0)
    video = VideoFormat(width=8, height=8, bits=10, magnified=magnified)
    got = picture_of(planes_of(picture, video), video, 8, 8, 1)
    assert np.abs(got.astype(int) - picture).max() <= 1


def test_smaller_videos_are_magnified() -> None:
    wanted = smooth(64, 48)
    video = VideoFormat(width=32, height=24, bits=10)
    got = picture_of(planes_of(wanted, video), video, 64, 48, 1)
    assert np.abs(got.astype(int) - wanted).mean() < 2
