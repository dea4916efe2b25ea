# SPDX-License-Identifier: MIT
"""What the numbers in the file names of a folder mean: the number of a frame, or its time.

Groups of digits are columns. A column that is the same in all names says nothing (``take1_rgb_0001.png``). What is left
is a frame's number, or a time: decimal seconds (``5.033.png``), seconds and nanoseconds (``1700000000_033333333.png``),
or integers that only make sense as nano-, micro- or milliseconds of a video.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from math import gcd
from pathlib import Path
from statistics import mean, median
from typing import TypeAlias

from threedvc.errors import SequenceError
from threedvc.formats.sources.notices import Notice
from threedvc.units import NANOSECONDS

__all__ = ["Key", "NamedPictures", "doubt_of_steps", "in_unit_of", "named_pictures", "ticks_of", "times_in"]

Key: TypeAlias = tuple[int, ...]

DECIMAL = re.compile(r"\d+\.\d+|\d+")
WHOLE = re.compile(r"\d+")
DATE = re.compile(
    r"(?<!\d)(?P<year>(?:19|20)\d\d)[-_.]?(?P<month>\d\d)[-_.]?(?P<day>\d\d)[-_. T]?"
    r"(?P<hour>\d\d)[-_.:]?(?P<minute>\d\d)[-_.:]?(?P<second>\d\d)(?:[-_.,](?P<part>\d{1,9}))?(?!\d)"
)
DATE_UNITS = ("year", "month", "day", "hour", "minute", "second")
MILLISECOND_NS = NANOSECONDS // 1000
"""Nanoseconds."""
UNITS = {NANOSECONDS: "seconds", MILLISECOND_NS: "milliseconds", 1_000: "microseconds", 1: "nanoseconds"}
"""Names of units, by their nanoseconds."""
SHORTEST_NS, LONGEST_NS = NANOSECONDS // 500, 2 * NANOSECONDS
"""Intervals between frames that make a video: 500 frames a second to one in two seconds; a factor of 1000, so that one
unit fits at most."""
INT64_LIMIT = 1 << 63
"""Stamps are signed 64-bit numbers in the stream."""
EPOCH_S = (10**9, 43 * 10**8)
"""Seconds since 1970 of the years 2001 to 2106: no recording has as many frames."""
EPOCH_STEP_S = 5
"""Steps of such numbers up to which they are seconds; larger ones are milliseconds of a clock that runs for days."""
CLOCK_STEP = 1000
"""Steps of a frame's number that are this large would be a recording that kept every thousandth frame."""
MIN_MILLISECONDS = 8
"""Milliseconds of 120 frames a second are 8 and 9 apart; faster cameras cannot be told from left-out frames."""
JITTER = 0.2
"""Part of its interval by which a tick may be off, or of a multiple where frames were lost."""
REGULAR_SHARE = 0.9
"""Of the ticks that must be within it: one of ten may be late."""
RATES = (5, 6, 7.5, 10, 12, 12.5, 15, 20, 24, 25, 30, 45, 48, 50, 60, 75, 90, 100, 120)
"""Usual rates of cameras, in frames a second, and those of recordings that keep every second or third frame."""
SAME_RATE = 0.03
"""By which a rate may differ from a usual one: stamps in milliseconds round 30 frames a second to 33 ms."""
LARGEST_STRIDE = 30
"""Recordings are thinned to a frame a second, rarely further."""
NANOSECOND_DIGITS, MICROSECOND_DIGITS = 9, 6
"""Of a number after a point that counts nanoseconds, or microseconds."""


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
    unit
        What the names are in, ``seconds`` for example; the numbers of names with a decimal point are nanoseconds.
    numbered
        Whether the names have numbers; else the files are in order of their names, and their numbers are places in it.
    """

    folder: Path
    pictures: dict[Key, Path]
    unit_ns: int | None = None
    unit: str | None = None
    numbered: bool = True

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
        If the names do not tell two files apart, or several numbers in them could be that of the frame.
    """
    decimals = _decimal_times(paths)
    if decimals is not None:
        stamps, unit_ns = decimals
        return NamedPictures(folder, _by_key(paths, [(stamp,) for stamp in stamps]), 1, UNITS[unit_ns])
    keys = _telling_columns(paths, [tuple(map(int, WHOLE.findall(path.stem))) for path in paths])
    if len(paths) > 1 and not any(keys):
        words = [WHOLE.sub("0", path.stem) for path in paths]
        places = {word: (place,) for place, word in enumerate(sorted(set(words)))}
        return NamedPictures(folder, _by_key(paths, [places[word] for word in words]), numbered=False)
    pictures = _by_key(paths, keys)
    whole_ns = ticks_of([key[0] for key in pictures]) if all(len(key) == 1 for key in pictures) else None
    return NamedPictures(folder, pictures, whole_ns, None if whole_ns is None else UNITS[whole_ns])


def in_unit_of(pictures: NamedPictures, other: NamedPictures) -> NamedPictures:
    """Return pictures whose whole numbers may be times too, taken for times in the unit of another folder's.

    Few times can look like numbers with left-out frames, 0 40 80, where those of the other folder cannot.
    """
    unit = other.unit_ns
    if pictures.unit_ns is not None or unit is None or other.unit != UNITS[unit] or not pictures.numbered:
        return pictures
    numbers = [key[0] for key in pictures.pictures if len(key) == 1]
    steps = [later - earlier for earlier, later in pairwise(numbers)]
    if len(numbers) < len(pictures.pictures) or (steps and not SHORTEST_NS <= median(steps) * unit <= LONGEST_NS):
        return pictures
    return replace(pictures, unit_ns=unit, unit=other.unit)


def doubt_of_steps(pictures: NamedPictures) -> Notice | None:
    """Return a doubt about frames' numbers that step as regularly as milliseconds of a usual rate: 0 100 200."""
    numbers = [key[0] for key in pictures.pictures if len(key) == 1]
    steps = [later - earlier for earlier, later in pairwise(numbers)]
    step = min(steps, default=0)
    if step <= LARGEST_STRIDE or not _is_usual(step) or any(each % step for each in steps):
        return None
    first, second = list(pictures.pictures.values())[:2]
    return Notice(
        f"{pictures.folder}: the names step by {step} ({first.name}, {second.name}) and are taken for frame numbers; "
        f"if they are milliseconds ({1000 / step:.3g} frames a second), rename the files to seconds (0.000.png, "
        f"{step / 1000:.3f}.png)",
        warning=True,
    )


def times_in(name: str, unit: str) -> list[int]:
    """Return the times in nanoseconds that the numbers in a name can be, in a unit such as ``seconds``."""
    unit_ns = next(each for each, called in UNITS.items() if called == unit)
    return [int((Decimal(number) * unit_ns).to_integral_value()) for number in DECIMAL.findall(name)]


def ticks_of(numbers: Sequence[int]) -> int | None:
    """Return the nanoseconds of a step if increasing numbers are times, None if they count frames.

    Numbers that are neither large nor far apart count frames, with gaps where some were left out; but those that step
    as a clock does whose milliseconds were rounded, 0 33 67 100, are milliseconds.
    """
    steps = [later - earlier for earlier, later in pairwise(numbers) if later > earlier]
    if not steps:
        return None
    if numbers[-1] >= EPOCH_S[0] or median(steps) >= CLOCK_STEP:
        return _fitting_unit(median(steps), numbers[-1])
    return MILLISECOND_NS if _is_clock_of_milliseconds(steps) else None


def _fitting_unit(step: float | Decimal, largest: int | Decimal) -> int | None:
    """Return the unit in nanoseconds in which a typical step is the interval of a video's frames."""
    if EPOCH_S[0] <= largest < EPOCH_S[1] and step <= EPOCH_STEP_S and step * NANOSECONDS >= SHORTEST_NS:
        return NANOSECONDS
    fitting = (unit for unit in UNITS if SHORTEST_NS <= step * unit <= LONGEST_NS and largest * unit < INT64_LIMIT)
    return next(fitting, None)


def _is_clock_of_milliseconds(steps: Sequence[int]) -> bool:
    """Tell whether steps are those of a camera's clock: nearly regular, at a usual rate, but not in whole strides."""
    typical = median(steps)
    if typical < MIN_MILLISECONDS or len(steps) < 2 or gcd(*steps) > max(1, typical / 2):
        return False
    tolerance = max(1.0, JITTER * typical)
    near = [step for step in steps if abs(step - max(1, round(step / typical)) * typical) <= tolerance]
    if len(near) < REGULAR_SHARE * len(steps):
        return False
    interval = mean(step / max(1, round(step / typical)) for step in near)
    return _is_usual(interval)


def _is_usual(interval_ms: float) -> bool:
    return any(abs(1000 / interval_ms - rate) <= SAME_RATE * rate for rate in RATES)


def _by_key(paths: Sequence[Path], keys: Sequence[Key]) -> dict[Key, Path]:
    pictures: dict[Key, Path] = {}
    for key, path in sorted(zip(keys, paths, strict=True), key=lambda each: (each[0], each[1].name)):
        other = pictures.setdefault(key, path)
        if other is not path:
            raise SequenceError(f"{path}: no number in its name tells it from {other.name}; keep one of the two")
    return pictures


def _telling_columns(paths: Sequence[Path], keys: Sequence[Key]) -> list[Key]:
    """Return the number of each name that is its frame's: the one that is not the same in all; () where none is."""
    if len(keys) < 2:
        return list(keys)
    usual = max(Counter(map(len, keys)).items(), key=lambda each: (each[1], each[0]))[0]
    for path, key in zip(paths, keys, strict=True):
        if len(key) != usual:
            alike = next(other for other, each in zip(paths, keys, strict=True) if len(each) == usual)
            raise SequenceError(
                f"{path}: has {_count(len(key))} in its name, but {alike.name} has {_count(usual)}: which one is the "
                "frame's? name all alike, or move what is no frame elsewhere"
            )
    columns = [column for column in zip(*keys, strict=True) if len(set(column)) > 1]
    if len(columns) > 1:
        return [(number,) for number in _one_of(paths, columns)]
    return list(zip(*columns, strict=True)) if columns else [() for _ in keys]


def _count(numbers: int) -> str:
    return "one number" if numbers == 1 else f"{numbers or 'no'} numbers"


def _one_of(paths: Sequence[Path], columns: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
    """Return the times, else the first, of several columns that put the files in one order."""
    order = sorted(range(len(paths)), key=lambda row: columns[0][row])
    for column in columns:
        if any(column[later] <= column[earlier] for earlier, later in pairwise(order)):
            first, last = paths[order[0]], paths[order[-1]]
            raise SequenceError(
                f"{last}: {len(columns)} numbers change from name to name ({first.name}, {last.name}): which one "
                "is the frame's? rename the files to one number (000012.png)"
            )
    return next((each for each in columns if ticks_of([each[row] for row in order]) is not None), columns[0])


def _decimal_times(paths: Sequence[Path]) -> tuple[list[int], int] | None:
    """Return the times in nanoseconds of files that are named by decimal numbers, and the unit of these."""
    column = _dates(paths) or _decimals(paths)
    if column is None or _counts(column):
        return None
    stamps = [Decimal(number) for number in column]
    steps = [later - earlier for earlier, later in pairwise(sorted(stamps)) if later > earlier]
    unit = _fitting_unit(median(steps), max(stamps)) if steps else None
    if unit is None:
        return None
    return [int((stamp * unit).to_integral_value()) for stamp in stamps], unit


def _decimals(paths: Sequence[Path]) -> Sequence[str] | None:
    """Return the decimal number of each name, if that is all that changes in them."""
    found = [DECIMAL.findall(path.stem) for path in paths]
    if len(found) < 2 or len({len(numbers) for numbers in found}) != 1:
        return None
    telling = [column for column in zip(*found, strict=True) if len(set(column)) > 1]
    if len(telling) == 2 and _are_seconds_and_parts(*telling):
        return [f"{whole}.{part}" for whole, part in zip(*telling, strict=True)]
    return telling[0] if len(telling) == 1 and any("." in number for number in telling[0]) else None


def _dates(paths: Sequence[Path]) -> Sequence[str] | None:
    """Return the seconds since 1970 of names that have a date and a time of day, ``2026-11-30_12-30-05.033``."""
    matches = [DATE.search(path.stem) for path in paths]
    if len(matches) < 2 or len({len(match["part"] or "") for match in matches if match}) != 1:
        return None
    seconds = []
    for match in matches:
        if match is None or (match["part"] is None and match["hour"] == "00"):
            return None  # After a date, 000012 is rather a frame's number than twelve seconds past midnight.
        try:
            moment = datetime(*(int(match[unit]) for unit in DATE_UNITS), tzinfo=UTC)  # type: ignore[misc, arg-type]
        except ValueError:
            return None
        seconds.append(f"{int(moment.timestamp())}.{match['part'] or '0'}")
    return seconds if len(set(seconds)) > 1 else None


def _are_seconds_and_parts(whole: Sequence[str], parts: Sequence[str]) -> bool:
    """Tell whether two columns are those of a stamp: seconds, and nano- or microseconds of a fixed number of digits."""
    digits = {len(part) for part in parts}
    if any("." in number for number in (*whole, *parts)) or any(number[0] == "0" != number for number in whole):
        return False
    since_epoch = all(EPOCH_S[0] <= int(number) < EPOCH_S[1] for number in whole)
    return digits == {NANOSECOND_DIGITS} or (digits == {MICROSECOND_DIGITS} and since_epoch)


def _counts(numbers: Sequence[str]) -> bool:
    """Tell whether what follows the points is a counter: ``shot2.0001``, ``shot2.0002``."""
    parts = [number.partition(".") for number in numbers]
    if len({whole for whole, _, _ in parts}) != 1 or not all(part for _, _, part in parts):
        return False
    counters = sorted(int(part) for _, _, part in parts)
    return median(later - earlier for earlier, later in pairwise(counters)) <= 1
