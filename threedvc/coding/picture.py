# SPDX-License-Identifier: MIT
"""Still pictures as AVIF of one gray plane, whose decoding is exact everywhere.

Luma stands above the two chroma planes of half its size, side by side; the color transform is ours and in
integers. Chroma is magnified, as an error of its samples shows in four pixels each. What is the same in every AVIF
file of this kind is left out.
"""

from __future__ import annotations

import re
import struct
from io import BytesIO

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, features

from threedvc.errors import CorruptStream, UnsupportedVersion

__all__ = ["avif_file", "can_decode_pictures", "can_encode_pictures", "decode_picture", "encode_picture"]

WHOLE, STRIPPED = 0, 1
"""Lowest bit of a payload's first byte. Part of the format (docs/coding.md), as all here but what encoders are told."""
MAX_MAGNIFIED = 3
"""Chroma is magnified by 1 + m/4 with m up to this: 0.3 dB at equal bytes, on two backgrounds; 2 is no better."""
QUICK_SPEED, THOROUGH_SPEED = 3, 0
"""Of the AV1 encoder: the latter takes several times as long for about 3 % fewer bytes."""
LEAST_SQUARES = {"tune": "psnr", "enable-cdef": "1"}
"""What the encoder is to go for; by default it is what looks best, at 15 % more bytes for the same squared error."""
HEAD = bytes.fromhex(
    "0000001c66747970617669660000000061766966"
    "6d6966316d696166000000e96d657461000000000000002168646c72000000000000000070"
    "696374000000000000000000000000000000000e7069746d0000000000010000001e696c6f6300000000440000010001000000010000010d"
)
ITEM = bytes.fromhex(
    "0000002869696e660000000000010000001a696e6665020000000001000061763031436f6c6f72000000006869707270000000496970636f"
    "0000001469737065 00000000"
)
CHANNELS = bytes.fromhex("0000000e706978690000000001080000000c61763143")
TAIL = bytes.fromhex("00000013636f6c726e636c78000200020002800000001769706d61000000000000000100010401028304")
"""What is the same in every such file, see `_completed`."""
COLOR_CONFIG_BYTES = 4
"""Content of the box av1C."""
COLOR_BOX = slice(12, 18)
"""Where `TAIL` tells primaries, transfer function and matrix."""
SIZE_BOX, SIZE_BYTES = re.compile(rb"ispe\0\0\0\0", re.DOTALL), 8
"""Where an AVIF file tells the size of a picture: it is checked before anything is decoded."""


def can_encode_pictures() -> bool:
    """Tell whether these builds of Pillow and OpenCV can write AVIF and read it again."""
    return bool(features.check("avif")) and can_decode_pictures()


def can_decode_pictures() -> bool:
    """Tell whether this build of OpenCV has AVIF."""
    return bool(cv2.haveImageWriter(".avif"))


def encode_picture(picture: NDArray[np.uint8], quality: int, gray: bool, *, thorough: bool = True) -> bytes:
    """Return the payload of a picture.

    Parameters
    ----------
    picture
        (h, w, 3) uint8 RGB.
    quality
        1 to 100, as AVIF encoders take it.
    gray
        Whether to code the luma alone.
    thorough
        Whether to take several times as long for about 3 % fewer bytes.
    """
    magnified = _magnification(picture, gray)
    planes = _planes(picture, gray, magnified)
    file = avif_file(planes[None], quality, THOROUGH_SPEED if thorough else QUICK_SPEED, LEAST_SQUARES)
    payload = _stripped(file, planes.shape[1], planes.shape[0])
    return bytes([payload[0] | magnified << 1]) + payload[1:]


def avif_file(planes: NDArray[np.uint8], quality: int, speed: int, settings: dict[str, str]) -> bytes:
    """Return the AVIF file of gray planes (n, h, w) uint8; several become the frames of an animation.

    Parameters
    ----------
    planes
        The pictures.
    quality
        1 to 100.
    speed
        0, the most thorough, to 10.
    settings
        Further options of the AV1 encoder, by the names it has for them.
    """
    first, *others = (Image.fromarray(plane).convert("RGB") for plane in planes)
    file = BytesIO()
    first.save(
        file,
        "AVIF",
        save_all=bool(others),
        append_images=others,
        codec="aom",
        quality=quality,
        speed=speed,
        subsampling="4:0:0",
        range="full",
        autotiling=False,
        max_threads=1,
        advanced=settings,
    )
    return file.getvalue()


def decode_picture(payload: bytes, width: int, height: int, gray: bool) -> NDArray[np.uint8]:
    """Return the picture (height, width, 3) uint8 RGB of a payload.

    Raises
    ------
    CorruptStream
        If the payload is no such picture.
    UnsupportedVersion
        If this build of OpenCV cannot decode it.
    """
    rows = height if gray else height + -(-height // 2)
    columns = width if gray else 2 * -(-width // 2)
    if not payload or payload[0] >> 1 > MAX_MAGNIFIED:
        raise CorruptStream("a picture is of an unknown make; the stream is damaged")
    magnified, data = payload[0] >> 1, _completed(bytes([payload[0] & 1]) + payload[1:], columns, rows)
    if not can_decode_pictures():
        raise UnsupportedVersion(
            "this build of OpenCV cannot read AVIF pictures; install opencv-python-headless 5 or newer"
        )
    planes = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if planes is None or planes.shape != (rows, columns) or planes.dtype != np.uint8:
        raise CorruptStream(f"a picture of {width}x{height} pixels cannot be decoded; the stream is damaged")
    return _picture(np.asarray(planes, dtype=np.uint8), width, height, gray, magnified)


def _magnification(picture: NDArray[np.uint8], gray: bool) -> int:
    """Return the greatest magnification of chroma that does not clip it."""
    if gray:
        return 0
    largest = int(np.abs(_chroma(picture)).max(initial=0))
    return next(m for m in range(MAX_MAGNIFIED, -1, -1) if m == 0 or largest * (4 + m) <= 127 * 8)


def _chroma(picture: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return R - B and G - (R + B) / 2 (2, h, w), rounded down."""
    red, green, blue = np.moveaxis(picture.astype(np.int32), -1, 0)
    return np.stack([red - blue, (2 * green - red - blue) >> 1])


def _planes(picture: NDArray[np.uint8], gray: bool, magnified: int = 0) -> NDArray[np.uint8]:
    values = picture.astype(np.int32)
    red, green, blue = values[..., 0], values[..., 1], values[..., 2]
    luma = (red + 2 * green + blue + 2) >> 2
    if gray:
        return luma.astype(np.uint8)
    height, width = luma.shape
    even = ((0, height % 2), (0, width % 2))
    chroma = []
    for plane in _chroma(picture):
        whole = np.pad(plane, even, mode="edge")
        sums = whole[::2, ::2] + whole[1::2, ::2] + whole[::2, 1::2] + whole[1::2, 1::2]
        chroma.append(np.clip(((sums * (4 + magnified) + 16) >> 5) + 128, 0, 255))
    luma = np.pad(luma, ((0, 0), (0, width % 2)), mode="edge")
    return np.vstack([luma, np.hstack(chroma)]).astype(np.uint8)


def _picture(planes: NDArray[np.uint8], width: int, height: int, gray: bool, magnified: int = 0) -> NDArray[np.uint8]:
    values = planes.astype(np.int32)
    luma = values[:height, :width]
    if gray:
        return np.repeat(luma[..., None], 3, axis=2).astype(np.uint8)
    half = values.shape[1] // 2
    doubled = (_doubled(values[height:, k * half : (k + 1) * half] - 128)[:height, :width] for k in (0, 1))
    co, cg = ((8 * plane + 4 + magnified) // (2 * (4 + magnified)) for plane in doubled)
    # Co is half of R - B, Cg a quarter of 2 G - R - B; Y - Cg is (R + B) / 2.
    rest = luma - cg
    return np.clip(np.stack([rest + co, luma + cg, rest - co], axis=-1), 0, 255).astype(np.uint8)


def _doubled(plane: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return a plane of twice the size, interpolated with weights 3/4 and 1/4."""
    for axis in (0, 1):
        before = np.concatenate([plane.take([0], axis), plane.take(range(plane.shape[axis] - 1), axis)], axis)
        after = np.concatenate([plane.take(range(1, plane.shape[axis]), axis), plane.take([-1], axis)], axis)
        pairs = np.stack([(3 * plane + before + 2) >> 2, (3 * plane + after + 2) >> 2], axis + 1)
        shape = list(plane.shape)
        shape[axis] *= 2
        plane = pairs.reshape(shape)
    return plane


def _stripped(data: bytes, width: int, height: int) -> bytes:
    """Leave out what `_completed` can put back; a file of another make is kept whole."""
    start = len(HEAD) + 4 + len(ITEM) + 8 + len(CHANNELS)
    config = data[start : start + COLOR_CONFIG_BYTES]
    payload = bytes([STRIPPED]) + config + data[start + COLOR_CONFIG_BYTES + len(TAIL) + 8 :]
    again = _completed(payload, width, height)
    # Only what the file says of its primaries may differ: they mean nothing here.
    color = start + COLOR_CONFIG_BYTES + COLOR_BOX.start, start + COLOR_CONFIG_BYTES + COLOR_BOX.stop
    alike = data[: color[0]] + again[color[0] : color[1]] + data[color[1] :] == again
    return payload if alike else bytes([WHOLE]) + data


def _completed(payload: bytes, width: int, height: int) -> bytes:
    if not payload or payload[0] not in (WHOLE, STRIPPED):
        raise CorruptStream("a picture is of an unknown make; the stream is damaged")
    if payload[0] == WHOLE:
        sizes = {struct.unpack_from(">II", payload, at.end()) for at in SIZE_BOX.finditer(payload[:-SIZE_BYTES])}
        if sizes != {(width, height)}:
            raise CorruptStream(f"a picture is not of {width}x{height} samples as it must be; the stream is damaged")
        return payload[1:]
    config, image = payload[1 : 1 + COLOR_CONFIG_BYTES], payload[1 + COLOR_CONFIG_BYTES :]
    return b"".join(
        [
            HEAD,
            struct.pack(">I", len(image)),
            ITEM,
            struct.pack(">II", width, height),
            CHANNELS,
            config,
            TAIL,
            struct.pack(">I4s", len(image) + 8, b"mdat"),
            image,
        ]
    )
