# SPDX-License-Identifier: MIT
"""Depth within a bound: what comes back, what is refused, and that a slow reader finds the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from reference.bounded_depth import read_depth
from threedvc.coding.entropy.range_coder import RangeWriter, new_counters
from threedvc.coding.measured_depth.bounded_depth import Predict, decode_depth_frames, encode_depth_frames
from threedvc.coding.measured_depth.depth_bound import (
    BoundKind,
    DepthBound,
    coarse_values,
    distinct_depths,
    fine_values,
)
from threedvc.errors import ConfigError, CorruptStream, LimitExceeded
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS
from threedvc.limits import MAX_SEQUENCE_SAMPLES
from threedvc.stream.wire import pack_varint

Raw = NDArray[np.uint16]
LOSSLESS = DepthBound(kind=BoundKind.LOSSLESS)
LEVEL = DepthBound(kind=BoundKind.LEVEL)
BOUNDS = [
    LOSSLESS,
    LEVEL,
    DepthBound(kind=BoundKind.ABSOLUTE, size=5),
    DepthBound(kind=BoundKind.ABSOLUTE, size=0.4),
    DepthBound(kind=BoundKind.RELATIVE, size=0.01),
]


def filmed(height: int = 24, width: int = 30, count: int = 3, step: int = 3, seed: int = 0) -> list[Raw]:
    """A slanted wall and a box before it that moves, with noise, steps of a sensor, and holes."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    frames = []
    for number in range(count):
        depth = 900 + 4 * x + 2.5 * y
        depth[height // 3 : height // 2 + 1, width // 4 + number : width // 2 + number] = 500
        depth += random.normal(0, 2, depth.shape)
        depth[random.random(depth.shape) < 0.03] = 0
        depth[:, : width // 10] = 0
        frames.append((np.rint(depth / step) * step).astype(np.uint16))
    return frames


def decoded(payload: bytes, frames: list[Raw], predict: Predict | None = None, threads: int = 1) -> list[Raw]:
    height, width = frames[0].shape
    return decode_depth_frames(payload, width, height, len(frames), predict, threads)


def assert_within(
    bound: DepthBound, frames: list[Raw], found: list[Raw], levels: NDArray[np.int64] | None = None
) -> None:
    known = distinct_depths(iter(frames)) if levels is None else levels
    low, high = np.zeros(65536, dtype=np.int64), np.zeros(65536, dtype=np.int64)
    if len(known):
        low[known], high[known] = bound.limits(known)
    for frame, other in zip(frames, found, strict=True):
        assert other.dtype == np.uint16
        assert ((frame > 0) == (other > 0)).all()
        assert ((low[frame] <= other) & (other <= high[frame])).all()


def foretelling(number: int, before: Raw | None) -> Raw | None:
    """What came before, one column on, with a hole."""
    if before is None:
        return None
    found = np.roll(before, 1, axis=1)
    found[: number + 1, 3:6] = 0
    return found


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("predict", [None, foretelling])
def test_frames_come_back_within_the_bound(bound: DepthBound, predict: Predict | None) -> None:
    frames = filmed()
    found = decoded(encode_depth_frames(frames, bound, predict), frames, predict)
    assert_within(bound, frames, found)
    if bound.kind is BoundKind.LOSSLESS or bound.size == 0.4:
        assert all((a == b).all() for a, b in zip(frames, found, strict=True))


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros((5, 7), dtype=np.uint16),
        np.full((5, 7), 65535, dtype=np.uint16),
        np.full((1, 1), 1, dtype=np.uint16),
        np.array([[0, 65535, 1, 0, 7]], dtype=np.uint16),
        np.array([[3], [0], [65535], [65534]], dtype=np.uint16),
        np.arange(4096, dtype=np.uint16).reshape(64, 64)[:, ::2],
    ],
    ids=["empty", "full", "pixel", "row", "column", "many levels"],
)
@pytest.mark.parametrize("bound", BOUNDS)
def test_odd_frames_come_back(frame: Raw, bound: DepthBound) -> None:
    frames = [frame, frame[::-1, ::-1]]
    assert_within(bound, frames, decoded(encode_depth_frames(frames, bound), frames))


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 9),
    st.integers(1, 9),
    st.lists(st.sampled_from([0, 1, 2, 500, 501, 502, 507, 512, 900, 65530, 65535]), min_size=1, max_size=11),
    st.sampled_from(BOUNDS),
    st.integers(0, 1000),
)
def test_any_frames_come_back(height: int, width: int, values: list[int], bound: DepthBound, seed: int) -> None:
    random = np.random.default_rng(seed)
    frames = [random.choice(values, (height, width)).astype(np.uint16) for _ in range(3)]
    assert_within(bound, frames, decoded(encode_depth_frames(frames, bound, foretelling), frames, foretelling))


@pytest.mark.parametrize("bound", [LOSSLESS, LEVEL])
def test_threads_and_slices_change_nothing(bound: DepthBound) -> None:
    frames = filmed(260, 12, 2)
    payload = encode_depth_frames(frames, bound, foretelling, 3)
    assert payload == encode_depth_frames(frames, bound, foretelling, 1)
    one, two = (decoded(payload, frames, foretelling, threads) for threads in (1, 3))
    assert all((a == b).all() for a, b in zip(one, two, strict=True))
    assert_within(bound, frames, one)


@pytest.mark.parametrize("bound", [LOSSLESS, BOUNDS[2]])
@pytest.mark.parametrize("predict", [None, foretelling])
def test_a_slow_reader_finds_the_same(bound: DepthBound, predict: Predict | None) -> None:
    frames = filmed(20, 26, 3, seed=1)
    frames[1][3:6, 9:20] = 60000
    payload = encode_depth_frames(frames, bound, predict)
    found = decoded(payload, frames, predict)
    slow = read_depth(payload, 26, 20, 3, predict)
    assert all((a == b).all() for a, b in zip(found, slow, strict=True))


def test_a_slow_reader_finds_the_same_in_slices() -> None:
    frames = filmed(240, 5, 2)
    payload = encode_depth_frames(frames, LEVEL, foretelling)
    slow = read_depth(payload, 5, 240, 2, foretelling)
    assert all((a == b).all() for a, b in zip(decoded(payload, frames, foretelling), slow, strict=True))


def test_a_first_frame_may_be_foretold() -> None:
    frames = filmed(count=2)
    truth = frames[0].copy()
    truth[:9] = 0

    def predict(number: int, before: Raw | None) -> Raw | None:
        return truth if before is None else None

    payload = encode_depth_frames(frames, LOSSLESS, predict)
    assert len(payload) < len(encode_depth_frames(frames, LOSSLESS))
    found = decoded(payload, frames, predict)
    slow = read_depth(payload, 30, 24, 2, predict)
    assert all((a == b).all() and (a == c).all() for a, b, c in zip(frames, found, slow, strict=True))


def test_levels_are_those_of_the_recording() -> None:
    frames = [np.array([[100, 130, 0]], dtype=np.uint16)]
    levels = np.array([90, 100, 110, 120, 130, 150])
    found = decoded(encode_depth_frames(frames, LEVEL, levels=levels), frames)
    assert_within(LEVEL, frames, found, levels)
    with pytest.raises(ConfigError, match="lack depths"):
        encode_depth_frames(frames, LEVEL, levels=levels[:-2])


def test_what_repeats_and_what_is_foretold_costs_little() -> None:
    frame = filmed(120, 160, 1)[0]
    one, many = (len(encode_depth_frames([frame] * count, LOSSLESS)) for count in (1, 6))
    assert many < 1.4 * one
    assert len(encode_depth_frames([frame], LEVEL)) < 0.7 * one


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([], "holds none"),
        ([np.zeros((3, 4), dtype=np.float32)], "float32"),
        ([np.zeros((3, 4), dtype=np.uint16), np.zeros((4, 3), dtype=np.uint16)], r"\(4, 3\)"),
        ([np.zeros((0, 4), dtype=np.uint16)], r"\(0, 4\)"),
    ],
)
def test_other_frames_are_refused(frames: list[Raw], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        encode_depth_frames(frames, LOSSLESS)


def test_too_many_samples_are_refused() -> None:
    frame = np.broadcast_to(np.uint16(1), (1 << 12, 1 << 12))
    with pytest.raises(ConfigError, match=str(MAX_SEQUENCE_SAMPLES)):
        encode_depth_frames([frame] * 5, LOSSLESS)
    with pytest.raises(LimitExceeded, match=str(MAX_SEQUENCE_SAMPLES)):
        decode_depth_frames(b"", 1 << 12, 1 << 12, 5)


def test_a_map_of_another_size_is_refused() -> None:
    with pytest.raises(ConfigError, match="predicted"):
        encode_depth_frames(filmed(), LOSSLESS, lambda number, before: np.zeros((2, 2), dtype=np.uint16))


@pytest.mark.parametrize("size", [-1.0, float("nan"), 1.0])
def test_impossible_bounds_are_refused(size: float) -> None:
    with pytest.raises(ConfigError, match="bound"):
        DepthBound(kind=BoundKind.RELATIVE, size=size)


def test_damaged_payloads_are_noticed_or_decode() -> None:
    frames = filmed()
    payload = encode_depth_frames(frames, LEVEL)
    random = np.random.default_rng(3)
    noticed = 0
    for _ in range(150):
        damaged = bytearray(payload)
        for at in random.integers(0, len(payload), 2):
            damaged[at] = random.integers(256)
        try:
            found = decoded(bytes(damaged), frames)
        except CorruptStream:
            noticed += 1
        else:
            assert len(found) == 3
    assert noticed > 50


def test_cut_and_lengthened_payloads_are_noticed() -> None:
    frames = filmed()
    payload = encode_depth_frames(frames, LOSSLESS)
    for end in range(0, len(payload), 7):
        with pytest.raises(CorruptStream):
            decoded(payload[:end], frames)
    with pytest.raises(CorruptStream, match="follow"):
        decoded(payload + b"\0", frames)


@pytest.mark.parametrize("fill", [0, 85, 255])
def test_short_payloads_cause_no_long_work(fill: int) -> None:
    hostile = bytes([20]) + bytes([fill]) * 20 + bytes([4]) + bytes([fill]) * 4
    with pytest.raises(CorruptStream):
        decode_depth_frames(hostile, 4096, 4096, 4)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ([65536], "a table of 65536 depths"),
        ([2, 9, 65535], "a depth of 65546"),
        ([1, 9, 65, 1], "memory 65"),
        ([1, 9, 12, 0], "coded depth of 0 slices"),
        ([1, 9, 12, 17], "coded depth of 17 slices"),
        ([1, 9, 12, 3], "3 slices of 2 rows"),
    ],
)
def test_heads_that_lie_are_noticed(numbers: list[int], message: str) -> None:
    head = RangeWriter()
    count, *rest = numbers
    head.number(count, new_counters(NUMBER_COUNTERS))
    gap, gaps = 0, [new_counters(NUMBER_COUNTERS) for _ in range(8)]
    for value in rest[:count]:
        head.number(value, gaps[min(gap, 7)])
        gap = value + 1
    settings = new_counters(NUMBER_COUNTERS)
    for value in rest[count:]:
        head.number(value, settings)
    data = head.finish()
    with pytest.raises(CorruptStream, match=message):
        decode_depth_frames(pack_varint(len(data)) + data, 4, 2, 1)


@pytest.mark.parametrize("bound", BOUNDS[2:])
def test_tables_have_a_value_for_every_depth(bound: DepthBound) -> None:
    depths = np.unique(np.random.default_rng(5).integers(1, 3000, 400))
    low, high = bound.limits(depths)
    for values in (fine_values(depths, low, high), coarse_values(low, high)):
        assert (np.diff(values) > 0).all()
        assert (np.searchsorted(values, low) < np.searchsorted(values, high, side="right")).all()
    assert len(coarse_values(low, high)) <= len(depths)
