# SPDX-License-Identifier: MIT
"""Timestamps in int64 nanoseconds.

Stamps in decimal seconds go through `decimal`, never through float64, which keeps only about 200 ns of
a Unix time.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from itertools import pairwise
from statistics import median

from threedvc.frame import NANOSECONDS

__all__ = ["fps_of_stamps", "parse_nanoseconds", "parse_seconds", "regular_stamp"]

INT64_LIMIT = 1 << 63


def parse_seconds(text: str) -> int:
    """Turn decimal seconds such as ``1305031102.175304`` into nanoseconds.

    Raises
    ------
    ValueError
        If the text is not a finite decimal number or leaves the range of int64 nanoseconds.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"{text!r} is not a time in seconds") from None
    if not seconds.is_finite() or abs(seconds) * NANOSECONDS >= INT64_LIMIT:
        raise ValueError(f"{text!r} is not a time in seconds within 292 years")
    return int((seconds * NANOSECONDS).to_integral_value())


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


def fps_of_stamps(stamps: Sequence[int], default: float) -> float:
    """Return the frame rate that the median interval of increasing stamps stands for, to three decimals."""
    intervals = [later - earlier for earlier, later in pairwise(stamps)]
    typical = median(intervals) if intervals else 0
    return round(NANOSECONDS / typical, 3) if typical > 0 else default
