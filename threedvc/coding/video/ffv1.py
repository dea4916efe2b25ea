# SPDX-License-Identifier: MIT
"""Runs of pictures without loss, as FFV1 version 3 (RFC 9043), written and read by PyAV.

A payload holds the configuration record and then every picture, each after its size less 1. How often values occurred
is learned from picture to picture; nothing else goes from one to the next. A payload does not depend on the number of
threads.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from fractions import Fraction
from functools import cache
from typing import Any, Final

import av
import cv2
import numpy as np
from av.error import FFmpegError
from numpy.typing import NDArray

from threedvc.coding.video.parts import pack_parts, unpack_parts
from threedvc.coding.video.planes import Picture, VideoFormat
from threedvc.errors import CorruptStream, UnsupportedVersion
from threedvc.limits import MAX_COUNT
from threedvc.parallel import default_threads

__all__ = ["EXACT_BITS", "can_decode_ffv1", "can_encode_ffv1", "decode_ffv1", "encode_ffv1"]

CODEC: Final = "ffv1"
EXACT_BITS: Final = 8
"""Of a sample: those of pictures as they are read."""
COLOR_FORMAT, GRAY_FORMAT = "bgr0", "gray"
"""Names of the layouts of samples: blue, green, red and a byte without meaning; gray alone."""
SETTINGS: Final = {"level": "3", "coder": "1", "context": "1", "slicecrc": "1", "g": str(MAX_COUNT)}
"""Of the encoder: the range coder, large contexts, checksums of slices, and no key frame but the first. Golomb codes
take 8 to 11 % more bytes in 0.7 of the time, small contexts 1 to 2 % more in 0.8, and these with key frames alone 4 to
5 % more (decision 0030)."""
WHOLE_SIZE: Final = 352, 288
"""Largest width and height of pictures that the encoder leaves in one slice."""
FEW_SLICES, MANY_SLICES = 4, 16
"""Parts of larger pictures, which are decoded at the same time. At 640x480 many cost 1 % (decision 0030)."""
FEW_SLICES_PIXELS: Final = 1 << 20
"""Largest pictures of few slices. Above, many have nearly as many pixels each as few have at 640x480."""
TRAILER_BYTES, SIZE_BYTES = 8, 3
"""Of what ends a slice (RFC 9043, sec. 4.9): its size without that, a byte of status and its checksum."""
NEUTRAL: Final = 0xFFFFFFFF
"""What zlib begins its checksums from and inverts them by."""
MIRRORED: Final = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))
"""Bytes with the order of their bits reversed: FFV1 sums from the highest bit, zlib from the lowest."""


@cache
def can_encode_ffv1() -> bool:
    """Tell whether this build of PyAV can write FFV1, and read it again."""
    return _has_codec("w") and can_decode_ffv1()


@cache
def can_decode_ffv1() -> bool:
    """Tell whether this build of PyAV can read FFV1."""
    return _has_codec("r")


def _has_codec(mode: Any) -> bool:
    try:
        av.Codec(CODEC, mode)
    except (FFmpegError, ValueError):
        return False
    return True


def encode_ffv1(pictures: Iterable[Picture], video: VideoFormat, threads: int) -> bytes:
    """Return the payload of a run of pictures (h, w, 3) uint8, of which only red counts if the video is gray.

    Raises
    ------
    UnsupportedVersion
        If this build of PyAV cannot write it.
    ValueError
        If a picture has another size than the video.
    """
    if not can_encode_ffv1():
        raise UnsupportedVersion("this build of PyAV cannot write FFV1; install av 14 or newer")
    context: Any = av.CodecContext.create(CODEC, "w")
    context.width, context.height = video.width, video.height
    context.pix_fmt = _layout(video)
    context.time_base = Fraction(1)
    context.thread_type, context.thread_count = "SLICE", threads
    context.options = SETTINGS | {"slices": str(_slice_count(video))}
    try:
        context.open()
    except FFmpegError as error:
        raise UnsupportedVersion(
            f"this build of PyAV cannot write pictures of {video.width}x{video.height} as FFV1 ({error.strerror})"
        ) from None
    coded: list[bytes] = []
    for number, picture in enumerate(pictures):
        coded += map(bytes, context.encode(_frame(picture, video, number)))
    coded += map(bytes, context.encode(None))
    return pack_parts([bytes(context.extradata), *coded])


def _layout(video: VideoFormat) -> str:
    return GRAY_FORMAT if video.gray else COLOR_FORMAT


def _slice_count(video: VideoFormat) -> int:
    if video.width <= WHOLE_SIZE[0] and video.height <= WHOLE_SIZE[1]:
        return 1
    return FEW_SLICES if video.width * video.height <= FEW_SLICES_PIXELS else MANY_SLICES


def _frame(picture: Picture, video: VideoFormat, number: int) -> av.VideoFrame:
    if picture.shape != (video.height, video.width, 3) or picture.dtype != np.uint8:
        raise ValueError(
            f"a picture of shape {picture.shape} ({picture.dtype}) should be one of {video.width}x{video.height}"
        )
    frame = av.VideoFrame(video.width, video.height, _layout(video))
    frame.pts = number
    samples = _samples(frame, video)
    samples[:] = picture[..., 0] if video.gray else cv2.cvtColor(picture, cv2.COLOR_RGB2BGRA)
    return frame


def _samples(frame: Any, video: VideoFormat) -> NDArray[np.uint8]:
    """Return the samples of a frame in its own memory, (h, w) of a gray one and else (h, w, 4)."""
    rows = np.frombuffer(frame.planes[0], dtype=np.uint8).reshape(video.height, -1)
    return rows[:, : video.width] if video.gray else rows[:, : 4 * video.width].reshape(video.height, -1, 4)


def decode_ffv1(payload: bytes, count: int, video: VideoFormat) -> Iterator[Picture]:
    """Check a payload, and return an iterator that decodes its pictures (h, w, 3) uint8 one after another.

    Raises
    ------
    CorruptStream
        If the payload does not hold so many pictures, or a slice of one is damaged; while iterating, if one cannot be
        decoded or has another layout.
    UnsupportedVersion
        If this build of PyAV cannot read it.
    """
    record, *pictures = unpack_parts(payload, count + 1, count)
    slices = max((_checked_slices(number, data) for number, data in enumerate(pictures)), default=1)
    if not can_decode_ffv1():
        raise UnsupportedVersion("this build of PyAV cannot read FFV1; install av 14 or newer")
    return _decoded(record, pictures, video, min(slices, default_threads()))


def _checked_slices(number: int, data: bytes) -> int:
    """Return the number of slices of a picture, after a look at their checksums: PyAV does not tell what it thinks.

    Decoders keep memory for each slice that there is, so there must not be many.
    """
    end, count = len(data), 0
    while end:
        trailer = max(end - TRAILER_BYTES, 0)
        size = int.from_bytes(data[trailer : trailer + SIZE_BYTES], "big") + TRAILER_BYTES
        if size > end or count == MANY_SLICES:
            raise CorruptStream(
                f"picture {number} of a video is not of 1 to {MANY_SLICES} slices; the stream is damaged"
            )
        if zlib.crc32(data[end - size : end].translate(MIRRORED), NEUTRAL) != NEUTRAL:
            raise CorruptStream(f"a checksum in picture {number} of a video is wrong; the stream is damaged")
        end, count = end - size, count + 1
    return count


def _decoded(record: bytes, pictures: list[bytes], video: VideoFormat, threads: int) -> Iterator[Picture]:
    context: Any = av.CodecContext.create(CODEC, "r")
    context.width, context.height, context.extradata = video.width, video.height, record
    context.thread_type, context.thread_count = "SLICE", threads
    for number, data in enumerate(pictures):
        try:
            frames = context.decode(av.Packet(data))
        except FFmpegError as error:
            raise CorruptStream(
                f"picture {number} of a video cannot be decoded ({error.strerror}); the stream is damaged"
            ) from None
        if len(frames) != 1:
            raise CorruptStream(f"picture {number} of a video cannot be decoded; the stream is damaged")
        yield _picture(frames[0], video)


def _picture(frame: Any, video: VideoFormat) -> Picture:
    """Return a copy of a decoded picture."""
    if (frame.width, frame.height, frame.format.name) != (video.width, video.height, _layout(video)):
        raise CorruptStream(
            f"a picture of a video has {frame.width}x{frame.height} samples ({frame.format.name}) instead of "
            f"{video.width}x{video.height} ({_layout(video)}); the stream is damaged"
        )
    order = cv2.COLOR_GRAY2RGB if video.gray else cv2.COLOR_BGRA2RGB
    return np.asarray(cv2.cvtColor(_samples(frame, video), order), dtype=np.uint8)
