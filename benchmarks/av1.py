# SPDX-License-Identifier: MIT
"""Color and depth pictures through AV1: SVT-AV1 encodes, dav1d decodes, both from the wheel of PyAV.

Constant quality and one key frame, the strongest a video codec is at low rates. Bytes are those of the coded
pictures: neither a container nor the two bytes that part one picture from the next in a bare stream.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planes import InverseDepth, Plane, lanczos, resized, rgb_of, triangle, yuv_of
from threedvc.coding.video.scheduling import SchedulingGuard

__all__ = ["Coded", "MissingCodec", "VideoCodec", "library"]

TEMPORAL_DELIMITER = b"\x12\x00"
COLOR_BITS, DEPTH_BITS = 8, 10
"""Eight as in the input; ten for depth, the most that AV1's main profile has."""
CHROMA_ZERO = 128.0
FLAT = np.zeros((1, 1), dtype=np.float32)
"""A plane of one pixel, to be resized: chroma of gray pictures."""


class MissingCodec(RuntimeError):
    """PyAV is not installed, or its libraries lack AV1."""


def library() -> ModuleType:
    """Return PyAV.

    Raises
    ------
    MissingCodec
        If it is not installed, or cannot encode or decode AV1.
    """
    os.environ.setdefault("SVT_LOG", "1")  # errors alone; SVT-AV1 reads it once
    try:
        av = importlib.import_module("av")
    except ImportError:
        raise MissingCodec("AV1 needs PyAV; install the extra [bench]: pip install '.[bench]'") from None
    missing = {"libsvtav1", "libdav1d"} - av.codecs_available
    if missing:
        raise MissingCodec(f"PyAV {av.__version__} lacks {', '.join(sorted(missing))}; install its wheel from PyPI")
    return av


@dataclass(frozen=True, eq=False)
class Coded:
    """Packets of one video."""

    packets: Sequence[Any]

    @property
    def size(self) -> int:
        """Bytes of the coded pictures."""
        return sum(packet.size - len(TEMPORAL_DELIMITER) * _is_delimited(packet) for packet in self.packets)


def _is_delimited(packet: Any) -> bool:
    return bytes(packet)[: len(TEMPORAL_DELIMITER)] == TEMPORAL_DELIMITER


@dataclass(frozen=True, kw_only=True)
class VideoCodec:
    """AV1 at one setting for pictures of one size.

    Attributes
    ----------
    width, height, fps
        Of the pictures that go in and come out.
    crf
        Constant rate factor, 1 to 70; larger is coarser.
    scale
        Pictures are coded at 1/scale of their size, rounded to even numbers.
    preset
        Effort of SVT-AV1: 0 slowest, 13 fastest; 4 as for files that are coded once.
    """

    width: int
    height: int
    fps: float
    crf: int
    scale: int = 1
    preset: int = 4

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the coded pictures."""
        return _even(self.width / self.scale), _even(self.height / self.scale)

    def encode_color(self, pictures: Iterable[NDArray[np.uint8]], gray: bool = False) -> Coded:
        """Encode RGB pictures (h, w, 3) as 4:2:0; of gray ones luma alone, the chroma planes are flat."""
        return self._encode((self._color_planes(picture, gray) for picture in pictures), COLOR_BITS)

    def decode_color(self, coded: Coded, gray: bool = False) -> Iterator[NDArray[np.uint8]]:
        """Yield RGB pictures (h, w, 3) uint8."""
        for y, u, v in self._decode(coded, COLOR_BITS):
            yield rgb_of([y, *([FLAT + CHROMA_ZERO] * 2 if gray else [u, v])], (self.width, self.height))

    def encode_depth(self, pictures: Iterable[Plane], mapping: InverseDepth) -> Coded:
        """Encode depth (h, w) float32 in meters as ten bits of luma; where it is 0 it is filled, no mask is kept."""
        numbers = (resized(mapping.numbers(depth), self.size, triangle) for depth in pictures)
        return self._encode(([luma, self._flat(DEPTH_BITS), self._flat(DEPTH_BITS)] for luma in numbers), DEPTH_BITS)

    def decode_depth(self, coded: Coded, mapping: InverseDepth) -> Iterator[Plane]:
        """Yield depth (h, w) float32 in meters; every pixel has one."""
        for luma, _, _ in self._decode(coded, DEPTH_BITS):
            yield mapping.depth(resized(luma, (self.width, self.height), triangle))

    def _color_planes(self, picture: NDArray[np.uint8], gray: bool) -> list[Plane]:
        if not gray:
            return yuv_of(picture, self.size)
        luma = resized(picture[..., 0].astype(np.float32), self.size, lanczos)
        return [luma, self._flat(COLOR_BITS), self._flat(COLOR_BITS)]

    def _flat(self, bits: int) -> Plane:
        width, height = self.size
        return np.full((height // 2, width // 2), 1 << (bits - 1), dtype=np.float32)

    def _encode(self, pictures: Iterable[list[Plane]], bits: int) -> Coded:
        av = library()
        context = av.CodecContext.create("libsvtav1", "w")
        context.width, context.height = self.size
        context.pix_fmt = _pixel_format(bits)
        context.framerate = Fraction(self.fps).limit_denominator(1001)
        context.time_base = 1 / context.framerate
        parameters = f"crf={self.crf}:keyint=-1:scd=0:tune=1"
        context.options = {"preset": str(self.preset), "svtav1-params": parameters}
        guard = SchedulingGuard()
        context.open()
        guard.restore()
        packets = []
        for number, planes in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(_packed(planes, bits), format=context.pix_fmt)
            frame.pts = number
            packets += context.encode(frame)
        return Coded([*packets, *context.encode(None)])

    def _decode(self, coded: Coded, bits: int) -> Iterator[list[Plane]]:
        context = library().CodecContext.create("libdav1d", "r")
        width, height = self.size
        for packet in [*coded.packets, None]:
            for frame in context.decode(packet):
                samples = frame.to_ndarray(format=_pixel_format(bits)).ravel().astype(np.float32)
                luma, u, v = np.split(samples, [width * height, width * height * 5 // 4])
                half = height // 2, width // 2
                yield [luma.reshape(height, width), u.reshape(half), v.reshape(half)]


def _even(length: float) -> int:
    return max(2 * round(length / 2), 2)


def _pixel_format(bits: int) -> str:
    return "yuv420p" if bits == 8 else f"yuv420p{bits}le"


def _packed(planes: list[Plane], bits: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return planes as one array (3/2 h, w) of whole numbers, in the order of 4:2:0."""
    height, width = planes[0].shape
    samples: Plane = np.concatenate([plane.ravel() for plane in planes]).reshape(height * 3 // 2, width)
    whole = np.clip(np.rint(samples), 0, (1 << bits) - 1)
    return np.asarray(whole, dtype=np.uint8) if bits == 8 else np.asarray(whole, dtype=np.uint16)
