# SPDX-License-Identifier: MIT
"""CRC-32C: published values, and the compiled loop against the plain one."""

from __future__ import annotations

import numpy as np
import pytest

from threedvc.formats.container import checksum
from threedvc.formats.container.checksum import crc32c


def crc32c_bit_by_bit(data: bytes) -> int:
    """Divide by the polynomial one bit at a time, as CRC-32C is defined."""
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ (0x82F63B78 if register & 1 else 0)
    return register ^ 0xFFFFFFFF


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", 0x00000000),
        (b"123456789", 0xE3069283),
        (bytes(32), 0x8A9136AA),
        (b"\xff" * 32, 0x62A8AB43),
        (bytes(range(32)), 0x46DD794E),
    ],
)
def test_published_values(data: bytes, expected: int) -> None:
    assert crc32c(data) == expected


@pytest.mark.parametrize("size", [0, 1, 7, 255, 1000])
def test_both_loops_follow_the_definition(size: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    data = rng.bytes(size)
    expected = crc32c_bit_by_bit(data)
    assert crc32c(data) == expected
    monkeypatch.setattr(checksum, "KERNEL_BYTES", 0)
    assert crc32c(data) == expected


def test_long_data_take_the_compiled_loop(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    data = rng.bytes(checksum.KERNEL_BYTES)
    compiled = crc32c(data)
    monkeypatch.setattr(checksum, "KERNEL_BYTES", len(data) + 1)
    assert crc32c(data) == compiled
