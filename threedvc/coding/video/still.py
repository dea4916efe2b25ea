# SPDX-License-Identifier: MIT
"""Single pictures as AV1: a run of one, of the samples that color videos have."""

from __future__ import annotations

from typing import NamedTuple

from threedvc.coding.video.av1 import Av1Settings, decode_av1, encode_av1
from threedvc.coding.video.planes import Picture, VideoFormat, picture_of, planes_of, spare_magnification

__all__ = ["STILL_BITS", "CodedStill", "decode_still", "encode_still"]

STILL_BITS = 10
"""Of a sample, as in color videos."""
QUICK_PRESET, THOROUGH_PRESET = 4, 0
"""Work of the encoder: the latter takes some twenty times as long for 10 to 15 % fewer bytes (decision 0009)."""
THREADS = 1
"""A single picture leaves little to divide."""


class CodedStill(NamedTuple):
    """A picture as it is sent.

    Attributes
    ----------
    payload
        The coded samples, of `STILL_BITS` each.
    magnified
        Chroma is 1 + magnified/4 times as large as its formula says.
    """

    payload: bytes
    magnified: int


def encode_still(picture: Picture, crf: float, gray: bool, *, thorough: bool = True) -> CodedStill:
    """Code a picture (h, w, 3) uint8 RGB.

    Parameters
    ----------
    picture
        The picture.
    crf
        Quantization from 1 to 70 in quarters, the finest first.
    gray
        Whether to code the luma alone.
    thorough
        Whether to take some twenty times as long for 10 to 15 % fewer bytes.

    Raises
    ------
    UnsupportedVersion
        If this build of PyAV cannot write it.
    """
    height, width, _ = picture.shape
    magnified = 0 if gray else spare_magnification(picture)
    video = VideoFormat(width=width, height=height, bits=STILL_BITS, magnified=magnified, gray=gray)
    settings = Av1Settings(crf=crf, preset=THOROUGH_PRESET if thorough else QUICK_PRESET, threads=THREADS)
    return CodedStill(encode_av1([planes_of(picture, video)], video, settings), magnified)


def decode_still(payload: bytes, video: VideoFormat) -> Picture:
    """Return the picture (height, width, 3) uint8 RGB of a payload.

    Raises
    ------
    CorruptStream
        If the payload is no such picture.
    UnsupportedVersion
        If this build of PyAV cannot decode it.
    """
    (planes,) = decode_av1(payload, 1, video)
    return picture_of(planes, video, video.width, video.height, THREADS)
