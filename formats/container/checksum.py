# SPDX-License-Identifier: MIT
"""CRC-32C (Castagnoli), the checksum of packets.

Short data take a plain loop, so that the head of a file can be checked without loading a compiler;
from `KERNEL_BYTES` on the compiled loop of `threedvc.kernels.coding.checksum` pays.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

__all__ = ["crc32c"]

POLYNOMIAL: Final = 0x82F63B78
"""Of CRC-32C, in reversed order of bits; part of the format."""
KERNEL_BYTES: Final = 4096
"""From so many on the compiled loop pays: less is not worth loading a compiler for."""


def _table_entry(byte: int) -> int:
    for _ in range(8):
        byte = (byte >> 1) ^ (POLYNOMIAL if byte & 1 else 0)
    return byte


TABLE: Final = tuple(_table_entry(byte) for byte in range(256))
"""Remainders of all bytes."""


def crc32c(data: bytes) -> int:
    """Return the CRC-32C of some bytes; that of ``b"123456789"`` is 0xE3069283."""
    if len(data) >= KERNEL_BYTES:
        return _crc32c_compiled(data)
    state = 0xFFFFFFFF
    for byte in data:
        state = (state >> 8) ^ TABLE[(state ^ byte) & 0xFF]
    return state ^ 0xFFFFFFFF


def _crc32c_compiled(data: bytes) -> int:
    from threedvc.kernels.coding.checksum import update_crc32c

    return int(update_crc32c(0xFFFFFFFF, np.frombuffer(data, dtype=np.uint8), _kernel_table())) ^ 0xFFFFFFFF


@cache
def _kernel_table() -> np.ndarray[tuple[int], np.dtype[np.uint32]]:
    return np.array(TABLE, dtype=np.uint32)
