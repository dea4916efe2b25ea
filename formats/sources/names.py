# SPDX-License-Identifier: MIT
"""What the numbers in the file names of a folder mean: the number of a frame, or its time.

Groups of digits are columns. A column that is the same in all names says nothing (``take1_rgb_0001.png``). What is left
is a frame's number, or a time: decimal seconds (``5.033.png``), or integers that only make sense as nano-, micro- or
milliseconds of a video.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from math import gcd
from pathlib import Path
from statistics import median
from typing import TypeAlias

from threedvc.errors import SequenceError
from threedvc.frame import NANOSECONDS

__all__ = ["Key", "NamedPictures", "named_pictures", "ticks_of", "unit_name"]

Key: TypeAlias = tuple[int, ...]

DECIMAL = re.compile(r"\d+\.\d+|\d+")
WHOLE = re.compile(r"\d+")
UNITS = {1: "nanoseconds", 1_000: "microseconds", 1_000_000: "milliseconds", NANOSECONDS: "seconds"}
SHORTEST_NS, LONGEST_NS = NANOSECONDS // 1000, 2 * NANOSECONDS
"""Intervals between frames that make a video: 1000 frames a second to one in two seconds."""
TYPICAL_NS = NANOSECONDS // 30
CLOCK_DIGITS = 10
"""Seconds since 1970 have ten digits: no recording has as many frames."""
CLOCK_STEP = 1000
"""Steps of a frame's number that are this large would be a recording that kept every thousandth frame."""
LEAST_MILLISECONDS = 8
"""Milliseconds that are rounded step by two neighbouring numbers in turns: 33 and 34, at most 8 and 9."""


@dataclass(frozen=True, eq=False)
class NamedPictures:
    """The pictures of a folder in the order that their names tell.

    Attributes
    ----------
    folder
        Where they are.
    pictures
        By their numbers, in order: one number each where one tells them apart.
    unit_ns
        Nanoseconds that a step of the number stands for, where the names are times; None where they are not.
    """

    folder: Path
    pictures: dict[Key, Path]
    unit_ns: int | None = None

    @property
    def times_ns(self) -> list[int]:
        """Times of the pictures in nanoseconds; only where the names are times."""
        assert self.unit_ns is not None
        return [key[0] * self.unit_ns for key in self.pictures]


def named_pictures(folder: Path, paths: Sequence[Path]) -> NamedPictures:
    """Order the files of a folder by what their names say.

    Raises
    ------
    SequenceError
        If the names do not tell two files apart.
    """
    seconds = _decimal_seconds(paths)
    if seconds is not None:
        return NamedPictures(folder, _by_key(paths, [(stamp,) for stamp in seconds]), 1)
    keys = _telling_columns([tuple(map(int, WHOLE.findall(path.stem))) for path in paths])
    pictures = _by_key(paths, keys)
    single = all(len(key) == 1 for key in pictures)
    return NamedPictures(folder, pictures, ticks_of([key[0] for key in pictures]) if single else None)


def ticks_of(numbers: Sequence[int]) -> int | None:
    """Return the nanoseconds of a step if increasing numbers are times, None if they count frames.

    Numbers that are neither large nor far apart count frames, with gaps where some were left out; but those that step
    by two neighbouring numbers in turns, 0 33 67 100, are rounded milliseconds.
    """
    steps = [later - earlier for earlier, later in pairwise(numbers) if later > earlier]
    if not steps:
        return None
    step = median(steps)
    if numbers[-1] >= 10 ** (CLOCK_DIGITS - 1) or step >= CLOCK_STEP:
        fitting = [unit for unit in UNITS if SHORTEST_NS <= step * unit <= LONGEST_NS]
        return min(fitting, key=lambda unit: max(step * unit / TYPICAL_NS, TYPICAL_NS / (step * unit)), default=None)
    near = min(steps) >= LEAST_MILLISECONDS and max(steps) == min(steps) + 1 and gcd(*steps) == 1
    return NANOSECONDS // 1000 if near and len(steps) > 1 else None


def unit_name(unit_ns: int) -> str:
    """Return what a unit of so many nanoseconds is called."""
    return UNITS[unit_ns]


def _by_key(paths: Sequence[Path], keys: Sequence[Key]) -> dict[Key, Path]:
    pictures: dict[Key, Path] = {}
    for key, path in sorted(zip(keys, paths, strict=True), key=lambda each: (each[0], each[1].name)):
        other = pictures.setdefault(key, path)
        if other is not path:
            raise SequenceError(f"{path}: no number in its name tells it from {other.name}; keep one of the two")
    return pictures


def _telling_columns(keys: Sequence[Key]) -> list[Key]:
    """Return the numbers of each name without those that are the same in all."""
    if len(keys) < 2 or len({len(key) for key in keys}) != 1:
        return list(keys)
    columns = [column for column in zip(*keys, strict=True) if len(set(column)) > 1]
    return list(zip(*columns, strict=True)) if columns else list(keys)


def _decimal_seconds(paths: Sequence[Path]) -> list[int] | None:
    """Return the times in nanoseconds of files that are named by decimal seconds, else None."""
    found = [DECIMAL.findall(path.stem) for path in paths]
    if len(found) < 2 or len({len(numbers) for numbers in found}) != 1:
        return None
    for column in zip(*found, strict=True):
        if any("." in number for number in column) and len(set(column)) > 1:
            stamps = [int((Decimal(number) * NANOSECONDS).to_integral_value()) for number in column]
            steps = [later - earlier for earlier, later in pairwise(sorted(stamps)) if later > earlier]
            if SHORTEST_NS <= median(steps) <= LONGEST_NS:
                return stamps
    return None
