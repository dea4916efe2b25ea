# SPDX-License-Identifier: MIT
"""AV1 data as a payload: one sequence header and the frames, without what follows from these.

Units of AV1 data (open bitstream units) are a first byte, a size and a body. What kind a unit is follows here from its
place and its first bits, and where pictures end from the frames that are shown. Sections are those of the AV1
bitstream specification.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from threedvc.coding.video.parts import pack_parts
from threedvc.errors import CorruptStream
from threedvc.limits import MAX_COUNT
from threedvc.stream.wire import ByteReader, pack_varint

__all__ = [
    "SequenceFormat",
    "pack_units",
    "read_sequence_header",
    "read_still_header",
    "still_header_of",
    "unpack_units",
]

SEQUENCE_HEADER, TEMPORAL_DELIMITER, FRAME, FRAME_HEADER = 0x0A, 0x12, 0x32, 0x1A
"""First bytes of units: the kind, and that the size follows (sec. 5.3.2)."""
SHOWS_EARLIER, SHOWN = 0x80, 0x10
"""Bits of a frame's first byte. What only shows an earlier frame is a frame header without a frame (sec. 5.9.2)."""
PLAIN_BITS = 24
"""Of a sequence header: profile, still picture, timing, delays and operating points, all 0 in what is written here."""
STILL_BITS, STILL = 5, 0b00011
"""Of a sequence header of one picture in its short form: profile 0, a still picture, and that the form is short."""
MAX_UNTIERED_LEVEL = 7
"""Levels above are followed by a bit for the tier."""
MAX_PICTURE_UNITS = 32
"""Units of a picture, shown or not yet: there are places for eight frames that are shown later, and encoders fill six
before they show one (decision 0030). Units of two bytes each would take fifty times their size in memory."""
SELECTED = 2
"""What a tool is set to if each frame tells whether it uses it."""


class SequenceFormat(NamedTuple):
    """What a sequence header says of the pictures.

    Attributes
    ----------
    width, height
        Size.
    bits
        Of a sample: 8 or 10.
    gray
        Whether there is luma alone; else chroma has half the rows and columns.
    grain
        Whether a decoder is to add noise, which no two do alike.
    """

    width: int
    height: int
    bits: int
    gray: bool
    grain: bool


class _Bits:
    """Reads bits, the highest of each byte first."""

    def __init__(self, data: bytes) -> None:
        self._data, self._place = data, 0

    def take(self, count: int) -> int:
        """Return the next bits as a number."""
        if self._place + count > 8 * len(self._data):
            raise CorruptStream("the sequence header of a video is cut short; the stream is damaged")
        value = 0
        for _ in range(count):
            value = value << 1 | self._data[self._place >> 3] >> (7 - self._place % 8) & 1
            self._place += 1
        return value


def pack_units(packets: Iterable[bytes]) -> bytes:
    """Return the payload of what an encoder wrote: packets of whole units with their sizes.

    Raises
    ------
    ValueError
        If there are units of a kind that a payload cannot hold, or other headers than one.
    """
    headers, frames = set(), []
    for packet in packets:
        reader = ByteReader(packet)
        while reader.remaining:
            kind = reader.take(1)[0]
            body = reader.take(reader.varint())
            if kind == SEQUENCE_HEADER:
                headers.add(body)
            elif kind in (FRAME, FRAME_HEADER) and (kind == FRAME_HEADER) == bool(body[0] & SHOWS_EARLIER):
                frames.append(body)
            elif kind != TEMPORAL_DELIMITER:
                raise ValueError(f"a unit 0x{kind:02x} of AV1 data cannot stand in a payload")
    if len(headers) != 1:
        raise ValueError(f"a run of pictures has {len(headers)} sequence headers; it must have one")
    return pack_parts([*headers, *frames])


def unpack_units(payload: bytes, most: int = MAX_COUNT) -> tuple[bytes, list[bytes]]:
    """Return the sequence header's body, and for every picture in turn its units as a decoder takes them.

    The header stands before the first picture's. Sizes in AV1 data are written as varints are (leb128).

    Raises
    ------
    CorruptStream
        If units are cut short, there is none, a frame at the end is not shown, a picture has more than
        `MAX_PICTURE_UNITS`, or there are more than `most` pictures.
    """
    bodies = _bodies(payload)
    header = next(bodies)
    pictures, units = list[bytes](), list[bytes]()
    for frame in bodies:
        units.append(_unit(FRAME_HEADER if frame[0] & SHOWS_EARLIER else FRAME, frame))
        if len(units) > MAX_PICTURE_UNITS or len(pictures) == most:
            raise CorruptStream(
                f"a video of {most} pictures has more, or one of more than {MAX_PICTURE_UNITS} units; the stream is "
                "damaged"
            )
        if frame[0] & (SHOWS_EARLIER | SHOWN):
            pictures.append(b"".join(units))
            units = []
    if units:
        raise CorruptStream("a video ends with a frame that is not shown; the stream is damaged")
    return header, [_unit(SEQUENCE_HEADER, header) + first for first in pictures[:1]] + pictures[1:]


def _bodies(payload: bytes) -> Iterator[bytes]:
    """Yield what units hold: at least one, and none empty."""
    reader = ByteReader(payload)
    try:
        yield reader.take(reader.varint() + 1)
        while reader.remaining:
            yield reader.take(reader.varint() + 1)
    except CorruptStream as error:
        raise CorruptStream(f"a video is incomplete: {error}; the stream is damaged") from None


def _unit(kind: int, body: bytes) -> bytes:
    return bytes([kind]) + pack_varint(len(body)) + body


def still_header_of(data: bytes) -> bytes:
    """Return the body of the one sequence header among whole units of AV1 data with their sizes.

    Raises
    ------
    CorruptStream
        If units are cut short, or there is another number of headers.
    """
    reader = ByteReader(data)
    headers = []
    while reader.remaining:
        kind = reader.take(1)[0]
        body = reader.take(reader.varint())
        if kind == SEQUENCE_HEADER:
            headers.append(body)
    if len(headers) != 1:
        raise CorruptStream(f"a picture has {len(headers)} sequence headers instead of one; the stream is damaged")
    return headers[0]


def read_sequence_header(body: bytes) -> SequenceFormat:
    """Return what a sequence header tells of the pictures (sec. 5.5).

    Raises
    ------
    CorruptStream
        If it is cut short, or not of the plain kind: profile 0, one operating point, no timing.
    """
    bits = _Bits(body)
    if bits.take(PLAIN_BITS):
        raise CorruptStream("a video is of an unknown make; the stream is damaged")
    if bits.take(5) > MAX_UNTIERED_LEVEL:
        bits.take(1)
    return _read_format(bits, _pass_tools)


def read_still_header(body: bytes) -> SequenceFormat:
    """Return what the short sequence header of a single picture tells of it (sec. 5.5).

    Raises
    ------
    CorruptStream
        If it is cut short, or not of that kind and profile 0.
    """
    bits = _Bits(body)
    if bits.take(STILL_BITS) != STILL:
        raise CorruptStream("a picture is of an unknown make; the stream is damaged")
    bits.take(5)  # level
    return _read_format(bits, _pass_still_tools)


def _read_format(bits: _Bits, pass_tools: Callable[[_Bits], None]) -> SequenceFormat:
    """Return the format from the sides on, which stand in every kind of sequence header."""
    across, down = bits.take(4) + 1, bits.take(4) + 1
    width, height = bits.take(across) + 1, bits.take(down) + 1
    pass_tools(bits)
    high, gray = bits.take(1), bits.take(1)
    if bits.take(1):  # primaries, transfer and matrix, which mean nothing here
        bits.take(24)
    bits.take(1)  # range
    if not gray:
        bits.take(3)  # place of chroma, separate steps
    return SequenceFormat(width, height, 10 if high else 8, bool(gray), bool(bits.take(1)))


def _pass_still_tools(bits: _Bits) -> None:
    """Pass over what a short sequence header says of tools."""
    bits.take(6)  # superblocks, filters; super-resolution, CDEF, restoration


def _pass_tools(bits: _Bits) -> None:
    """Pass over what a sequence header says of the tools of coding, between sizes and samples."""
    if bits.take(1):  # numbers of frames
        bits.take(7)
    bits.take(7)  # superblocks, filters, compounds, warps
    ordered = bits.take(1)
    if ordered:
        bits.take(2)
    screen_content = SELECTED if bits.take(1) else bits.take(1)
    if screen_content and not bits.take(1):
        bits.take(1)
    if ordered:
        bits.take(3)
    bits.take(3)  # super-resolution, CDEF, restoration
