# SPDX-License-Identifier: MIT
"""Which pixels without a measurement hold the largest raw depth, as some sensors have it, in place of 0."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import CorruptStream
from threedvc.stream.compressed_payload import compress, decompress
from threedvc.stream.wire import ByteReader, pack_varint

__all__ = ["SaturatedPixels", "pack_saturated"]

WHAT = "which pixels of measured depth are saturated"


def pack_saturated(depths: Sequence[NDArray[np.uint16]], saturated: Sequence[NDArray[np.bool_] | None]) -> bytes:
    """Return what stands before the payload of measured depth, or nothing if no pixel is saturated.

    Parameters
    ----------
    depths
        (h, w) raw depths of every frame, 0 = not measured.
    saturated
        (h, w) where each frame has the largest raw depth, or None for nowhere; what is measured does not count.
    """
    bits = [
        np.zeros(np.count_nonzero(depth == 0), dtype=np.bool_) if marked is None else marked[depth == 0]
        for depth, marked in zip(depths, saturated, strict=True)
    ]
    if not any(each.any() for each in bits):
        return b""
    data = compress(np.packbits(np.concatenate(bits)).tobytes())
    return pack_varint(len(data)) + data


class SaturatedPixels:
    """Reads what `pack_saturated` has written, frame by frame.

    Parameters
    ----------
    reader
        At its beginning; after that it is at what follows.
    pixels
        Pixels of all frames.

    Raises
    ------
    CorruptStream
        If it is damaged.
    """

    def __init__(self, reader: ByteReader, pixels: int) -> None:
        content = decompress(reader.take(reader.varint()), -(-pixels // 8), WHAT)
        self._data, self._place = np.frombuffer(content, dtype=np.uint8), 0

    def of(self, depth: NDArray[np.uint16]) -> NDArray[np.bool_]:
        """Return where the next frame, of these raw depths (h, w), is saturated.

        Raises
        ------
        CorruptStream
            If nothing is told of it.
        """
        missing = depth == 0
        first, last = self._place, self._place + int(np.count_nonzero(missing))
        if last > 8 * len(self._data):
            raise CorruptStream(f"{WHAT} is not told to the end; the stream is damaged")
        bits = np.unpackbits(self._data[first // 8 : -(-last // 8)])[first % 8 :]
        self._place = last
        found = np.zeros(depth.shape, dtype=np.bool_)
        found[missing] = bits[: last - first]
        return found

    def finish(self) -> None:
        """Check that it ends with the last frame; raises CorruptStream."""
        if len(self._data) != -(-self._place // 8):
            raise CorruptStream(f"{WHAT} is told of more than there are; the stream is damaged")
