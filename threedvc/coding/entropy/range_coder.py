# SPDX-License-Identifier: MIT
"""Buffers around the compiled range coder: one writes a payload, one reads it.

Both have the same methods, so that a payload is described once: a value is passed in, and the value
that stands in the payload comes back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import CorruptStream
from threedvc.kernels.coding.range_coder import (
    CODER_SIZE,
    COUNTER_START,
    EVEN,
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

__all__ = ["RangeCoder", "RangeReader", "RangeWriter", "new_counters"]

SPARE_BYTES = 16
"""Room that is always left: for what is in the interval when a payload ends, and a byte or two more."""
NUMBER_BYTES = 64
"""Room for a number: the costliest takes 50, of 33 adaptive bits at 11 bits each and 30 even ones."""
NUMBER_LIMIT = 255
"""Bits that a counter remembers. Part of the format (docs/coding.md)."""


def new_counters(count: int) -> NDArray[np.uint32]:
    """Return counters that have seen nothing and give both bits the same probability."""
    return np.full(count, COUNTER_START, dtype=np.uint32)


class RangeCoder:
    """What writing and reading share.

    Attributes
    ----------
    coder
        State and bytes, for the kernels. Before a kernel writes, `reserve` makes room.
    """

    def __init__(self, data: NDArray[np.uint8]) -> None:
        self.coder = Coder(np.zeros(CODER_SIZE, dtype=np.int64), data)

    def reserve(self, count: int) -> None:
        """Make room for `count` more bytes; reading needs none."""

    def check(self) -> None:
        """Raise CorruptStream if more was read than the payload holds."""
        if overrun(self.coder):
            raise CorruptStream(f"coded payload of {len(self.coder.data)} bytes ends too early; the stream is damaged")

    def bit(self, value: bool) -> bool:
        """Code one bit at the cost of one bit."""
        self.reserve(NUMBER_BYTES)
        return bool(code_bit(self.coder, int(value), EVEN))

    def number(self, value: int, counters: NDArray[np.uint32]) -> int:
        """Code an integer within 0..2^31 - 2."""
        self.reserve(NUMBER_BYTES)
        return int(code_number(self.coder, value, counters, 0, NUMBER_LIMIT))

    def signed(self, value: int, counters: NDArray[np.uint32]) -> int:
        """Code an integer whose magnitude is below 2^31 - 1."""
        self.reserve(NUMBER_BYTES)
        return int(code_signed(self.coder, value, counters, 0, NUMBER_LIMIT))


class RangeWriter(RangeCoder):
    """A payload that grows."""

    def __init__(self) -> None:
        super().__init__(np.zeros(1024, dtype=np.uint8))
        start_writing(self.coder)

    def reserve(self, count: int) -> None:
        """Make room for `count` more bytes."""
        data = self.coder.data
        missing = int(self.coder.state[POSITION]) + count + SPARE_BYTES - len(data)
        if missing > 0:
            room = np.zeros(max(missing, len(data)), dtype=np.uint8)
            self.coder = self.coder._replace(data=np.concatenate([data, room]))

    def finish(self) -> bytes:
        """End the payload and return it."""
        finish_writing(self.coder)
        return self.coder.data[: self.coder.state[POSITION]].tobytes()


class RangeReader(RangeCoder):
    """A payload that is read; values passed in are of no meaning."""

    def __init__(self, payload: bytes) -> None:
        super().__init__(np.frombuffer(payload, dtype=np.uint8).copy())
        start_reading(self.coder)

    def finish(self) -> None:
        """Check that the payload ends where it was read to.

        Raises
        ------
        CorruptStream
            If bytes are missing or left over.
        """
        self.check()
        if self.coder.state[POSITION] < len(self.coder.data):
            raise CorruptStream(
                f"coded payload of {len(self.coder.data)} bytes goes on after its end; the stream is damaged"
            )
