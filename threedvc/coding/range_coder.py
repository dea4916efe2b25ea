# SPDX-License-Identifier: MIT
"""Buffers around the compiled range coder: one writes a payload, one reads it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import CorruptStream
from threedvc.kernels.entropy import (
    CODER_SIZE,
    COUNTER_START,
    POSITION,
    Coder,
    code_bit,
    code_number,
    code_signed,
    finish_writing,
    overrun,
    start_reading,
    start_writing,
)

__all__ = ["RangeReader", "RangeWriter", "new_counters"]

SPARE_BYTES = 16
NUMBER_LIMIT = 255
HALF = 1 << 15
BITS_PER_BYTE_OF_DATA = 12000


def new_counters(count: int) -> NDArray[np.uint32]:
    """Return counters that have seen nothing and give both bits the same probability."""
    return np.full(count, COUNTER_START, dtype=np.uint32)


class RangeWriter:
    """A growing payload. Kernels write through `coder` after `reserve`."""

    def __init__(self) -> None:
        self.coder = Coder(np.zeros(CODER_SIZE, dtype=np.int64), np.zeros(1024, dtype=np.uint8))
        start_writing(self.coder)

    def reserve(self, count: int) -> None:
        """Make room for `count` more bytes."""
        missing = int(self.coder.state[POSITION]) + count + SPARE_BYTES - len(self.coder.data)
        if missing > 0:
            room = np.zeros(max(missing, len(self.coder.data)), dtype=np.uint8)
            self.coder = self.coder._replace(data=np.concatenate([self.coder.data, room]))

    def check(self) -> None:
        """Do nothing: what is being written is never too short."""

    def bit(self, value: int) -> int:
        """Write one bit at the cost of one bit."""
        self.reserve(2)
        return int(code_bit(self.coder, value, HALF))

    def number(self, value: int, counters: NDArray[np.uint32], first: int = 0) -> int:
        """Write an integer within 0..2^31 - 2."""
        self.reserve(64)
        return int(code_number(self.coder, value, counters, first, NUMBER_LIMIT))

    def signed(self, value: int, counters: NDArray[np.uint32], first: int = 0) -> int:
        """Write an integer of either sign, of less than 2^31 - 1."""
        self.reserve(64)
        return int(code_signed(self.coder, value, counters, first, NUMBER_LIMIT))

    def finish(self) -> bytes:
        """End the payload and return it."""
        self.reserve(8)
        finish_writing(self.coder)
        return self.coder.data[: self.coder.state[POSITION]].tobytes()


class RangeReader:
    """A payload being read, through the same calls that wrote it; values passed in are ignored."""

    def __init__(self, payload: bytes) -> None:
        data = np.frombuffer(payload, dtype=np.uint8).copy()
        self.coder = Coder(np.zeros(CODER_SIZE, dtype=np.int64), data)
        start_reading(self.coder)

    def reserve(self, count: int) -> None:
        """Do nothing: reading needs no room."""

    def check(self) -> None:
        """Raise CorruptStream if more was read than the payload holds."""
        if overrun(self.coder):
            raise CorruptStream(f"coded payload of {len(self.coder.data)} bytes ends too early; the stream is damaged")

    def check_plausible(self, bits: int) -> None:
        """Raise CorruptStream if no payload of this length can hold so many binary decisions."""
        if bits > (len(self.coder.data) + SPARE_BYTES) * BITS_PER_BYTE_OF_DATA:
            raise CorruptStream(f"coded payload of {len(self.coder.data)} bytes cannot hold {bits} decisions")

    def bit(self, value: int = 0) -> int:
        """Read what `RangeWriter.bit` wrote."""
        return int(code_bit(self.coder, value, HALF))

    def number(self, value: int, counters: NDArray[np.uint32], first: int = 0) -> int:
        """Read what `RangeWriter.number` wrote."""
        return int(code_number(self.coder, value, counters, first, NUMBER_LIMIT))

    def signed(self, value: int, counters: NDArray[np.uint32], first: int = 0) -> int:
        """Read what `RangeWriter.signed` wrote."""
        return int(code_signed(self.coder, value, counters, first, NUMBER_LIMIT))

    def finish(self) -> None:
        """Check that the payload ends where it was read to.

        Raises
        ------
        CorruptStream
            If bytes are missing or left over.
        """
        self.check()
        if self.coder.state[POSITION] < len(self.coder.data):
            raise CorruptStream(f"coded payload of {len(self.coder.data)} bytes goes on after its end; the stream is damaged")
