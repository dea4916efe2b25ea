# SPDX-License-Identifier: MIT
"""Types of values that stand in packet headers.

A header field declares its key in the stream and its type. The declaration serves the writer, the
reader and the check of docs/format.md alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from threedvc.errors import ConfigError
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import is_rigid

__all__ = ["FieldType", "bitmap", "blob", "camera", "extrinsic", "flag", "integer", "key", "names", "number", "text"]

CAMERA_NUMBERS = 11
"""Width and height, focal lengths, principal point, and the five coefficients of the lens that OpenCV has."""
EXTRINSIC_NUMBERS = 12
"""Three rows of four: the fourth of a rigid transform is always 0, 0, 0, 1."""


@dataclass(frozen=True)
class FieldType:
    """Values that a header field may have.

    Attributes
    ----------
    description
        The type in words, as it stands in docs/format.md.
    read
        Returns the value in its Python type; raises ValueError if it is not of this type.
    """

    description: str
    read: Callable[[Any], Any]


def key(name: str, field_type: FieldType, **options: Any) -> Any:
    """Declare a header field, its key in the stream and its type."""
    return field(metadata={"key": name, "type": field_type}, **options)


def integer(low: int, high: int) -> FieldType:
    """Return the type of integers from `low` to `high`, both included."""

    def read(value: Any) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise ValueError
        return value

    return FieldType(f"int {low}..{high}", read)


def number(low: float, high: float) -> FieldType:
    """Return the type of finite numbers from `low` to `high`, both included."""

    def read(value: Any) -> float:
        result = _finite(value)
        if not low <= result <= high:
            raise ValueError
        return result

    return FieldType(f"float {low:g}..{high:g}", read)


def flag() -> FieldType:
    """Return the type of yes or no."""

    def read(value: Any) -> bool:
        if not isinstance(value, bool):
            raise ValueError
        return value

    return FieldType("bool", read)


def text(longest: int) -> FieldType:
    """Return the type of texts of up to `longest` bytes of UTF-8."""

    def read(value: Any) -> str:
        if not isinstance(value, str) or len(value.encode()) > longest:
            raise ValueError
        return value

    return FieldType(f"str up to {longest} bytes", read)


def names(most: int, longest: int) -> FieldType:
    """Return the type of lists of up to `most` texts of up to `longest` bytes."""
    item = text(longest)

    def read(value: Any) -> tuple[str, ...]:
        if not isinstance(value, list | tuple) or len(value) > most:
            raise ValueError
        return tuple(item.read(one) for one in value)

    return FieldType(f"list of up to {most} str up to {longest} bytes", read)


def blob(size: int) -> FieldType:
    """Return the type of byte strings of `size` bytes."""

    def read(value: Any) -> bytes:
        if not isinstance(value, bytes) or len(value) != size:
            raise ValueError
        return value

    return FieldType(f"bin of {size} bytes", read)


def bitmap(longest: int) -> FieldType:
    """Return the type of byte strings of up to `longest` bytes."""

    def read(value: Any) -> bytes:
        if not isinstance(value, bytes) or len(value) > longest:
            raise ValueError
        return value

    return FieldType(f"bin of up to {longest} bytes", read)


def camera(*, optional: bool = False) -> FieldType:
    """Return the type of ``width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3`` that make a `Camera`."""

    def read(value: Any) -> tuple[float, ...]:
        numbers = _numbers(value, CAMERA_NUMBERS, optional)
        if numbers:
            _check_camera(numbers)
        return numbers

    return FieldType(f"list of {'0 or ' if optional else ''}{CAMERA_NUMBERS} float", read)


def extrinsic() -> FieldType:
    """Return the type of the first three rows of a rigid transform, or of an empty list."""

    def read(value: Any) -> tuple[float, ...]:
        numbers = _numbers(value, EXTRINSIC_NUMBERS, optional=True)
        if numbers and not is_rigid(np.array([*numbers, 0.0, 0.0, 0.0, 1.0]).reshape(4, 4)):
            raise ValueError
        return numbers

    return FieldType(f"list of 0 or {EXTRINSIC_NUMBERS} float", read)


def _finite(value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError
    return float(value)


def _numbers(value: Any, length: int, optional: bool) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or not (len(value) == length or (optional and not value)):
        raise ValueError
    return tuple(_finite(one) for one in value)


def _check_camera(numbers: tuple[float, ...]) -> None:
    width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3 = numbers
    if not (width.is_integer() and height.is_integer()):
        raise ValueError
    try:
        Camera(width=int(width), height=int(height), fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3))
    except ConfigError:
        raise ValueError from None
