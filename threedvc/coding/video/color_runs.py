# SPDX-License-Identifier: MIT
"""Runs of pictures in color as AV1, with chroma of half the rows and columns of luma or of all of them.

SVT-AV1 writes the former alone, which bounds what any quantization reaches: saturated edges and noise of single pixels
come to 34 to 43 dB. For the latter luma, Co and Cg are three runs, each the luma of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from threedvc.coding.video.av1 import Av1Encoder, Av1Settings, decode_av1, encode_av1
from threedvc.coding.video.parts import pack_parts, unpack_parts
from threedvc.coding.video.planes import Picture, Planes, VideoFormat, gray_planes, picture_of, planes_of
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import VideoCodec

__all__ = ["decode_color", "encode_color", "halving_error", "video_format"]

PLANES = 3
"""Luma, Co and Cg."""


def video_format(header: ColorVideoHeader, *, gray: bool) -> VideoFormat:
    """Return the format of the pictures of a COLOR_VIDEO, in a stream that is gray or not."""
    return VideoFormat(
        width=header.columns,
        height=header.rows,
        bits=header.bits,
        magnified=header.magnified,
        gray=gray,
        full_chroma=header.codec == VideoCodec.AV1_FULL_CHROMA,
    )


def halving_error(picture: Picture, threads: int) -> float:
    """Return the mean squared error of a picture (h, w, 3) of which nothing but chroma's rows and columns is lost."""
    height, width, _ = picture.shape
    video = VideoFormat(width=width, height=height, bits=10)
    shown = picture_of(planes_of(picture, video), video, width, height, threads)
    return float(np.square(shown.astype(np.float32) - picture).mean())


def encode_color(pictures: Iterable[Planes], video: VideoFormat, settings: Av1Settings) -> bytes:
    """Return the payload of a run of pictures; raises as `encode_av1` does."""
    if not video.full_chroma:
        return encode_av1(pictures, video, settings)
    plain = _plane_format(video)
    encoders = [Av1Encoder(plain, settings) for _ in range(PLANES)]
    for planes in pictures:
        for encoder, plane in zip(encoders, planes, strict=True):
            encoder.add(gray_planes(plane, plain))
    return pack_parts(encoder.payload() for encoder in encoders)


def decode_color(payload: bytes, count: int, video: VideoFormat) -> Iterator[Planes]:
    """Check a payload, and return an iterator that decodes its pictures; raises as `decode_av1` does."""
    if not video.full_chroma:
        return decode_av1(payload, count, video)
    plain = _plane_format(video)
    runs = [decode_av1(part, count, plain) for part in unpack_parts(payload, PLANES, count)]
    return (Planes(*(plane.luma for plane in planes)) for planes in zip(*runs, strict=True))


def _plane_format(video: VideoFormat) -> VideoFormat:
    """Return the format of one of the runs."""
    return replace(video, gray=True, full_chroma=False)
