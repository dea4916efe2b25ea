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
from typing import BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.errors import SequenceError

__all__ = ["PictureHeader", "read_color", "read_depth", "read_header", "read_mask"]

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8"
PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 1, 6: 3}
PNG_PALETTE = 3
JPEG_EOI, JPEG_SOS, JPEG_DRI = 0xD9, 0xDA, 0xDD
MARKER = re.compile(rb"\xff[^\x00\xff]")
MARKER_AFTER_RESTARTS = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
JPEG_FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


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
    """

    width: int
    height: int
    channels: int
    bits: int
    palette: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.width, self.height


def read_header(path: Path) -> PictureHeader:
    """Read size and kind of a PNG or JPEG file without decoding it; raises SequenceError."""
    try:
        with path.open("rb") as file:
            magic = file.read(8)
            if magic == PNG_MAGIC:
                return _png_header(path, file.read(18))
            if magic[:2] == JPEG_MAGIC:
                file.seek(2)
                return _jpeg_header(path, file)
    except FileNotFoundError:
        raise SequenceError(f"{path}: no such picture; add it or remove the frame from the recording") from None
    except OSError as error:
        raise _unreadable(path, error.strerror or "input error") from None
    raise _unreadable(path, "neither PNG nor JPEG")


def _png_header(path: Path, chunk: bytes) -> PictureHeader:
    if len(chunk) < 18 or chunk[4:8] != b"IHDR" or chunk[17] not in PNG_CHANNELS:
        raise _unreadable(path, "damaged PNG header")
    width, height = int.from_bytes(chunk[8:12], "big"), int.from_bytes(chunk[12:16], "big")
    return PictureHeader(width, height, PNG_CHANNELS[chunk[17]], chunk[16], palette=chunk[17] == PNG_PALETTE)


def _jpeg_header(path: Path, file: BinaryIO) -> PictureHeader:
    while len(segment := file.read(4)) == 4 and segment[0] == 0xFF:
        length = int.from_bytes(segment[2:], "big")
        if segment[1] in JPEG_FRAME_HEADERS and len(body := file.read(6)) == 6:
            height, width = int.from_bytes(body[1:3], "big"), int.from_bytes(body[3:5], "big")
            return PictureHeader(width, height, body[5], body[0])
        file.seek(length - 2, 1)
    raise _unreadable(path, "damaged JPEG header")


def read_color(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit picture of 1 or 3 channels as (height, width, 3) RGB; alpha is dropped; raises SequenceError."""
    # Rotation flags are ignored: intrinsics hold for the stored pixels.
    picture = _decode(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_depth(path: Path) -> NDArray[np.uint16]:
    """Read a 16-bit picture of 1 channel as (height, width) raw units; raises SequenceError."""
    picture = _decode(path, cv2.IMREAD_UNCHANGED)
    if picture.dtype != np.uint16 or picture.ndim != 2:
        raise _unreadable(path, f"{picture.dtype} with {picture.ndim} axes, expected 16-bit depth")
    return np.asarray(picture, dtype=np.uint16)


def read_mask(path: Path) -> NDArray[np.uint8]:
    """Read an 8-bit picture of 1 channel as (height, width) labels; raises SequenceError."""
    picture = _decode(path, cv2.IMREAD_UNCHANGED)
    if picture.dtype != np.uint8 or picture.ndim != 2:
        raise _unreadable(path, f"{picture.dtype} with {picture.ndim} axes, expected 8-bit labels")
    return np.asarray(picture, dtype=np.uint8)


def _decode(path: Path, flags: int) -> cv2.typing.MatLike:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _unreadable(path, error.strerror or "input error") from None
    defect = _png_defect(data) if data.startswith(PNG_MAGIC) else _jpeg_defect(data)
    if defect:
        raise _unreadable(path, defect)
    try:
        picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        picture = None
    if picture is None:
        raise _unreadable(path, "its content cannot be decoded")
    return picture


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
    position, restarts = 2, False
    while position + 2 <= len(data):
        if data[position] != 0xFF:
            return f"damaged JPEG at byte {position}"
        marker = data[position + 1]
        if marker == JPEG_EOI:
            return None
        restarts = restarts or marker == JPEG_DRI
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
        if marker == JPEG_SOS:
            position = _end_of_scan(data, position, restarts)
    return f"truncated JPEG of {len(data)} bytes"


def _end_of_scan(data: bytes, position: int, restarts: bool) -> int:
    """Return where the entropy-coded bytes that begin at `position` end: at the next marker."""
    marker = (MARKER_AFTER_RESTARTS if restarts else MARKER).search(data, position)
    return marker.start() if marker else len(data)


def _unreadable(path: Path, why: str) -> SequenceError:
    return SequenceError(f"{path}: unreadable picture ({why}); restore the file or leave its frame out")
