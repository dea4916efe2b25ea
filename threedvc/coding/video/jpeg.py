# SPDX-License-Identifier: MIT
"""Runs of pictures as the JPEG files that they came in.

A payload holds every file, byte for byte, after its size less 1. Of these payloads alone the pixels depend on the
machine: JPEG (ITU-T T.81) leaves a level or two to its decoders.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from threedvc.coding.video.parts import pack_parts, unpack_parts
from threedvc.coding.video.planes import Picture, VideoFormat
from threedvc.errors import CorruptStream

__all__ = ["JPEG_MAGIC", "JpegFile", "decode_jpeg_files", "decoded_rgb", "encode_jpeg_files", "parse_jpeg"]

JPEG_MAGIC: Final = b"\xff\xd8"
EOI, SOS, DRI = 0xD9, 0xDA, 0xDD
"""Second bytes of markers: end of the picture, start of a scan, interval of restarts (T.81, table B.1)."""
FRAME_HEADERS: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers SOF0 to SOF15; the three left out stand for tables and extensions."""
USUAL_FRAMES: Final = (0xC0, 0xC1, 0xC2)
"""Markers of frames that every decoder reads: baseline, extended and progressive, with Huffman codes."""
FRAME_HEADER_BYTES: Final = 10
"""Of a frame header: marker, size, bits, height, width and number of components (sec. B.2.2)."""
MARKER: Final = re.compile(rb"\xff[^\x00\xff]")
MARKER_AFTER_RESTARTS: Final = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
MAX_SCANS: Final = 64
"""Of a progressive file that is kept. Encoders write 6 to 12; each costs a decoder a pass over the picture, however few
bytes it has."""
MAX_STEPS: Final = 1 << 16
"""Segments of a file, and bytes of filling before them; cameras write a few dozen."""
BITS: Final = 8
"""Of a sample."""


@dataclass(frozen=True, kw_only=True)
class JpegFile:
    """What the segments of a JPEG file say of its picture; all 0 where no frame header is among them.

    Attributes
    ----------
    frame
        Second byte of the marker of its frame header, which tells how it is coded.
    width, height
        In pixels.
    components, bits
        Channels, and bits of a sample.
    scans
        Passes over the picture.
    """

    frame: int = 0
    width: int = 0
    height: int = 0
    components: int = 0
    bits: int = 0
    scans: int = 0


def parse_jpeg(data: bytes) -> JpegFile:
    """Follow the segments of a JPEG file to its end; what comes after that does not count.

    Raises
    ------
    ValueError
        Saying what is wrong, if they do not lead there.
    """
    position, restarts, scans, found = len(JPEG_MAGIC), False, 0, JpegFile()
    for _ in range(MAX_STEPS):
        if position + 2 > len(data):
            break
        if data[position] != 0xFF:
            raise ValueError(f"damaged JPEG at byte {position}")
        marker = data[position + 1]
        if marker == 0xFF:
            position += 1
            continue
        if marker == EOI:
            return JpegFile(**{**vars(found), "scans": scans})
        if marker in FRAME_HEADERS and not found.frame:
            found = _frame_header(data[position : position + FRAME_HEADER_BYTES])
        restarts = restarts or marker == DRI
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
        if marker == SOS:
            scans += 1
            position = _end_of_scan(data, position, restarts)
    raise ValueError(f"truncated JPEG of {len(data)} bytes")


def _frame_header(head: bytes) -> JpegFile:
    if len(head) < FRAME_HEADER_BYTES:
        return JpegFile()
    height, width = int.from_bytes(head[5:7], "big"), int.from_bytes(head[7:9], "big")
    return JpegFile(frame=head[1], width=width, height=height, components=head[9], bits=head[4])


def _end_of_scan(data: bytes, position: int, restarts: bool) -> int:
    """Return where the entropy-coded bytes that begin at `position` end: at the next marker."""
    marker = (MARKER_AFTER_RESTARTS if restarts else MARKER).search(data, position)
    return marker.start() if marker else len(data)


def decoded_rgb(data: bytes) -> Picture | None:
    """Return the pixels (h, w, 3) of a picture file as it is stored, or None if it cannot be decoded.

    Transparency is dropped. What EXIF says of turning is not followed: intrinsics hold for the stored pixels.
    """
    try:
        picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        picture = None
    return None if picture is None else np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def encode_jpeg_files(pictures: Iterable[tuple[bytes | None, Picture]], video: VideoFormat) -> bytes | None:
    """Return the payload of a run of pictures, or None if it cannot be made of files.

    Parameters
    ----------
    pictures
        The file that each picture came in, if there is one, and its pixels (h, w, 3).
    video
        Size of the pictures, and whether they are gray.
    """
    files: list[bytes] = []
    for data, pixels in pictures:
        if data is None or _defect(data, video) or not _has_pixels(data, pixels):
            return None
        files.append(data)
    channels = 1 if video.gray else 3
    fits = sum(map(len, files)) <= len(files) * video.width * video.height * channels
    return pack_parts(files) if fits else None


def _has_pixels(data: bytes, pixels: Picture) -> bool:
    found = decoded_rgb(data)
    return found is not None and np.array_equal(found, pixels)


def _defect(data: bytes, video: VideoFormat) -> str | None:
    """Say why a file cannot stand in a payload: before it is decoded, so that it cannot claim to be huge."""
    if not data.startswith(JPEG_MAGIC):
        return "no JPEG"
    try:
        file = parse_jpeg(data)
    except ValueError as error:
        return str(error)
    if (file.width, file.height) != (video.width, video.height):
        return f"of {file.width}x{file.height} pixels instead of {video.width}x{video.height}"
    channels = (1,) if video.gray else (1, 3)
    if file.frame not in USUAL_FRAMES or file.bits != BITS or file.components not in channels:
        return f"of an unusual kind (frame 0x{file.frame:02x}, {file.components} channels of {file.bits} bits)"
    return f"of {file.scans} scans, at most {MAX_SCANS} are accepted" if file.scans > MAX_SCANS else None


def decode_jpeg_files(payload: bytes, count: int, video: VideoFormat) -> Iterator[Picture]:
    """Check a payload, and return an iterator that decodes its pictures (h, w, 3) uint8 one after another.

    Raises
    ------
    CorruptStream
        If the payload does not hold so many files, or one is incomplete or not of this size and kind; while iterating,
        if one cannot be decoded.
    """
    files = unpack_parts(payload, count, count)
    for number, data in enumerate(files):
        if defect := _defect(data, video):
            raise CorruptStream(f"picture {number} of a video is {defect}; the stream is damaged")
    return _decoded(files, video)


def _decoded(files: list[bytes], video: VideoFormat) -> Iterator[Picture]:
    for number, data in enumerate(files):
        picture = decoded_rgb(data)
        if picture is None or picture.shape != (video.height, video.width, 3):
            raise CorruptStream(f"picture {number} of a video cannot be decoded; the stream is damaged")
        yield picture
