# SPDX-License-Identifier: MIT
"""PNG and JPEG pictures: cheap looks at their headers, and checked decoding.

Files are checked for damage before OpenCV sees them: its libraries write complaints about broken
files straight to the process's stderr, and hand out half-decoded pictures without an error.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.coding.video.jpeg import FRAME_HEADERS, JPEG_MAGIC, decoded_rgb, parse_jpeg
from threedvc.errors import SequenceError
from threedvc.formats.sources.files.text import require_file

__all__ = ["ColorPicture", "PictureHeader", "read_color", "read_depth", "read_header", "read_mask"]

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 1, 6: 3}
"""By PNG's color type; a palette counts as three."""
PNG_PALETTE = 3
"""PNG's color type of a picture with a palette."""
JPEG_APP1 = 0xE1
"""Second byte of JPEG's marker of EXIF."""
EXIF, ORIENTATION_TAG = b"Exif\0\0", 0x0112
"""How an APP1 segment with EXIF begins, and EXIF's tag of the orientation."""
HEAD_BYTES = 64
"""Enough for every signature here."""
MAX_PIXELS = 1 << 26
"""64 million pixels: more than any depth camera's color picture has, and a few hundred megabytes once decoded."""
PNG_FIRST_CHUNK = 25
"""Bytes of IHDR with its length, type and checksum."""
PNG_CHECKSUM_BYTES = 4
"""After the data of each chunk."""
MAX_EXIF_BYTES = 1 << 16
"""What a JPEG segment can hold, where EXIF comes from."""
UNDECODABLE = "its content cannot be decoded"
OTHER_KINDS = (
    (rb"II\*\0|MM\0\*", "TIFF"),
    (rb"\x93NUMPY", "a NumPy array"),
    (rb"PK\x03\x04", "a zip archive (perhaps .npz)"),
    (rb"\x76\x2f\x31\x01", "OpenEXR"),
    (rb"RIFF....WEBP", "WebP"),
    (rb"GIF8", "GIF"),
    (rb"BM", "a Windows bitmap"),
    (rb"P[1-7]\s", "a portable map (PGM, PPM)"),
    (rb"P[Ff]\s", "a portable float map (PFM)"),
    (rb"....ftyp(avif|avis)", "AVIF"),
    (rb"....ftyp(heic|heix|mif1)", "HEIC"),
    (rb"....ftyp", "a video"),
    (rb"\x1a\x45\xdf\xa3", "a video"),
    (rb"version https://git-lfs", "a pointer of Git LFS; fetch the files themselves"),
    (rb"\s*<(!DOCTYPE|html)", "a web page"),
    (rb"$", "an empty file"),
)


@dataclass(frozen=True)
class PictureHeader:
    """Size and kind of a picture file.

    Attributes
    ----------
    width, height
        In pixels.
    channels
        Without alpha.
    bits
        Per channel.
    palette
        Whether the pixels are indices into a palette.
    orientation
        How EXIF says to turn the picture for showing it, 1 to 8; 1 is as stored.
    """

    width: int
    height: int
    channels: int
    bits: int
    palette: bool = False
    orientation: int = 1

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.width, self.height


class ColorPicture(NamedTuple):
    """A color picture.

    Attributes
    ----------
    pixels
        (height, width, 3) uint8 RGB.
    jpeg
        The file if it is a JPEG, else None.
    """

    pixels: NDArray[np.uint8]
    jpeg: bytes | None


def read_header(path: Path) -> PictureHeader:
    """Read size and kind of a PNG or JPEG file without decoding it; raises SequenceError."""
    try:
        require_file(path)
        with path.open("rb") as file:
            magic = file.read(HEAD_BYTES)
            if magic.startswith(PNG_MAGIC):
                file.seek(len(PNG_MAGIC))
                header = _png_header(path, file)
            elif magic.startswith(JPEG_MAGIC):
                file.seek(2)
                header = _jpeg_header(path, file)
            else:
                raise _unreadable(path, _kind_of(magic))
    except FileNotFoundError:
        raise SequenceError(f"{path}: no such picture; add it or remove the frame from the recording") from None
    except OSError as error:
        raise _unreadable(path, error.strerror or "input error") from None
    if not 0 < header.width * header.height <= MAX_PIXELS:
        raise _unreadable(path, f"{header.width}x{header.height} pixels, expected 1 to {MAX_PIXELS}")
    return header


def _kind_of(head: bytes) -> str:
    """Say what a file is that is neither PNG nor JPEG."""
    found = next((name for magic, name in OTHER_KINDS if re.match(magic, head, re.DOTALL)), None)
    return "neither PNG nor JPEG" if found is None else f"neither PNG nor JPEG but {found}"


def _png_header(path: Path, file: BinaryIO) -> PictureHeader:
    """Read the chunks before the pixels: IHDR, and eXIf for the orientation."""
    chunk = file.read(PNG_FIRST_CHUNK)
    if len(chunk) < PNG_FIRST_CHUNK or chunk[4:8] != b"IHDR" or chunk[17] not in PNG_CHANNELS:
        raise _unreadable(path, "damaged PNG header")
    width, height = int.from_bytes(chunk[8:12], "big"), int.from_bytes(chunk[12:16], "big")
    return PictureHeader(
        width,
        height,
        PNG_CHANNELS[chunk[17]],
        chunk[16],
        palette=chunk[17] == PNG_PALETTE,
        orientation=_png_orientation(file),
    )


def _png_orientation(file: BinaryIO) -> int:
    while len(head := file.read(8)) == 8 and head[4:] not in (b"IDAT", b"IEND"):
        length = int.from_bytes(head[:4], "big")
        if head[4:] == b"eXIf":
            return _tiff_orientation(file.read(min(length, MAX_EXIF_BYTES))) or 1
        file.seek(length + PNG_CHECKSUM_BYTES, 1)
    return 1


def _jpeg_header(path: Path, file: BinaryIO) -> PictureHeader:
    orientation = 1
    while (marker := _jpeg_marker(file)) is not None and len(size := file.read(2)) == 2:
        length = int.from_bytes(size, "big") - 2
        if marker in FRAME_HEADERS and len(body := file.read(6)) == 6:
            height, width = int.from_bytes(body[1:3], "big"), int.from_bytes(body[3:5], "big")
            return PictureHeader(width, height, body[5], body[0], orientation=orientation)
        if length < 0:
            break
        if marker == JPEG_APP1:
            orientation = _exif_orientation(file.read(length)) or orientation
        else:
            file.seek(length, 1)
    raise _unreadable(path, "damaged JPEG header")


def _jpeg_marker(file: BinaryIO) -> int | None:
    """Return the next marker, after any number of fill bytes (ITU-T T.81, B.1.1.2); None where there is none."""
    byte = file.read(1)
    if byte != b"\xff":
        return None
    while byte == b"\xff":
        byte = file.read(1)
    return byte[0] if byte else None


def _exif_orientation(segment: bytes) -> int | None:
    """Return the orientation that an APP1 segment tells, None if it tells none."""
    return _tiff_orientation(segment[len(EXIF) :]) if segment.startswith(EXIF) else None


def _tiff_orientation(tiff: bytes) -> int | None:
    """Return the orientation in the first directory of EXIF's TIFF structure, None if there is none."""
    order: Literal["big", "little"] = "big" if tiff.startswith(b"MM") else "little"
    if len(tiff) < 10:
        return None
    start = int.from_bytes(tiff[4:8], order)
    count = int.from_bytes(tiff[start : start + 2], order)
    for place in range(start + 2, min(start + 2 + 12 * count, len(tiff) - 11), 12):
        if int.from_bytes(tiff[place : place + 2], order) == ORIENTATION_TAG:
            return int.from_bytes(tiff[place + 8 : place + 10], order)
    return None


def read_color(path: Path) -> ColorPicture:
    """Read an 8-bit picture of 1 or 3 channels; alpha is dropped; raises SequenceError."""
    data = _intact(path)
    pixels = decoded_rgb(data)
    if pixels is None:
        raise _unreadable(path, UNDECODABLE)
    return ColorPicture(pixels, data if data.startswith(JPEG_MAGIC) else None)


def read_depth(path: Path) -> NDArray[np.uint16]:
    """Read a 16-bit picture of 1 channel as (height, width) raw units; raises SequenceError."""
    picture = _without_alpha(_decode(path))
    if picture.dtype != np.uint16 or picture.ndim != 2:
        raise _unreadable(path, f"{picture.dtype} with {picture.ndim} axes, expected 16-bit depth")
    return np.asarray(picture, dtype=np.uint16)


def read_mask(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit picture of 1 channel as (height, width) labels; raises SequenceError."""
    picture = _without_alpha(_decode(path))
    if picture.dtype != np.uint8 or picture.ndim != 2:
        raise _unreadable(path, f"{picture.dtype} with {picture.ndim} axes, expected 8-bit labels")
    return np.asarray(picture, dtype=np.uint8)


def _without_alpha(picture: cv2.typing.MatLike) -> cv2.typing.MatLike:
    """Return a gray picture (h, w) that was decoded with an alpha channel, which OpenCV makes of it, without that."""
    if picture.ndim == 3 and picture.shape[2] in (2, 4) and np.array_equal(picture[..., 0], picture[..., -2]):
        return np.ascontiguousarray(picture[..., 0])
    return picture


def _decode(path: Path) -> cv2.typing.MatLike:
    data = _intact(path)
    try:
        picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None:
        raise _unreadable(path, UNDECODABLE)
    return picture


def _intact(path: Path) -> bytes:
    """Return the bytes of a file that is complete."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _unreadable(path, error.strerror or "input error") from None
    defect = _png_defect(data) if data.startswith(PNG_MAGIC) else _jpeg_defect(data)
    if defect:
        raise _unreadable(path, defect)
    return data


def _png_defect(data: bytes) -> str | None:
    view, position = memoryview(data), len(PNG_MAGIC)
    while position + 12 <= len(data):
        end = position + 12 + int.from_bytes(view[position : position + 4], "big")
        if end > len(data):
            break
        if zlib.crc32(view[position + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            return f"checksum error at byte {position}"
        if data[position + 4 : position + 8] == b"IEND":
            return None
        position = end
    return f"truncated PNG of {len(data)} bytes"


def _jpeg_defect(data: bytes) -> str | None:
    if not data.startswith(JPEG_MAGIC):
        return "neither PNG nor JPEG"
    try:
        parse_jpeg(data)
    except ValueError as error:
        return str(error)
    return None


def _unreadable(path: Path, why: str) -> SequenceError:
    return SequenceError(f"{path}: unreadable picture ({why}); restore the file or leave its frame out")
