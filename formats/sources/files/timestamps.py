# SPDX-License-Identifier: MIT
"""Timestamps in int64 nanoseconds.

Stamps in decimal seconds go through `decimal`, never through float64, which keeps only about 200 ns of
a Unix time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from itertools import pairwise
from statistics import median

from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import DEFAULT_FPS
from threedvc.units import NANOSECONDS

__all__ = [
    "INT64_LIMIT",
    "UNITS",
    "Clock",
    "Rate",
    "check_intervals",
    "clock_of",
    "fps_of_stamps",
    "parse_nanoseconds",
    "parse_stamp",
    "rate_of",
    "regular_stamp",
    "to_nanoseconds",
    "unit_of",
]

INT64_LIMIT = 1 << 63
"""Stamps are signed 64-bit numbers in the stream."""
UNITS = {"seconds": NANOSECONDS, "milliseconds": NANOSECONDS // 1000, "microseconds": 1000, "nanoseconds": 1}
"""In nanoseconds."""
SHORTEST_NS, LONGEST_NS = NANOSECONDS // 1000, 5 * NANOSECONDS
"""Intervals between frames that make sense: a fast camera's, and those of a recording in steps of seconds."""
COUNTED = 10**7
"""Stamps from here on are no numbers of frames: four days at 30 frames a second."""
TYPICAL_NS = NANOSECONDS // 30
"""Interval of most cameras: where several units fit, the one that comes nearest to it is meant."""
INDEX_STEP = 2
"""Whole numbers that rise by this or less, from a small one on, count frames; they are no clock's."""
SAME_RATE = 0.05
"""Cameras keep their nominal rate within a few per cent."""


def parse_stamp(text: str) -> Decimal:
    """Turn a decimal number such as ``1305031102.175304`` into a stamp, in a unit that `unit_of` finds.

    Raises
    ------
    ValueError
        If the text is not a finite decimal number within 64 bits.
    """
    try:
        stamp = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"{text!r} is not a time in seconds within 292 years") from None
    if not stamp.is_finite() or abs(stamp) >= INT64_LIMIT:
        raise ValueError(f"{text!r} is not a time in seconds within 292 years")
    return stamp


def parse_nanoseconds(text: str) -> int:
    """Turn integer nanoseconds into an integer; raises ValueError for anything else, a decimal point too."""
    try:
        stamp = int(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a time in integer nanoseconds") from None
    if abs(stamp) >= INT64_LIMIT:
        raise ValueError(f"{text!r} does not fit 64-bit nanoseconds")
    return stamp


def regular_stamp(index: int, fps: float) -> int:
    """Return the stamp of frame `index` of a regular clock that starts at 0, rounded to a nanosecond."""
    return round(Fraction(index * NANOSECONDS) / Fraction(fps))


def to_nanoseconds(stamp: Decimal, unit: str | None, fps: float) -> int:
    """Turn a stamp into nanoseconds, exactly; one without a unit counts the frames of a regular clock."""
    return regular_stamp(int(stamp), fps) if unit is None else int((stamp * UNITS[unit]).to_integral_value())


def unit_of(stamps: Sequence[Decimal], meant: str) -> str | None:
    """Return the unit that stamps are in, by the intervals that frames of a video can have.

    Parameters
    ----------
    stamps
        In order of time.
    meant
        The unit that the format asks for, one of `UNITS`; it is kept where it makes sense, or where nothing else does.

    Returns
    -------
    str or None
        None for stamps that count frames.
    """
    steps = [later - earlier for earlier, later in pairwise(stamps) if later > earlier]
    whole = all(stamp == stamp.to_integral_value() for stamp in stamps)
    if not steps:
        return meant
    step = median(steps)
    if whole and step <= INDEX_STEP and abs(stamps[0]) < COUNTED:
        return None
    largest = max(abs(stamps[0]), abs(stamps[-1]))
    fitting = [
        unit
        for unit, ticks in UNITS.items()
        if SHORTEST_NS <= step * ticks <= LONGEST_NS and largest * ticks < INT64_LIMIT
    ]
    if meant in fitting or not fitting:
        return meant
    return min(fitting, key=lambda unit: max(step * UNITS[unit] / TYPICAL_NS, TYPICAL_NS / (step * UNITS[unit])))


@dataclass(frozen=True)
class Rate:
    """The frame rate of a recording, and what was decided about it."""

    fps: float
    notices: tuple[Notice, ...] = ()


def rate_of(stamps: Sequence[int], told: float | None, place: str) -> Rate:
    """Settle the frame rate of a recording with time stamps: what was told, if the stamps agree with it.

    Parameters
    ----------
    stamps
        Times of the frames in nanoseconds.
    told
        Rate by the user or the recording, or None.
    place
        File of the stamps, for messages.
    """
    duration = stamps[-1] - stamps[0] if stamps else 0
    if duration <= 0:
        return Rate(told or DEFAULT_FPS)
    # Two frames at one time are no sign of a faster camera: one has the stamp of the other, or is there twice.
    distinct, counted = ((count - 1) * NANOSECONDS / duration for count in (len(set(stamps)), len(stamps)))
    mean = round(distinct, 3) or distinct
    nominal = told or fps_of_stamps(stamps, mean)
    if any(abs(nominal - rate) <= SAME_RATE * rate for rate in (mean, counted)):
        return Rate(nominal)
    if told is None or abs(told - fps_of_stamps(stamps, mean)) <= SAME_RATE * told:
        return Rate(mean)  # some frames were lost
    text = f"{place}: its stamps are those of {mean:g} frames per second, not {told:g}; the stamps are used"
    return Rate(mean, (Notice(text, warning=True),))


@dataclass(frozen=True)
class Clock:
    """Times (ns) of the frames' depth and color pictures, the color's None where it is the same, and the rate."""

    stamps: Sequence[tuple[int, int | None]]
    fps: float
    notices: tuple[Notice, ...] = ()


def clock_of(stamps: Sequence[tuple[int, int | None]], count: int, told: float | None, place: str) -> Clock:
    """Return the clock of stamps, or a regular one of `count` frames where there are none; see `rate_of`."""
    if not stamps:
        fps = told or DEFAULT_FPS
        return Clock([(regular_stamp(index, fps), None) for index in range(count)], fps)
    rate = rate_of([stamp for stamp, _ in stamps], told, place)
    return Clock(stamps, rate.fps, rate.notices)


def check_intervals(stamps: Sequence[int], place: str) -> list[Notice]:
    """Return a doubt about times (nanoseconds) that are no video's."""
    steps = [later - earlier for earlier, later in pairwise(stamps)]
    typical = median(steps) if steps else SHORTEST_NS
    if SHORTEST_NS / 5 <= typical <= LONGEST_NS:
        return []
    between = f"{typical / NANOSECONDS:.3g} s" if typical >= SHORTEST_NS else f"{typical:g} ns"
    return [Notice(f"{place}: {between} between frames; check the unit of the times, or give --fps", warning=True)]


def fps_of_stamps(stamps: Sequence[int], default: float) -> float:
    """Return the frame rate that the median interval of increasing stamps stands for, to three decimals."""
    intervals = [later - earlier for earlier, later in pairwise(stamps)]
    typical = median(intervals) if intervals else 0
    return round(NANOSECONDS / typical, 3) if typical > 0 else default
