# SPDX-License-Identifier: MIT
"""A slow, obvious reader of coded depth: docs/coding.md in plain Python, with dictionaries for tables."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from math import exp, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference.coding import ExactCounter

Grid = dict[tuple[int, int], int]
HASH_MODULUS = 1 << 47


def pair(a: int, b: int) -> int:
    return ((a * 0x2545F491 + b) * 0x9E3779B1) % HASH_MODULUS


def stretch(p: int) -> int:
    q = (p // 16 + 0.5) / 4096
    return max(-2047, min(2047, round(256 * log(q / (1 - q)))))


def squash(x: int) -> int:
    return round(65536 / (1 + exp(-max(-2047, min(2047, x)) / 256)))


class Bits:
    """The reader of a range-coded payload."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at, self.width = data, 4, 2**32 - 1
        self.code = int.from_bytes(data[:4].ljust(4, b"\0"), "big")

    def read(self, p: int) -> int:
        bound = self.width * p >> 16
        bit = int(self.code < bound)
        self.code, self.width = (self.code, bound) if bit else (self.code - bound, self.width - bound)
        while self.width < 1 << 24:
            self.width <<= 8
            self.code = self.code << 8 | (self.data[self.at] if self.at < len(self.data) else 0)
            self.at += 1
        return bit

    def adaptive(self, counter: ExactCounter) -> int:
        bit = self.read(counter.probability)
        counter.adapt(bit, 255)
        return bit

    def number(self, counters: defaultdict[int, ExactCounter]) -> int:
        length = 0
        while length < 31 and self.adaptive(counters[length]):
            length += 1
        value = 1
        for place in range(length - 1, -1, -1):
            value = 2 * value + (self.adaptive(counters[32 + length]) if place == length - 1 else self.read(32768))
        return value - 1

    def signed(self, counters: defaultdict[int, ExactCounter]) -> int:
        size = self.number(counters)
        return -size if size and self.read(32768) else size


def fresh() -> defaultdict[int, ExactCounter]:
    return defaultdict(ExactCounter)


class Blend:
    """Mixed bits of six contexts and two sets of weights."""

    def __init__(self) -> None:
        self.tables: list[defaultdict[int, ExactCounter]] = [fresh() for _ in range(6)]
        self.weights: defaultdict[tuple[int, int], list[int]] = defaultdict(lambda: [19660] * 6 + [0])

    def read(self, bits: Bits, hashes: list[int], one: int, two: int) -> int:
        counters = [t[(h >> 8) % 32768] for t, h in zip(self.tables, hashes, strict=True)]
        inputs = [stretch(min(c.value >> 6, 65535)) if c.seen else 0 for c in counters] + [256]
        rows = self.weights[0, one], self.weights[1, two]
        opinions = [sum(i * w for i, w in zip(inputs, row, strict=True)) >> 16 for row in rows]
        bit = bits.read(min(max(squash(sum(opinions) >> 1), 32), 65504))
        for row, opinion in zip(rows, opinions, strict=True):
            for k in range(7):
                row[k] += (inputs[k] * (65535 * bit - squash(opinion)) * 6 + 2**17) >> 18
        for counter in counters:
            counter.adapt(bit, 255)
        return bit


def steps_of(difference: int) -> int:
    return min(max((difference + 32) >> 6, -2), 2) + 2


def fine(difference: int) -> int:
    size = sum(abs(difference) > limit for limit in (8, 24, 40, 64, 96, 160, 320, 800))
    return 8 + size if difference >= 0 else 8 - size


class SliceReader:
    """Rows first..last of all frames."""

    def __init__(self, data: bytes, first: int, last: int, width: int, size: int, memory: int) -> None:
        self.bits, self.first, self.last, self.width = Bits(data), first, last, width
        self.size, self.memory = size, memory
        self.mask, self.steps = Blend(), Blend()
        self.certain, self.rest = fresh(), fresh()

    def frame(
        self, ahead: Grid, known: Grid, before: Grid, last: Grid, weights: list[int], start: bool
    ) -> tuple[Grid, Grid]:
        """Return numbers and levels; `ahead` and `last` have the border, the others are 0 where nothing is told."""
        self.numbers: defaultdict[tuple[int, int], int] = defaultdict(int)
        self.misses: defaultdict[tuple[int, int], int] = defaultdict(int)
        self.ahead, self.known, self.before, self.old = ahead, known, before, last
        top = self.first
        self.levels: Grid = {(y, x): ahead[y, x] for y in range(top - 3, top) for x in range(-3, self.width + 3)}
        for y in range(top, self.last):
            self.levels |= {(y, x): self.levels[y - 1, 0] for x in (-3, -2, -1)}
            for x in range(self.width):
                self.pixel(y, x, weights, start and y == top)
            self.levels |= {(y, self.width + i): self.levels[y, self.width - 1] for i in range(3)}
            if start and y == top:
                self.levels |= {(y - j, x): self.levels[y, x] for j in (1, 2, 3) for x in range(-3, self.width + 3)}
        return self.numbers, self.levels

    def middle(self, y: int, x: int) -> int:
        left, above = self.levels[y, x - 1], self.levels[y - 1, x]
        return sorted([left, above, left + above - self.levels[y - 1, x - 1]])[1]

    def pixel(self, y: int, x: int, weights: list[int], plain: bool) -> None:
        middle = self.middle(y, x)
        taps = [self.levels[y, x - i] for i in (1, 2, 3)]
        taps += [self.levels[y - j, x + i] for j in (1, 2, 3) for i in range(-3, 4)]
        taps += [self.ahead[y + j, x + i] for j in (-1, 0, 1) for i in (-1, 0, 1)]
        taps += [self.ahead[y, x + 2], self.ahead[y + 2, x]]
        taps += [self.old[y + j, x + i] for j, i in ((0, 0), (-1, 0), (0, -1), (0, 1), (1, 0))]
        total = sum(min(max(tap - middle, -256), 256) * w for tap, w in zip(taps, weights, strict=True))
        guess = self.levels[y, x - 1] if plain else middle + ((total + 256) >> 9)
        guess = min(max(guess, 64), 64 * self.size)
        if not self.presence(y, x):
            self.levels[y, x], self.misses[y, x] = guess, 1
            return
        nearest = (guess + 32) >> 6
        number = nearest + self.read_steps(y, x, guess, nearest)
        self.numbers[y, x], self.misses[y, x] = number, min(abs(number - nearest), 15)
        self.levels[y, x] = 64 * number + min(max(guess - 64 * number, -self.memory), self.memory)

    def presence(self, y: int, x: int) -> int:
        places = [(0, -1), (-1, 0), (-1, -1), (-1, 1), (0, -2), (-2, 0), (-1, 2)]
        near = sum(2**k for k, (j, i) in enumerate(places) if self.numbers[y + j, x + i])
        around = [self.before.get((y + j, x + i), 0) for j in (-1, 0, 1) for i in (-1, 0, 1)]
        before, says = int("".join(map(str, around)), 2), self.known.get((y, x), 0)
        if (near, before, says) in ((127, 511, 1), (0, 0, 0)):
            return self.bits.adaptive(self.certain[near & 1])
        hashes = [
            pair(near, says),
            pair(near & 15, before),
            pair(near & 15, x >> 3),
            pair(near, before & 63),
            pair(near, around[1] * 8 + around[3] * 4 + around[4] * 2 + says),
            pair(near, before),
        ]
        return self.mask.read(self.bits, hashes, near, before)

    def read_steps(self, y: int, x: int, guess: int, nearest: int) -> int:
        place, fraction = 64 * nearest, guess - 64 * nearest + 32
        if not self.decision(y, x, place, fraction, 0):
            return 0
        back = self.decision(y, x, place, fraction, 1)
        sign, count = -1 if back else 1, 1
        while self.decision(y, x, place + 64 * sign * count, fraction, 2 * min(count + 1, 7) - 2 + back):
            count += 1
            if count == 20:
                return sign * (20 + self.bits.number(self.rest))
        return sign * count

    def decision(self, y: int, x: int, place: int, fraction: int, kind: int) -> int:
        def near(j: int, i: int) -> int:
            return steps_of(self.levels[y + j, x + i] - place)

        left, above, corner, right = near(0, -1), near(-1, 0), near(-1, -1), near(-1, 1)
        both, levels = kind * 25 + left * 5 + above, self.levels
        guess = fine(self.ahead[y, x] - place)
        slope = fine(2 * levels[y, x - 1] - levels[y, x - 2] - place)
        hashes = [
            pair((both * 5 + corner) * 5 + right, near(0, -2) * 5 + near(-2, 0)),
            pair((both * 5 + right) * 5 + near(-1, 2), near(-2, 1) * 5 + near(-2, 0)),
            pair(both * 5 + right, guess * 4 + 2 * self.known.get((y, x), 0) + (fraction >> 5)),
            pair(kind, (place >> 6) * 8 + (fraction >> 3)),
            pair((both * 5 + corner) * 5 + near(0, -2), near(0, -3) * 5 + near(-1, -2)),
            pair(kind * 64 + fraction, fine(self.middle(y, x) - place) * 17 + slope),
        ]
        return self.steps.read(self.bits, hashes, kind * 8 + self.noise(y, x), kind * 16 + (fraction >> 2))

    def noise(self, y: int, x: int) -> int:
        places = [(0, -1, 2), (-1, 0, 2), (-1, 1, 1), (-1, -1, 1), (0, -2, 1), (-2, 0, 1)]
        total = sum(weight * min(self.misses[y + j, x + i], 7) for j, i, weight in places)
        return total if total < 4 else 4 + sum(total >= limit for limit in (6, 9, 16))


def varint(data: bytes) -> tuple[int, bytes]:
    value = shift = 0
    for at, byte in enumerate(data):
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, data[at + 1 :]
    raise ValueError("a varint does not end")


def read_depth(
    payload: bytes, width: int, height: int, count: int, predict: Callable[[int, Any], Any] | None
) -> list[NDArray[np.uint16]]:
    """Return the frames of a payload."""
    size, rest = varint(payload)
    head, rest = Bits(rest[:size]), rest[size:]
    total, counters, values = head.number(fresh()), [fresh() for _ in range(8)], [0]
    gap = 0
    for _ in range(total):
        gap = 1 + head.number(counters[min(gap, 7)])
        values.append(values[-1] + gap)
    if total == 0:
        return [np.zeros((height, width), dtype=np.uint16) for _ in range(count)]
    settings = fresh()
    memory, slices = head.number(settings), head.number(settings)
    near, far = fresh(), fresh()
    weights = [[0] * 40]
    for _ in range(count):
        last = weights[-1]
        new = head.read(32768)
        weights.append([w + head.signed(near if k < 24 else far) for k, w in enumerate(last)] if new else last)
    readers = []
    for k in range(slices):
        size, rest = varint(rest)
        edges = height * k // slices, height * (k + 1) // slices
        readers.append(SliceReader(rest[:size], *edges, width, total, memory))
        rest = rest[size:]
    return _frames(readers, values, weights[1:], (height, width), predict)


def _place(values: list[int], raw: int) -> int:
    total = len(values) - 1
    if raw <= values[1] or raw >= values[total]:
        return 64 if raw <= values[1] else 64 * total
    at = max(k for k in range(1, total + 1) if values[k] <= raw)
    return 64 * at + 64 * (raw - values[at]) // (values[at + 1] - values[at])


def _frames(
    readers: list[SliceReader],
    values: list[int],
    weights: list[list[int]],
    shape: tuple[int, int],
    predict: Callable[[int, Any], Any] | None,
) -> list[NDArray[np.uint16]]:
    height, width = shape
    frames: list[NDArray[np.uint16]] = []
    levels: Grid = {}
    border = [(y, x) for y in range(-3, height + 3) for x in range(-3, width + 3)]
    for number in range(len(weights)):
        foretold = predict(number, frames[-1] if frames else None) if predict else None
        known: Grid = {}
        inner: Grid = {}
        for y in range(height):
            for x in range(width):
                raw = int(foretold[y, x]) if foretold is not None else 0
                known[y, x] = int(raw > 0)
                inner[y, x] = _place(values, raw) if raw else levels.get((y, x), 0)
        nearest = {(y, x): (min(max(y, 0), height - 1), min(max(x, 0), width - 1)) for y, x in border}
        ahead = {at: inner[nearest[at]] for at in border}
        last = {at: levels.get(nearest[at], 0) for at in border}
        before = {(y, x): int(frames[-1][y, x] > 0) for y in range(height) for x in range(width)} if frames else {}
        levels, frame = {}, np.zeros(shape, dtype=np.uint16)
        for reader in readers:
            start = number == 0 and foretold is None
            numbers, found = reader.frame(ahead, known, before, last, weights[number], start)
            levels |= {at: found[at] for at in found if reader.first <= at[0] < reader.last and 0 <= at[1] < width}
            for at, value in numbers.items():
                if value:
                    frame[at] = values[value]
        frames.append(frame)
    return frames
