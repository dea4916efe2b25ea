# SPDX-License-Identifier: MIT
"""Coders that keep every value, or bound its error: what lossless and bounded depth and color are held against.

Videos go through PyAV, single pictures through imagecodecs. Every coder decodes what it wrote, and whoever counts its
bytes holds the result against what went in. Sizes are those of coded pictures, without a container.
"""

from __future__ import annotations

import importlib
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import pairwise
from types import ModuleType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from av1 import MissingCodec, library

__all__ = ["Coder", "NotExact", "Numbers", "checked_size", "color_coders", "depth_coders", "pictures_library"]

Picture = NDArray[np.uint8] | NDArray[np.uint16]
Pictures = Sequence[Picture]
RoundTrip = Callable[[Pictures], tuple[int, Iterable[Picture]]]
"""Takes pictures, returns the bytes of all and the pictures as decoded."""

DEPTH_VALUES = 1 << 16
"""Of a 16-bit depth picture; 0 is no measurement."""
VIDEO_DEPTH_BITS = 12
"""The most that x265 codes."""
FFV1_SETTINGS = {"level": "3", "coder": "1", "context": "1", "slices": "4", "slicecrc": "0", "g": "100000"}
"""The smallest files: range coder, large contexts, no checksums, one key frame, as few slices as the encoder takes."""
X265_SETTINGS = {"preset": "medium", "x265-params": "lossless=1:keyint=-1:info=0:log-level=error"}
"""One key frame, and what x265 takes for files that are coded once."""
JPEGXL_EFFORT = 7
"""The codec's own default; 9 takes five times as long for 1 to 8 % fewer bytes."""
PNG_LEVEL = 9
"""The smallest files that deflate makes."""


class NotExact(RuntimeError):
    """A coder did not give back what it should have."""


@dataclass(frozen=True, kw_only=True)
class Coder:
    """Something that writes pictures and reads them again.

    Attributes
    ----------
    name
        As in tables.
    version
        Of the library it is from.
    round_trip
        Codes pictures and decodes them.
    limit
        Largest error of a value that it may make.
    """

    name: str
    version: str
    round_trip: RoundTrip
    limit: int = 0


def checked_size(coder: Coder, pictures: Pictures) -> tuple[int, int]:
    """Return the bytes a coder takes for pictures, and the largest error it makes.

    Raises
    ------
    NotExact
        If the error is above the coder's limit, or a pixel without a value gets one or the reverse.
    """
    size, decoded = coder.round_trip(pictures)
    worst = 0
    for number, (given, seen) in enumerate(zip(pictures, decoded, strict=True)):
        error = int(np.abs(given.astype(np.int32) - seen.astype(np.int32)).max(initial=0))
        if error > coder.limit or (coder.limit and not np.array_equal(given > 0, seen > 0)):
            raise NotExact(f"{coder.name}: picture {number} comes back with an error of {error}, not {coder.limit}")
        worst = max(worst, error)
    return size, worst


def pictures_library() -> ModuleType:
    """Return imagecodecs.

    Raises
    ------
    MissingCodec
        If it is not installed, or lacks a codec.
    """
    try:
        found = importlib.import_module("imagecodecs")
    except ImportError:
        raise MissingCodec(
            "JPEG-XL, JPEG-LS, PNG and LERC need imagecodecs; install the extra [bench]: pip install '.[bench]'"
        ) from None
    missing = [name for name in ("JPEGXL", "JPEGLS", "PNG", "LERC") if not getattr(found, name).available]
    if missing:
        raise MissingCodec(f"imagecodecs {found.__version__} lacks {', '.join(missing)}; install its wheel from PyPI")
    return found


@dataclass(frozen=True, eq=False)
class Numbers:
    """Depths as numbers from 1, one for each depth that occurs, or for a few that lie together; 0 stays 0.

    Attributes
    ----------
    depths
        (n,) uint16 rising: the depth that number k + 1 stands for.
    number_of
        (65536,) uint16: the number of each depth that occurs.
    """

    depths: NDArray[np.uint16]
    number_of: NDArray[np.uint16]

    @classmethod
    def covering(cls, pictures: Pictures, limit: int = 0) -> Self:
        """Return the fewest numbers by which no depth changes by more than a limit.

        Parameters
        ----------
        pictures
            (h, w) uint16.
        limit
            Depths within twice of it share a number, which stands for their middle.
        """
        occurs = np.zeros(DEPTH_VALUES, dtype=bool)
        for picture in pictures:
            occurs[picture.ravel()] = True
        levels = np.flatnonzero(occurs[1:]) + 1
        starts, at = [], 0
        while at < len(levels):
            starts.append(at)
            at = int(np.searchsorted(levels, levels[at] + 2 * limit, side="right"))
        bounds = [*starts, len(levels)]
        depths = [(levels[a] + levels[b - 1]) // 2 for a, b in pairwise(bounds)]
        number_of = np.zeros(DEPTH_VALUES, dtype=np.uint16)
        number_of[levels] = np.repeat(np.arange(1, len(starts) + 1), np.diff(bounds))
        return cls(np.array(depths, dtype=np.uint16), number_of)

    @property
    def size(self) -> int:
        """Bytes of the table of depths."""
        return len(zlib.compress(np.diff(self.depths, prepend=np.uint16(0)).tobytes(), 9))

    def decoded(self, numbers: Picture) -> Picture:
        """Return the depths (h, w) uint16 of numbers."""
        return np.concatenate([np.zeros(1, dtype=np.uint16), self.depths])[numbers]


def depth_coders(largest: int, limit: int) -> Iterator[Coder]:
    """Yield coders of depth pictures (h, w) uint16: those without loss, then those with an error up to a limit.

    Parameters
    ----------
    largest
        The largest depth of the pictures.
    limit
        In units of the pictures.
    """
    exact = list(_exact_depth_coders())
    for coder in exact:
        if "x265" not in coder.name or largest < 1 << VIDEO_DEPTH_BITS:
            yield coder
    for coder in exact:
        yield _numbered(coder, ", levels", 0)
    yield _picture_coder("LERC", "lerc", limit, level=limit, compression="zstd")
    yield _picture_coder("JPEG-LS, near lossless", "jpegls", limit, level=limit)
    for coder in exact:
        yield _numbered(coder, ", steps", limit)


def color_coders(gray: bool) -> Iterator[Coder]:
    """Yield coders of RGB pictures (h, w, 3) uint8 without loss, those of gray ones (h, w) uint8."""
    yield _video_coder("FFV1", "ffv1", "ffv1", "gray" if gray else "bgr0", FFV1_SETTINGS)
    yield _picture_coder("JPEG-XL", "jpegxl", lossless=True, effort=JPEGXL_EFFORT, numthreads=1)
    yield _picture_coder("PNG", "png", level=PNG_LEVEL)


def _exact_depth_coders() -> Iterator[Coder]:
    yield _video_coder("x265, 12 bits", "libx265", "hevc", "gray12le", X265_SETTINGS)
    yield _video_coder("FFV1, 16 bits", "ffv1", "ffv1", "gray16le", FFV1_SETTINGS)
    yield _picture_coder("JPEG-XL", "jpegxl", lossless=True, effort=JPEGXL_EFFORT, numthreads=1)
    yield _picture_coder("JPEG-LS", "jpegls")
    yield _picture_coder("PNG", "png", level=PNG_LEVEL)


def _numbered(coder: Coder, words: str, limit: int) -> Coder:
    def round_trip(pictures: Pictures) -> tuple[int, Iterable[Picture]]:
        numbers = Numbers.covering(pictures, limit)
        size, decoded = coder.round_trip([numbers.number_of[picture] for picture in pictures])
        return size + numbers.size, map(numbers.decoded, decoded)

    return Coder(name=coder.name + words, version=coder.version, round_trip=round_trip, limit=limit)


def _picture_coder(name: str, codec: str, limit: int = 0, **choices: Any) -> Coder:
    codecs = pictures_library()
    encode, decode = (getattr(codecs, f"{codec}_{way}") for way in ("encode", "decode"))

    def round_trip(pictures: Pictures) -> tuple[int, Iterable[Picture]]:
        coded = [encode(np.ascontiguousarray(picture), **choices) for picture in pictures]
        return sum(map(len, coded)), (_above(decode(data), limit) for data in coded)

    return Coder(name=name, version=f"imagecodecs {codecs.__version__}", round_trip=round_trip, limit=limit)


def _above(picture: Picture, limit: int) -> Picture:
    """Take for no measurement what may have been one of 0; no sensor sees as near as the limit."""
    return np.where(picture > limit, picture, 0).astype(picture.dtype) if limit else picture


def _video_coder(name: str, encoder: str, decoder: str, layout: str, settings: dict[str, str]) -> Coder:
    av = library()
    missing = {encoder, decoder} - av.codecs_available
    if missing:
        raise MissingCodec(f"PyAV {av.__version__} lacks {', '.join(sorted(missing))}; install its wheel from PyPI")
    round_trip = partial(_video_round_trip, encoder, decoder, layout, settings)
    return Coder(name=name, version=f"PyAV {av.__version__}", round_trip=round_trip)


def _video_round_trip(
    encoder: str, decoder: str, layout: str, settings: dict[str, str], pictures: Pictures
) -> tuple[int, Iterable[Picture]]:
    av = library()
    context = av.CodecContext.create(encoder, "w")
    context.height, context.width = pictures[0].shape[:2]
    context.pix_fmt, context.time_base, context.framerate = layout, Fraction(1, 30), Fraction(30)
    context.options = settings
    packets = []
    for number, picture in enumerate(pictures):
        frame = av.VideoFrame(context.width, context.height, layout)
        frame.pts = number
        _samples(frame)[:] = picture[..., ::-1] if picture.ndim == 3 else picture
        packets += context.encode(frame)
    packets += context.encode(None)
    record = bytes(context.extradata or b"") if encoder == "ffv1" else b""
    size = len(record) + sum(packet.size for packet in packets)
    return size, _decoded_video(decoder, record, (context.width, context.height), packets)


def _decoded_video(decoder: str, record: bytes, size: tuple[int, int], packets: Iterable[Any]) -> Iterator[Picture]:
    context = library().CodecContext.create(decoder, "r")
    if record:
        (context.width, context.height), context.extradata = size, record
    for packet in [*packets, None]:
        for frame in context.decode(packet):
            samples = _samples(frame)
            yield np.array(samples[..., ::-1] if samples.ndim == 3 else samples)


def _samples(frame: Any) -> Picture:
    """Return the samples in the memory of a frame: (h, w), or (h, w, 3) blue, green, red."""
    name = frame.format.name
    dtype = np.uint16 if name in ("gray12le", "gray16le") else np.uint8
    rows = np.frombuffer(frame.planes[0], dtype=dtype).reshape(frame.height, -1)
    if name != "bgr0":
        return rows[:, : frame.width]
    return rows[:, : 4 * frame.width].reshape(frame.height, -1, 4)[..., :3]
