# SPDX-License-Identifier: MIT
"""Which pixels without a measurement are saturated: what comes back, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from threedvc.coding.measured_depth.saturated import SaturatedPixels, pack_saturated
from threedvc.errors import CorruptStream
from threedvc.stream.compressed_payload import compress
from threedvc.stream.wire import ByteReader, pack_varint

SHAPE = (5, 7)


def filmed(count: int, seed: int = 0) -> tuple[list[NDArray[np.uint16]], list[NDArray[np.bool_]]]:
    """Return depths with holes, of which some are saturated."""
    random = np.random.default_rng(seed)
    depths = [(random.integers(0, 3, SHAPE) * 500).astype(np.uint16) for _ in range(count)]
    return depths, [(depth == 0) & (random.random(SHAPE) < 0.5) for depth in depths]


def read(data: bytes, depths: list[NDArray[np.uint16]]) -> list[NDArray[np.bool_]]:
    pixels = SaturatedPixels(ByteReader(data), sum(depth.size for depth in depths))
    found = [pixels.of(depth) for depth in depths]
    pixels.finish()
    return found


@given(st.integers(1, 9), st.integers(0, 1000))
def test_marks_come_back(count: int, seed: int) -> None:
    depths, marks = filmed(count, seed)
    data = pack_saturated(depths, marks)
    np.testing.assert_array_equal(read(data, depths) if data else np.zeros_like(marks), marks)


def test_what_is_measured_is_not_saturated() -> None:
    depths, marks = filmed(2)
    everywhere = [np.ones(SHAPE, dtype=np.bool_), None]
    np.testing.assert_array_equal(read(pack_saturated(depths, everywhere), depths), [depths[0] == 0, marks[1] & False])


def test_without_marks_there_is_nothing() -> None:
    depths, marks = filmed(3)
    assert pack_saturated(depths, [None, None, marks[0] & False]) == b""


def test_marks_that_are_alike_cost_little() -> None:
    depths = [np.zeros((300, 400), dtype=np.uint16)] * 5
    assert len(pack_saturated(depths, [np.ones((300, 400), dtype=np.bool_)] * 5)) < 60


def test_damage_is_noticed() -> None:
    depths, marks = filmed(3)
    data = pack_saturated(depths, marks)
    for size in range(len(data)):
        with pytest.raises(CorruptStream):
            read(data[:size], depths)
    for change, message in ((depths[:2], "of more than there are"), ([*depths, *depths], "not told to the end")):
        with pytest.raises(CorruptStream, match=message):
            read(data, change)


@pytest.mark.parametrize("content", [bytes(14), bytes(1 << 24)])
def test_marks_of_more_pixels_than_there_are_are_refused(content: bytes) -> None:
    data = compress(content)
    with pytest.raises(CorruptStream, match="at most 13 are accepted"):
        SaturatedPixels(ByteReader(pack_varint(len(data)) + data), 3 * 35 - 1)
