# SPDX-License-Identifier: MIT
"""Adaptive binary range coding, compiled.

One traversal serves both directions: `code_bit` takes a bit when the coder writes and returns the
bit that was read when it reads, so that encoder and decoder cannot differ in their contexts.
All arithmetic is on integers.

A counter is a uint32: probability of a one in the upper 22 bits, number of bits seen in the lower 10.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel, lean

__all__ = [
    "CODER_SIZE",
    "COUNTER_START",
    "EVEN",
    "LIMIT",
    "LOW",
    "MASK32",
    "MAX_OVERRUN",
    "NUMBER_COUNTERS",
    "POSITION",
    "READING",
    "WIDTH",
    "Coder",
    "adapt_counter",
    "adapted_counter",
    "clamp_probability",
    "code_adaptive_bit",
    "code_bit",
    "code_number",
    "code_signed",
    "counter_probability",
    "finish_writing",
    "overrun",
    "start_reading",
    "start_writing",
]

LOW, WIDTH, POSITION, LIMIT, READING = 0, 1, 2, 3, 4
CODER_SIZE = 5
"""Places in the state of a coder, and their number."""

MASK32 = 0xFFFFFFFF
"""The interval has 32 bits. As all that follows but `NO_LIMIT`, it is part of the format (docs/coding.md)."""
BOTTOM = 1 << 24
"""Width below which a byte is moved out: what a probability of 16 bits divides has 24 at least."""
MAX_OVERRUN = 4
"""Bytes that a reader takes beyond those that were written: as many as the interval has."""
NO_LIMIT = 1 << 62
"""More bytes than any writer has."""

MIN_PROBABILITY = 32
"""Of 65536: a bit costs at least 1/1419 of a bit, so a payload cannot make a reader work for ever."""
MAX_PROBABILITY = 65536 - MIN_PROBABILITY
COUNTER_START = 1 << 31
"""Even odds, and no bit seen."""
EVEN = 1 << 15
"""Even odds, of 65536."""
COUNTED_BITS = 10
"""Bits of a counter that hold how many bits it has seen; above these are the 22 of its probability."""

MAX_LENGTH = 31
"""Bits of a number below the leading one, at most."""
NUMBER_COUNTERS = 2 * (MAX_LENGTH + 1)
"""Counters of a number: one for each length, and as many for the bit below the leading one."""


class Coder(NamedTuple):
    """What a writer or a reader works on.

    Attributes
    ----------
    state
        (5,) int64: low end of the interval (writing) or distance of the code from it (reading),
        width of the interval, next position in the data, number of valid bytes, direction.
    data
        Bytes written so far and room for more, or all bytes to read.
    """

    state: NDArray[np.int64]
    data: NDArray[np.uint8]


def _reciprocal_table() -> NDArray[np.int32]:
    """Return 65536 / (n + 1.5) for n bits seen, rounded down."""
    n = np.arange(1 << COUNTED_BITS)
    return (2 * 65536 // (2 * n + 3)).astype(np.int32)


RECIPROCAL_TABLE = _reciprocal_table()


@kernel
def start_writing(coder: Coder) -> None:
    """Set a coder to write from position 0 on."""
    coder.state.fill(0)
    coder.state[WIDTH] = MASK32
    coder.state[LIMIT] = NO_LIMIT


@kernel
def start_reading(coder: Coder) -> None:
    """Set a coder to read `data` from its first byte."""
    coder.state[LOW] = 0
    coder.state[WIDTH] = MASK32
    coder.state[POSITION] = 0
    coder.state[LIMIT] = len(coder.data)
    coder.state[READING] = 1
    for _ in range(4):
        coder.state[LOW] = (coder.state[LOW] << 8) | _next_byte(coder)


@lean
def _next_byte(coder: Coder) -> int:
    position = coder.state[POSITION]
    coder.state[POSITION] = position + 1
    if position < coder.state[LIMIT]:
        return np.int64(coder.data[position])
    return np.int64(0)


@lean
def overrun(coder: Coder) -> bool:
    """Tell whether a reading coder has taken more bytes than any writer leaves out."""
    return coder.state[POSITION] > coder.state[LIMIT] + MAX_OVERRUN


@lean
def _carry(coder: Coder) -> None:
    coder.state[LOW] &= MASK32
    position = coder.state[POSITION] - 1
    while coder.data[position] == 255:
        coder.data[position] = 0
        position -= 1
    coder.data[position] += 1


@lean
def code_bit(coder: Coder, bit: int, probability: int) -> int:
    """Write `bit`, or read a bit and return it.

    `probability` of a one is within 1..65535 (of 65536). Writing needs two free bytes in `data`.
    """
    bound = (coder.state[WIDTH] * probability) >> 16
    if coder.state[READING] == 1:
        bit = 1 if coder.state[LOW] < bound else 0
        if bit == 0:
            coder.state[LOW] -= bound
    elif bit == 0:
        coder.state[LOW] += bound
        if coder.state[LOW] > MASK32:
            _carry(coder)
    coder.state[WIDTH] = bound if bit == 1 else coder.state[WIDTH] - bound
    while coder.state[WIDTH] < BOTTOM:
        coder.state[WIDTH] <<= 8
        if coder.state[READING] == 1:
            coder.state[LOW] = (coder.state[LOW] << 8) | _next_byte(coder)
        else:
            coder.data[coder.state[POSITION]] = coder.state[LOW] >> 24
            coder.state[POSITION] += 1
            coder.state[LOW] = (coder.state[LOW] << 8) & MASK32
    return bit


@kernel
def finish_writing(coder: Coder) -> None:
    """Write the fewest bytes that name a point of the last interval when zeros follow them."""
    for count in range(5):
        unit = np.int64(1) << (32 - 8 * count)
        value = (coder.state[LOW] + unit - 1) // unit * unit
        if value < coder.state[LOW] + coder.state[WIDTH]:
            break
    coder.state[LOW] = value
    if value > MASK32:
        _carry(coder)
    for _ in range(count):
        coder.data[coder.state[POSITION]] = coder.state[LOW] >> 24
        coder.state[POSITION] += 1
        coder.state[LOW] = (coder.state[LOW] << 8) & MASK32


@lean
def clamp_probability(probability: int) -> int:
    """Keep a probability (of 65536) away from certainty, so that every bit costs something."""
    return min(max(probability, MIN_PROBABILITY), MAX_PROBABILITY)


@lean
def counter_probability(counter: int) -> int:
    """Return the probability of a one, 0..65535, that a counter stands for."""
    return np.int64(counter) >> 16


@lean
def adapted_counter(value: int, bit: int, limit: int) -> int:
    """Return a counter moved towards `bit` by 1 / (n + 1.5) after n bits; n stops at `limit`."""
    seen = value & ((1 << COUNTED_BITS) - 1)
    probability = value >> COUNTED_BITS
    probability += ((((bit << 22) - bit) - probability) * np.int64(RECIPROCAL_TABLE[seen])) >> 16
    if seen < limit:
        seen += 1
    return (probability << COUNTED_BITS) | seen


@lean
def adapt_counter(counters: NDArray[np.uint32], index: int, bit: int, limit: int) -> None:
    """Replace a counter by the `adapted_counter`."""
    counters[index] = adapted_counter(np.int64(counters[index]), bit, limit)


@lean
def code_adaptive_bit(coder: Coder, bit: int, counters: NDArray[np.uint32], index: int, limit: int) -> int:
    """Code a bit with the probability of one counter and adapt the counter."""
    bit = code_bit(coder, bit, clamp_probability(counter_probability(counters[index])))
    adapt_counter(counters, index, bit, limit)
    return bit


@lean
def code_number(coder: Coder, value: int, counters: NDArray[np.uint32], first: int, limit: int) -> int:
    """Code an integer within 0..2^31 - 2 in adaptive Exp-Golomb form with counters from `first` on.

    The bit length of ``value + 1`` is coded in unary, then its bits below the leading one; the
    first of these is adaptive, the others are equiprobable.
    """
    value += 1
    length = 0
    while length < MAX_LENGTH and code_adaptive_bit(
        coder, 1 if value >> (length + 1) else 0, counters, first + length, limit
    ):
        length += 1
    result = np.int64(1)
    for place in range(length - 1, -1, -1):
        bit = (value >> place) & 1
        if place == length - 1:
            bit = code_adaptive_bit(coder, bit, counters, first + MAX_LENGTH + 1 + length, limit)
        else:
            bit = code_bit(coder, bit, EVEN)
        result = (result << 1) | bit
    return result - 1


@lean
def code_signed(coder: Coder, value: int, counters: NDArray[np.uint32], first: int, limit: int) -> int:
    """Code an integer of either sign: its magnitude as `code_number`, then its sign, equiprobable."""
    magnitude = code_number(coder, abs(value), counters, first, limit)
    if magnitude == 0:
        return 0
    negative = code_bit(coder, 1 if value < 0 else 0, EVEN)
    return -magnitude if negative else magnitude
