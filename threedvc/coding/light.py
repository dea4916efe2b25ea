# SPDX-License-Identifier: MIT
"""Payload of the light on an object: eight factors of one byte."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import CorruptStream
from threedvc.kernels.render.shading import LIGHT_TERMS

__all__ = ["pack_light", "unpack_light"]

UNIT = 1 / 64
"""Unit of factors: a byte with a sign reaches 2 with it. Part of the format."""
MAX_UNITS = 127
"""What a factor can be on either side of 0."""


def pack_light(factors: NDArray[np.float64]) -> bytes:
    """Return the payload of factors (8,), rounded to 1/64 and clamped to +-2."""
    return np.clip(np.rint(factors / UNIT), -MAX_UNITS, MAX_UNITS).astype(np.int8).tobytes()


def unpack_light(payload: bytes) -> NDArray[np.float64]:
    """Return the factors (8,) float64 of a payload.

    Raises
    ------
    CorruptStream
        If it is not of eight bytes.
    """
    if len(payload) != LIGHT_TERMS:
        raise CorruptStream(f"a LIGHT has {len(payload)} bytes instead of {LIGHT_TERMS}; the stream is damaged")
    return np.frombuffer(payload, dtype=np.int8).astype(np.float64) * UNIT
