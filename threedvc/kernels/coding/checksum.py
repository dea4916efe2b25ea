# SPDX-License-Identifier: MIT
"""CRC-32C over long byte strings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel

__all__ = ["update_crc32c"]


@kernel
def update_crc32c(state: int, data: NDArray[np.uint8], table: NDArray[np.uint32]) -> int:
    """Return the CRC register after the bytes of `data`.

    Parameters
    ----------
    state
        Register before the first byte, of 32 bits.
    data
        (n,) bytes.
    table
        (256,) register after each byte value, starting from 0.
    """
    register = np.int64(state)
    for byte in data:
        register = (register >> 8) ^ np.int64(table[(register ^ byte) & 0xFF])
    return int(register)
