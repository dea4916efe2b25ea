# SPDX-License-Identifier: MIT
"""Runs of pictures as AV1, written by SVT-AV1 and read by dav1d, or what else PyAV brings.

AV1 decodes to the same samples everywhere; what these mean is told elsewhere. For color the encoder is set to the least
squared error. A payload depends neither on the number of threads nor on what else runs.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any, Final

import av
import numpy as np
from av.error import FFmpegError

from threedvc.coding.video.av1_units import SequenceFormat, pack_units, read_sequence_header, unpack_units
from threedvc.coding.video.planes import Planes, Samples, VideoFormat, flat_chroma
from threedvc.coding.video.scheduling import SchedulingGuard
from threedvc.errors import CorruptStream, UnsupportedVersion

__all__ = [
    "Av1Encoder",
    "Av1Settings",
    "can_decode_av1",
    "can_encode_av1",
    "decode_av1",
    "decode_pictures",
    "encode_av1",
]

ENCODER: Final = "libsvtav1"
DECODERS: Final = ("libdav1d", "libaom-av1")
"""In the order in which they are tried. FFmpeg's own needs hardware."""
DECODER_THREADS: Final = 1
"""A picture of 640x480 takes 2 ms. What further threads say of damage waits for the interpreter's lock, which PyAV
holds while it closes them: that never ends."""
MIN_SIDE: Final = 4
"""Of a picture that the encoder takes; smaller ones are continued."""
LOG_LEVEL: Final = "SVT_LOG", "0"
"""Variable of the environment by which the encoder's own messages are left out: errors are told by PyAV, too."""
PIXEL_FORMATS: Final = {8: "yuv420p", 10: "yuv420p10le"}
"""By bits of a sample."""
GRAY_PIXEL_FORMATS: Final = {8: "gray", 10: "gray10le"}
FRAME_RATE: Final = 30
"""That the encoder is told: without a rate to keep it means nothing."""
SETTINGS: Final = "keyint=-1:tune=1:enable-dlf=2:scm=0:film-grain=0"
"""Of the encoder: one key frame, least squared error, no tools for screens, no noise added by decoders. Smoothing over
time before coding and six levels of prediction are its defaults; without them 19 and 5 % more bytes (decision 0030)."""
DEPTH_SETTINGS: Final = "keyint=-1:tune=2:enable-dlf=2:scm=1:film-grain=0"
"""For depth: for structure more than for the squared error, and with tools for screens (decisions 0019, 0038)."""


@dataclass(frozen=True, kw_only=True)
class Av1Settings:
    """How a run is coded.

    Attributes
    ----------
    crf
        Quantization from 1 to 70 in quarters, the finest first; about six more halve the bytes.
    preset
        Work from 0, the most, to 13.
    threads
        On how many; the payload does not depend on it.
    depth
        Whether the pictures are depth: flat, with sharp edges.
    """

    crf: float
    preset: int
    threads: int
    depth: bool = False


@cache
def can_encode_av1() -> bool:
    """Tell whether this build of PyAV can write AV1, and read it again."""
    return _has_codec(ENCODER, "w") and can_decode_av1()


@cache
def can_decode_av1() -> bool:
    """Tell whether this build of PyAV can read AV1."""
    return _decoder_name() is not None


@cache
def _decoder_name() -> str | None:
    return next((name for name in DECODERS if _has_codec(name, "r")), None)


def _has_codec(name: str, mode: Any) -> bool:
    try:
        av.Codec(name, mode)
    except (FFmpegError, ValueError):
        return False
    return True


def encode_av1(pictures: Iterable[Planes], video: VideoFormat, settings: Av1Settings) -> bytes:
    """Return the payload of a run of pictures.

    Raises
    ------
    UnsupportedVersion
        If this build of PyAV cannot write it.
    """
    encoder = Av1Encoder(video, settings)
    for planes in pictures:
        encoder.add(planes)
    return encoder.payload()


class Av1Encoder:
    """Writes the payload of a run, picture by picture; raises as `encode_av1` does."""

    def __init__(self, video: VideoFormat, settings: Av1Settings) -> None:
        if not can_encode_av1():
            raise UnsupportedVersion("this build of PyAV cannot write AV1; install av 14 or newer with libsvtav1")
        os.environ.setdefault(*LOG_LEVEL)
        guard = SchedulingGuard()
        self._context = _encoder_context(video, settings)
        self._context.open()
        guard.restore()
        self._count = 0
        self._packets: list[bytes] = []

    def add(self, planes: Planes) -> None:
        """Take in the next picture."""
        self._packets += map(bytes, self._context.encode(_frame(planes, self._context, self._count)))
        self._count += 1

    def payload(self) -> bytes:
        """Return the payload; no picture can follow."""
        self._packets += map(bytes, self._context.encode(None))
        try:
            payload = pack_units(self._packets)
            unpack_units(payload)
            return payload
        except (ValueError, CorruptStream) as error:
            raise UnsupportedVersion(f"this build of PyAV writes AV1 of an unusual make: {error}") from None


def _encoder_context(video: VideoFormat, settings: Av1Settings) -> Any:
    context = av.CodecContext.create(ENCODER, "w")
    context.width, context.height = (max(side + side % 2, MIN_SIDE) for side in (video.width, video.height))
    context.pix_fmt = PIXEL_FORMATS[video.bits]
    context.time_base, context.framerate = Fraction(1, FRAME_RATE), Fraction(FRAME_RATE)
    choices = f"{DEPTH_SETTINGS if settings.depth else SETTINGS}:crf={settings.crf:g}:lp={settings.threads}"
    context.options = {"preset": str(settings.preset), "svtav1-params": choices}
    return context


def _frame(planes: Planes, context: Any, number: int) -> av.VideoFrame:
    frame = av.VideoFrame(context.width, context.height, context.pix_fmt)
    frame.pts = number
    for target, samples in zip(frame.planes, planes, strict=True):
        into = _samples(target, 8 if context.pix_fmt == PIXEL_FORMATS[8] else 10)
        short = [(0, size - have) for size, have in zip(into.shape, samples.shape, strict=True)]
        into[:] = np.pad(samples, short, mode="edge")
    return frame


def _samples(plane: Any, bits: int) -> Samples:
    """Return the samples (rows, columns) of a plane, in its own memory."""
    rows = np.frombuffer(plane, dtype="<u2" if bits > 8 else np.uint8).reshape(plane.height, -1)
    return rows[:, : plane.width]


def decode_av1(payload: bytes, count: int, video: VideoFormat) -> Iterator[Planes]:
    """Check a payload, and return an iterator that decodes its pictures one after another.

    Raises
    ------
    CorruptStream
        If the payload does not hold so many pictures of this format; while iterating, if one cannot be decoded.
    UnsupportedVersion
        If this build of PyAV cannot read it.
    """
    header, pictures = unpack_units(payload, count)
    found = read_sequence_header(header)
    if len(pictures) != count:
        raise CorruptStream(f"a video of {len(pictures)} pictures should be one of {count}; the stream is damaged")
    expected = SequenceFormat(_coded(video.width), _coded(video.height), video.bits, found.gray, False)
    if found != expected:
        raise CorruptStream(
            f"a video of {found.width}x{found.height} samples of {found.bits} bits should have {expected.width}x"
            f"{expected.height} of {video.bits} bits{' and no noise added' * found.grain}; the stream is damaged"
        )
    return (_planes(planes, video) for planes in decode_pictures(pictures, found))


def _coded(side: int) -> int:
    """Return the side of a coded picture: even, for chroma, and no less than encoders take."""
    return max(side + side % 2, MIN_SIDE)


def decode_pictures(pictures: Sequence[bytes], found: SequenceFormat) -> Iterator[list[Samples]]:
    """Return an iterator that decodes pictures one after another: for each, copies of its planes, luma first.

    Parameters
    ----------
    pictures
        The units of each picture as a decoder takes them, the sequence header's before the first.
    found
        What the sequence header says; whoever calls has checked that it is as it should be.

    Raises
    ------
    CorruptStream
        While iterating, if a picture cannot be decoded.
    UnsupportedVersion
        If this build of PyAV cannot read AV1.
    """
    name = _decoder_name()
    if name is None:
        raise UnsupportedVersion("this build of PyAV cannot read AV1; install av 14 or newer with libdav1d")
    return _decoded(name, pictures, found)


def _decoded(name: str, pictures: Sequence[bytes], found: SequenceFormat) -> Iterator[list[Samples]]:
    context: Any = av.CodecContext.create(name, "r")
    context.thread_count = DECODER_THREADS
    # A frame may say that it is larger than the sequence header tells.
    context.options = {"max_pixels": str(found.width * found.height)}
    count = 0
    try:
        for data in [*pictures, None]:
            for frame in context.decode(None if data is None else av.Packet(data)):
                count += 1
                yield _copied(frame, found)
    except FFmpegError as error:
        raise CorruptStream(
            f"picture {count} of a video cannot be decoded ({error.strerror}); the stream is damaged"
        ) from None
    if count != len(pictures):
        raise CorruptStream(f"{count} of {len(pictures)} pictures of a video can be decoded; the stream is damaged")


def _copied(frame: av.VideoFrame, found: SequenceFormat) -> list[Samples]:
    """Return copies of the samples of a decoded picture."""
    formats = GRAY_PIXEL_FORMATS if found.gray else PIXEL_FORMATS
    if (frame.width, frame.height) != (found.width, found.height) or frame.format.name != formats[found.bits]:
        raise CorruptStream(
            f"a picture of a video has {frame.width}x{frame.height} samples ({frame.format.name}) instead of "
            f"{found.width}x{found.height}; the stream is damaged"
        )
    return [_samples(plane, found.bits).astype(np.uint16) for plane in frame.planes]


def _planes(planes: list[Samples], video: VideoFormat) -> Planes:
    """Return the samples of a decoded picture without those beyond its size."""
    luma, *chroma = planes
    rows, columns = video.chroma_shape
    orange, green = (plane[:rows, :columns] for plane in chroma) if chroma else [flat_chroma(video)] * 2
    return Planes(luma[: video.height, : video.width], orange, green)
