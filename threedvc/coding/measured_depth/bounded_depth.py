# SPDX-License-Identifier: MIT
"""Payload of measured depth within a bound of what was filmed: the frames of a group of one sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.entropy.range_coder import RangeCoder, RangeReader, RangeWriter, new_counters
from threedvc.coding.measured_depth.depth_bound import (
    MAX_RAW,
    DepthBound,
    ValueTable,
    candidate_tables,
    distinct_depths,
)
from threedvc.coding.measured_depth.depth_weights import MAX_WEIGHT, WeightFit
from threedvc.errors import ConfigError, CorruptStream, LimitExceeded
from threedvc.kernels.coding.bounded_depth import (
    MASK_ROWS,
    MODELS,
    STEP_ROWS,
    Blend,
    DepthSlice,
    DepthTable,
    SliceModels,
    code_slice,
)
from threedvc.kernels.coding.depth_prediction import BORDER, NEAR_TAPS, TAPS, UNIT, place_ahead
from threedvc.kernels.coding.mixing import UNIT_INPUT
from threedvc.kernels.coding.range_coder import COUNTER_START, NUMBER_COUNTERS
from threedvc.limits import MAX_SEQUENCE_SAMPLES
from threedvc.parallel import for_ranges
from threedvc.stream.wire import ByteReader, pack_varint

__all__ = ["Predict", "decode_depth_frames", "depth_frames", "encode_depth_frames"]

Predict = Callable[[int, NDArray[np.uint16] | None], NDArray[np.uint16] | None]
"""Given the number of a frame in the group and the decoded frame before it (None before the first), return the raw
depths to be expected (h, w), 0 where nothing is known, or None. It must do the same on both sides."""

TABLE_BITS = 15
"""Binary logarithm of the counters of a context: with one more 0.1 % fewer bytes and a tenth more time. All numbers
here but the last five are part of the format."""
FIRST_WEIGHT = 19660
"""Of each context, in 65536ths."""
GAP_CLASSES = 8
"""Gaps of a table that have counters of their own; the greater ones share them."""
MAX_SLICES = 16
"""As many as machines have cores; each takes 1.6 MB of tables."""
ROWS_PER_SLICE = 120
"""Rows of a slice at least: each learns its statistics alone, and half as many cost 1.5 to 6 % more bytes."""
USUAL_SLICES = 8
"""Slices of a frame at most: enough for the cores of most machines."""
BYTES_PER_PIXEL = 40
"""Room for one: 22 decisions at 11 bits each, and a number."""
TRIAL_FRAMES, TRIAL_PART = 3, 3
"""Frames, and part of their rows, on which tables are compared."""


def _new_blend(rows: int) -> Blend:
    """Return models that have seen nothing."""
    weights = np.full((2, rows, MODELS + 1), FIRST_WEIGHT, dtype=np.int32)
    weights[:, :, MODELS] = 0
    inputs = np.zeros(MODELS + 1, dtype=np.int64)
    inputs[MODELS] = UNIT_INPUT
    return Blend(
        np.full((MODELS, 1 << TABLE_BITS), COUNTER_START, dtype=np.uint32),
        weights,
        np.zeros(MODELS, dtype=np.int64),
        inputs,
    )


class _Slice:
    """A part of all frames that is coded for itself, with the models that go on from frame to frame."""

    def __init__(self, first: int, last: int, columns: int) -> None:
        shape = (last - first + BORDER, columns + 2 * BORDER)
        self.first, self.last = first, last
        self.numbers, self.levels, self.misses = (np.zeros(shape, dtype=np.int32) for _ in range(3))
        self.models = SliceModels(
            mask=_new_blend(MASK_ROWS),
            steps=_new_blend(STEP_ROWS),
            certain=new_counters(2),
            rest=new_counters(NUMBER_COUNTERS),
        )

    def code(self, coder: RangeCoder, frame: _Frame, table: DepthTable) -> None:
        wishes = np.ascontiguousarray(frame.wishes[self.first : self.last])
        with_border = slice(self.first, self.last + 2 * BORDER)
        job = DepthSlice(
            wishes=wishes,
            numbers=self.numbers,
            levels=self.levels,
            misses=self.misses,
            ahead=frame.expected.ahead[with_border],
            before=frame.expected.before[with_border],
            measured=frame.expected.measured[with_border],
            weights=frame.weights,
            first=int(frame.expected.first),
        )
        coder.reserve(BYTES_PER_PIXEL * wishes.size)
        if not code_slice(coder.coder, self.models, job, table):
            raise CorruptStream("coded depth ends too early or holds an impossible value; the stream is damaged")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Expected:
    """What is known of a frame before it is coded; see `DepthSlice`."""

    ahead: NDArray[np.int32]
    before: NDArray[np.int32]
    measured: NDArray[np.uint8]
    first: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class _Frame:
    """What the slices of a frame are coded from."""

    wishes: NDArray[np.uint16]
    expected: _Expected
    weights: NDArray[np.int64]


class _Pictures:
    """The state that both sides keep: models of the slices, and the frame before."""

    def __init__(self, values: NDArray[np.int64], height: int, width: int, slices: int) -> None:
        edges = [height * k // slices for k in range(slices + 1)]
        self.slices = [_Slice(a, b, width) for a, b in pairwise(edges)]
        self.raw = np.append(0, values).astype(np.uint16)
        self.places = _places(values)
        self.decoded: NDArray[np.uint16] | None = None
        self.shape = height, width

    def expect(self, foretold: NDArray[np.uint16] | None, threads: int) -> _Expected:
        """Return what is expected of the next frame."""
        height, width = self.shape
        shape = height + 2 * BORDER, width + 2 * BORDER
        measured = np.zeros(shape, dtype=np.uint8)
        if self.decoded is None and foretold is None:
            nothing = np.zeros(shape, dtype=np.int32)
            return _Expected(ahead=nothing, before=nothing, measured=measured, first=True)
        inner = slice(BORDER, -BORDER), slice(BORDER, -BORDER)
        if self.decoded is not None:
            measured[inner] = self.decoded > 0
        levels = np.concatenate([s.levels[BORDER:, BORDER:-BORDER] for s in self.slices])
        before = ahead = np.pad(levels, BORDER, mode="edge")
        if foretold is not None:
            ahead = np.empty(shape, dtype=np.int32)
            for_ranges(lambda a, b: place_ahead(ahead, measured, foretold, self.places, levels, a, b), height, threads)
            ahead = np.pad(ahead[inner], BORDER, mode="edge")
        return _Expected(ahead=ahead, before=before, measured=measured, first=False)

    def code(self, coders: Sequence[RangeCoder], frame: _Frame, table: DepthTable, threads: int) -> None:
        """Code a frame, after which it is the one before."""

        def work(first: int, last: int) -> None:
            for number in range(first, last):
                self.slices[number].code(coders[number], frame, table)

        for_ranges(work, len(self.slices), threads)
        numbers = np.concatenate([s.numbers[BORDER:, BORDER:-BORDER] for s in self.slices])
        self.decoded = np.take(self.raw, numbers)


def _places(values: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return where in the table each raw depth lies (65536,), in 64ths of a step, rounded down."""
    raw = np.arange(MAX_RAW + 1)
    below = np.searchsorted(values, raw, side="right")
    at = np.clip(below, 1, max(len(values) - 1, 1))
    before, after = values[at - 1], values[np.minimum(at, len(values) - 1)]
    part = UNIT * (raw - before) // np.maximum(after - before, 1)
    places: NDArray[np.int32] = np.clip(UNIT * at + part, UNIT, UNIT * len(values)).astype(np.int32)
    return places


def encode_depth_frames(
    frames: Sequence[NDArray[np.uint16]],
    bound: DepthBound,
    predict: Predict | None = None,
    threads: int = 1,
    levels: NDArray[np.int64] | None = None,
) -> bytes:
    """Return the payload of frames of one size.

    Parameters
    ----------
    frames
        (h, w) uint16 raw depths, 0 = not measured.
    bound
        How far decoded depths may lie from them. What is not measured stays so, and nothing else is.
    predict
        See `Predict`.
    threads
        Number of threads; the payload does not depend on it.
    levels
        Sorted distinct depths of the recording, for a bound in levels; without them those of the frames.

    Raises
    ------
    ConfigError
        If there is no frame, they differ in size or are not uint16, there are more than `MAX_SEQUENCE_SAMPLES`, or
        `levels` lack one of their depths.
    """
    _check_frames(frames)
    depths = distinct_depths(iter(frames))
    known = depths if levels is None else np.asarray(levels, dtype=np.int64)
    if not np.isin(depths, known).all():
        raise ConfigError("the levels of a sensor lack depths of its frames; collect them from all frames")
    if len(depths) == 0:
        return _with_length(_head(RangeWriter(), depths, 0, 1, []))
    choices = [_Choice(*found, depths=depths) for found in candidate_tables(bound, known, depths)]
    return _encode(frames, _cheapest(choices, frames, threads), predict, threads)


def _cheapest(choices: list[_Choice], frames: Sequence[NDArray[np.uint16]], threads: int) -> _Choice:
    """Return the table with which a part of the first frames takes the fewest bytes."""
    if len(choices) == 1:
        return choices[0]
    rows = len(frames[0]) // TRIAL_PART
    part = slice(rows, 2 * rows) if rows > 0 else slice(None)
    some, sizes = [frame[part] for frame in frames[:TRIAL_FRAMES]], [0] * len(choices)

    def work(first: int, last: int) -> None:
        for number in range(first, last):
            sizes[number] = len(_encode(some, choices[number], None, 1))

    for_ranges(work, len(choices), threads)
    return choices[sizes.index(min(sizes))]


class _Choice:
    """A table, and which of its numbers may stand for each depth."""

    def __init__(
        self, table: ValueTable, low: NDArray[np.int64], high: NDArray[np.int64], depths: NDArray[np.int64]
    ) -> None:
        self.values = table.values
        self.low, self.high = (np.zeros(MAX_RAW + 1, dtype=np.int64) for _ in range(2))
        self.low[depths], self.high[depths] = low, high
        first, last = (np.zeros(MAX_RAW + 1, dtype=np.int32) for _ in range(2))
        first[depths] = np.searchsorted(table.values, low, side="left") + 1
        last[depths] = np.searchsorted(table.values, high, side="right")
        if (first > last).any():
            raise AssertionError("a depth has no value within its bound")
        self.table = DepthTable(len(table.values), first, last, table.stride, table.memory)

    def check(self, filmed: NDArray[np.uint16], decoded: NDArray[np.uint16]) -> None:
        """Stop if a decoded frame does not keep the bound."""
        wide = decoded.astype(np.int64)
        if not ((wide >= self.low[filmed]) & (wide <= self.high[filmed])).all():
            raise AssertionError("coded depth exceeds its bound")


def _encode(frames: Sequence[NDArray[np.uint16]], choice: _Choice, predict: Predict | None, threads: int) -> bytes:
    height, width = frames[0].shape
    count = min(USUAL_SLICES, max(1, height // ROWS_PER_SLICE))
    pictures = _Pictures(choice.values, height, width, count)
    writers = [RangeWriter() for _ in range(count)]
    fit = WeightFit()
    sent: list[NDArray[np.int64] | None] = []
    for number, wishes in enumerate(frames):
        expected = pictures.expect(_foretold(predict, number, pictures), threads)
        filmed = np.where(wishes > 0, pictures.places[wishes], 0)
        sent.append(fit.update(filmed, expected.ahead, expected.before, expected.first, threads))
        frame = _Frame(wishes=wishes, expected=expected, weights=fit.weights)
        pictures.code(writers, frame, choice.table, threads)
        assert pictures.decoded is not None
        choice.check(wishes, pictures.decoded)
    head = _head(RangeWriter(), choice.values, choice.table.memory, count, sent)
    return b"".join([_with_length(head), *(_with_length(writer.finish()) for writer in writers)])


def _foretold(predict: Predict | None, number: int, pictures: _Pictures) -> NDArray[np.uint16] | None:
    found = None if predict is None else predict(number, pictures.decoded)
    if found is None:
        return None
    if found.shape != pictures.shape or found.dtype != np.uint16:
        raise ConfigError(
            f"a predicted depth map is {found.dtype} of shape {found.shape}, not uint16 of {pictures.shape}"
        )
    return np.ascontiguousarray(found)


def _check_frames(frames: Sequence[NDArray[np.uint16]]) -> None:
    if len(frames) == 0:
        raise ConfigError("a group of depth frames holds none; give at least one")
    for frame in frames:
        if frame.dtype != np.uint16 or frame.ndim != 2 or frame.shape != frames[0].shape or frame.size == 0:
            raise ConfigError(
                f"a depth frame is {frame.dtype} of shape {frame.shape}; all of a group are uint16 and of one size"
            )
    if len(frames) * frames[0].size > MAX_SEQUENCE_SAMPLES:
        raise ConfigError(
            f"{len(frames)} depth frames of {frames[0].shape[1]}x{frames[0].shape[0]} pixels are more than the"
            f" {MAX_SEQUENCE_SAMPLES} samples of a group; make groups shorter"
        )


def _head(
    coder: RangeWriter,
    values: NDArray[np.int64],
    memory: int,
    slices: int,
    weights: Iterable[NDArray[np.int64] | None],
) -> bytes:
    _code_table(coder, values)
    if len(values) > 0:
        _code_settings(coder, memory, slices)
        last = np.zeros(TAPS, dtype=np.int64)
        counters = [new_counters(NUMBER_COUNTERS) for _ in range(2)]
        for new in weights:
            last = _code_weights(coder, counters, last, new)
    return coder.finish()


def _code_table(coder: RangeCoder, values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Code the values: their number, then how far each lies beyond the one before, by how far that did."""
    count = coder.number(len(values), new_counters(NUMBER_COUNTERS))
    coder.check()
    if count > MAX_RAW:
        raise CorruptStream(f"a table of {count} depths cannot be; the stream is damaged")
    counters = [new_counters(NUMBER_COUNTERS) for _ in range(GAP_CLASSES)]
    found = np.zeros(count, dtype=np.int64)
    value, gap = 0, 0
    for at in range(count):
        wish = int(values[at]) - value - 1 if len(values) > 0 else 0
        gap = 1 + coder.number(wish, counters[min(gap, GAP_CLASSES - 1)])
        value += gap
        coder.check()
        if value > MAX_RAW:
            raise CorruptStream(f"a depth of {value} cannot be; the stream is damaged")
        found[at] = value
    return found


def _code_settings(coder: RangeCoder, memory: int, slices: int) -> tuple[int, int]:
    counters = new_counters(NUMBER_COUNTERS)
    memory, slices = coder.number(memory, counters), coder.number(slices, counters)
    coder.check()
    if memory > UNIT or not 1 <= slices <= MAX_SLICES:
        raise CorruptStream(f"coded depth of {slices} slices and memory {memory} is impossible; the stream is damaged")
    return memory, slices


def _code_weights(
    coder: RangeCoder,
    counters: list[NDArray[np.uint32]],
    last: NDArray[np.int64],
    new: NDArray[np.int64] | None,
) -> NDArray[np.int64]:
    """Code whether weights change, and by how much; return them."""
    if not coder.bit(new is not None):
        return last
    found = last.copy()
    for tap in range(TAPS):
        wish = 0 if new is None else int(new[tap] - last[tap])
        found[tap] += coder.signed(wish, counters[0 if tap < NEAR_TAPS else 1])
    coder.check()
    if (np.abs(found) > MAX_WEIGHT).any():
        raise CorruptStream("weights of coded depth are impossible; the stream is damaged")
    return found


def _with_length(data: bytes) -> bytes:
    return pack_varint(len(data)) + data


def decode_depth_frames(
    payload: bytes, width: int, height: int, count: int, predict: Predict | None = None, threads: int = 1
) -> list[NDArray[np.uint16]]:
    """Return the frames (height, width) of a payload; see `depth_frames`."""
    return list(depth_frames(payload, width, height, count, predict, threads))


def depth_frames(
    payload: bytes, width: int, height: int, count: int, predict: Predict | None = None, threads: int = 1
) -> Iterator[NDArray[np.uint16]]:
    """Yield the frames (height, width) of a payload; each is predicted when it is asked for.

    Raises
    ------
    CorruptStream
        If the payload is damaged.
    LimitExceeded
        If there are more than `MAX_SEQUENCE_SAMPLES`.
    """
    if count * width * height > MAX_SEQUENCE_SAMPLES:
        raise LimitExceeded(
            f"{count} depth frames of {width}x{height} pixels are more than the {MAX_SEQUENCE_SAMPLES} samples accepted"
        )
    reader = ByteReader(payload)
    head = RangeReader(reader.take(reader.varint()))
    values = _code_table(head, np.zeros(0, dtype=np.int64))
    if len(values) == 0:
        head.finish()
        yield from (np.zeros((height, width), dtype=np.uint16) for _ in range(count))
        return
    memory, slices = _code_settings(head, 0, 0)
    if slices > height:
        raise CorruptStream(f"{slices} slices of {height} rows are impossible; the stream is damaged")
    weights = [np.zeros(TAPS, dtype=np.int64)]
    counters = [new_counters(NUMBER_COUNTERS) for _ in range(2)]
    for _ in range(count):
        weights.append(_code_weights(head, counters, weights[-1], None))
    head.finish()
    readers = [RangeReader(reader.take(reader.varint())) for _ in range(slices)]
    if reader.remaining:
        raise CorruptStream(f"{reader.remaining} bytes follow coded depth; the stream is damaged")
    nothing = np.zeros(MAX_RAW + 1, dtype=np.int32)
    table = DepthTable(len(values), nothing, nothing, 1, memory)
    pictures = _Pictures(values, height, width, slices)
    wishes = np.zeros((height, width), dtype=np.uint16)
    for number in range(count):
        expected = pictures.expect(_foretold(predict, number, pictures), threads)
        frame = _Frame(wishes=wishes, expected=expected, weights=weights[number + 1])
        pictures.code(readers, frame, table, threads)
        assert pictures.decoded is not None
        yield pictures.decoded
    for part in readers:
        part.finish()
