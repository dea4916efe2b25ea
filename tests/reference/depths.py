# SPDX-License-Identifier: MIT
"""Slow, obvious versions of the kernels of depth pictures: dictionaries of samples, every cell of a box looked at."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from reference.coding import ExactCoder, ExactCounter, write_number

Place = tuple[int, int]
JUMP = 16
MOST = 1 << 20


def apart(a: int, b: int) -> bool:
    """Tell whether two samples lie on different surfaces."""
    return abs(a - b) * JUMP > min(a, b)


class DepthWriter:
    """Writes a picture as docs/coding.md tells, without its head."""

    def __init__(
        self, coder: ExactCoder, wishes: NDArray[np.int64], steps: Sequence[int], dead_zone: int, complete: bool
    ) -> None:
        self.coder, self.steps, self.dead_zone, self.complete = coder, steps, dead_zone, complete
        self.wishes = {(y, x): int(v) for (y, x), v in np.ndenumerate(wishes)}
        self.rows, self.columns = wishes.shape
        self.values: dict[Place, int] = {}
        self.residuals: dict[Place, int] = {}
        self.modes: dict[Place, int] = {}
        self.counters: dict[tuple[object, ...], ExactCounter] = {}
        self.numbers: dict[object, dict[int, ExactCounter]] = {}
        self.last = MOST // 2

    def run(self) -> dict[Place, int]:
        """Write everything; return the samples as decoded."""
        h = 1 << (len(self.steps) - 1)
        for y in range(0, self.rows, h):
            for x in range(0, self.columns, h):
                self.root(y, x, h)
        for level in reversed(range(len(self.steps) - 1)):
            h = 1 << level
            for y in range(0, self.rows, 2 * h):
                for x in range(h, self.columns, 2 * h):
                    self.between((y, x), (0, h), (y - 2 * h, x), level)
            for y in range(h, self.rows, 2 * h):
                for x in range(0, self.columns, h):
                    self.between((y, x), (h, 0), (y, x - h), level)
        return self.values

    def bit(self, value: bool, *context: object) -> bool:
        counter = self.counters.setdefault(context, ExactCounter())
        self.coder.write(int(value), counter.probability)
        counter.adapt(int(value), 255)
        return value

    def number(self, value: int, context: object) -> None:
        write_number(self.coder, self.numbers.setdefault(context, {}), value, 255)

    def there(self, place: Place, around: Sequence[Place], beside: Place) -> bool:
        if self.complete:
            return True
        context = sum(self.values.get(other, 0) > 0 for other in around), self.values.get(beside, 0) > 0
        return self.bit(self.wishes[place] > 0, "there", *context)

    def quantized(self, place: Place, guess: int, step: int, dead_zone: int) -> int:
        away = self.wishes[place] - guess
        if 256 * abs(away) < dead_zone * step:
            return 0
        return int(math.copysign((2 * abs(away) + step) // (2 * step), away))

    def settle(self, place: Place, value: int) -> None:
        self.values[place] = self.last = min(max(value, 1), MOST)

    def root(self, y: int, x: int, h: int) -> None:
        left, above, corner = (self.values.get(place, 0) for place in ((y, x - h), (y - h, x), (y - h, x - h)))
        if not self.there((y, x), [(y, x - h), (y - h, x)], (y - h, x - h)):
            return
        guess = left or above or self.last
        if left and above and corner:
            guess = left + above - corner
        units = self.quantized((y, x), guess, self.steps[-1], 0)
        self.number(2 * units - 1 if units > 0 else -2 * units, "root")
        self.settle((y, x), guess + units * self.steps[-1])

    def onward(self, near: int, far: int) -> int:
        return near if not far or apart(near, far) else max(near + (near - far) // 2, 1)

    def bent(self, far: int, near: int, other: int) -> bool:
        return abs(far - 2 * near + other) * JUMP > min(near, other) if far else apart(near, other)

    def between(self, place: Place, d: Place, beside: Place, level: int) -> None:
        (y, x), (dy, dx) = place, d
        far_a, a, b, far_b = (self.values.get((y + k * dy, x + k * dx), 0) for k in (-3, -1, 1, 3))
        if not self.there(place, [(y - dy, x - dx), (y + dy, x + dx)], beside):
            return
        mode, edge = 0, False
        if a and b:
            guesses = [(a + b + 1) // 2, self.onward(a, far_a), self.onward(b, far_b)]
            edge = self.bent(far_a, a, b) and self.bent(far_b, b, a)
            mode = self.mode(place, guesses, level, self.modes.get(beside, 0)) if edge else 0
            guess = guesses[mode]
        else:
            guess = self.onward(a, far_a) if a else self.onward(b, far_b) if b else self.last
        self.modes[place] = mode
        near, before = (self.residuals.get(other, 0) for other in (beside, (y - 2 * dy, x - 2 * dx)))
        ends = sum(abs(self.residuals.get((y + k * dy, x + k * dx), 0)) for k in (-1, 1))
        energy = 2 * (abs(near) + abs(before)) + ends
        around = energy if energy < 3 else 3 if energy < 6 else 4 if energy < 12 else 5
        units = self.quantized(place, guess, self.steps[level], self.dead_zone)
        if self.bit(units != 0, "zero", min(level, 3), around, edge):
            self.number(abs(units) - 1, around)
            self.bit(units < 0, "sign", np.sign(2 * near + before))
        self.residuals[place] = units
        self.settle(place, guess + units * self.steps[level])

    def mode(self, place: Place, guesses: list[int], level: int, like: int) -> int:
        errors = [abs(self.wishes[place] - guess) for guess in guesses]
        mode = errors.index(min(errors)) if 2 * errors[0] > self.steps[level] else 0
        if self.bit(mode != 0, "mode", like):
            self.bit(mode == 2, "side", like)
        return mode


class DepthLayer:
    """The cells that a depth picture shows, each found by looking at all samples that may speak for it."""

    def __init__(
        self, samples: NDArray[np.int64], unit: float, lens: Sequence[float], pose: NDArray[np.float64], size: float
    ) -> None:
        self.samples, self.unit, self.lens, self.pose, self.size = samples, unit, lens, pose, size
        self.rows, self.columns = samples.shape

    def sample(self, y: int, x: int) -> int:
        return int(self.samples[y, x]) if 0 <= y < self.rows and 0 <= x < self.columns else 0

    def smooth(self, y: int, x: int) -> bool:
        a, b, c, d = (self.sample(y + k // 2, x + k % 2) for k in range(4))
        return min(a, b, c, d) > 0 and not any(apart(*pair) for pair in ((a, b), (c, d), (a, c), (b, d)))

    def tilt(self, y: int, x: int, dy: int, dx: int) -> float:
        here = self.sample(y, x)
        known = []
        for sign in (-1, 1):
            other = self.sample(y + sign * dy, x + sign * dx)
            if other and not apart(here, other):
                known.append(sign * (other - here))
        return sum(known) / len(known) if known else 0.0

    def relief(self, cell: Sequence[int], levels: int) -> int:
        """Return the relief of a cell, 0 if no surface passes it."""
        point = self.pose[:3, :3] @ ((np.array(cell) + 0.5) * self.size) + self.pose[:3, 3]
        if point[2] <= 0:
            return 0
        slopes = point[:2] / point[2]
        u, v = self.lens[0] * slopes[0] + self.lens[2], self.lens[1] * slopes[1] + self.lens[3]
        for y in range(self.rows):
            for x in range(self.columns):
                found = self.surface(y, x, u, v)
                if found is not None and (relief := self.level(point, slopes, found, levels)):
                    return relief
        return 0

    def surface(self, y: int, x: int, u: float, v: float) -> tuple[float, float, float] | None:
        """Return what sample (y, x) says of the inverse depth at a place, and of its slopes; None: nothing."""
        here = self.sample(y, x)
        margin = 0.5 + 1.5 * self.size * max(self.lens[:2]) * here * self.unit
        if not here or not (-margin <= u <= self.columns - 1 + margin and -margin <= v <= self.rows - 1 + margin):
            return None
        ny, nx = (min(max(math.floor(w + 0.5), 0), n - 1) for w, n in ((v, self.rows), (u, self.columns)))
        mine = (ny, nx) == (y, x)
        y0, x0 = math.floor(v), math.floor(u)
        if self.smooth(y0, x0):
            if not mine:
                return None
            f, g = u - x0, v - y0
            a, b, c, d = (self.sample(y0 + k // 2, x0 + k % 2) for k in range(4))
            top, bottom = a + (b - a) * f, c + (d - c) * f
            return top + (bottom - top) * g, (b - a) * (1 - g) + (d - c) * g, (c - a) * (1 - f) + (d - b) * f
        nearest = self.sample(ny, nx)
        if not mine and not (max(abs(u - x), abs(v - y)) <= 1 and here < nearest and apart(here, nearest)):
            return None
        across, down = self.tilt(y, x, 0, 1), self.tilt(y, x, 1, 0)
        value = here + across * (u - x) + down * (v - y)
        return (value, across, down) if value > here / 2 else None

    def level(
        self, point: NDArray[np.float64], slopes: NDArray[np.float64], found: tuple[float, float, float], levels: int
    ) -> int:
        w, across, down = (value * self.unit for value in found)
        normal = np.array([across * self.lens[0], down * self.lens[1], 0])
        normal[2] = w - normal[0] * slopes[0] - normal[1] * slopes[1]
        turned = self.pose[:3, :3].T @ normal
        axis = int(np.argmax(np.abs(turned)))
        height = (1 - point[2] * w) / (turned[axis] * self.size) + 0.5
        level = min(max(math.floor(height * levels), 0), levels - 1)
        return 1 + 8 * axis + level if -1 / 8 <= height < 9 / 8 else 0
