# SPDX-License-Identifier: MIT
"""Values and options that several commands share.

Each parser turns the text of one option into a value. A text that is not of the right form is a
usage error (exit code 2); a value that makes no sense, such as an empty range, is a `ConfigError`
(exit code 1).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from threedvc.errors import ConfigError
from threedvc.formats.layout_names import layout_names

if TYPE_CHECKING:
    from threedvc.config import DepthErrorConfig, RegionOfInterest, SegmentationConfig

__all__ = [
    "OUTPUTS",
    "bit_rate",
    "decoded_outputs",
    "depth_error",
    "duration",
    "focus",
    "force_option",
    "frame_range",
    "frame_span",
    "json_option",
    "length",
    "object_numbers",
    "picture_size",
    "positive_number",
    "reader_options",
    "segmentation",
    "stream_argument",
    "threads_option",
]

F = TypeVar("F", bound=Callable[..., Any])

OUTPUTS = ("color", "depth", "labels")
DECIMAL_EXPONENT = {"": 0, "m": 0, "cm": -2, "mm": -3}
"""Of a unit in meters."""
LENGTH = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*(mm|cm|m|)\s*")
RATE = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*([kKmM]?)\s*")
RATE_EXPONENT = {"": 0, "k": 3, "m": 6}
"""Of a prefix of bits per second."""
DURATION = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*(ms|s|)\s*")
PERCENT = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*")
RANGE = re.compile(r"(\d*):(\d*)(?::(\d*))?")
SIZE = re.compile(r"(\d+)[xX](\d+)")
LABEL_LIMIT = 256
"""Labels are 8 bits."""
OBJECT = re.compile(r"\s*\d{1,3}\s*")
BOUND = r"\s*(-?[\d.]*\d(?:mm|cm|m)?)\s*"
BOX = re.compile(",".join([f"{BOUND}\\.\\.{BOUND}"] * 3))
"""Three ranges, along x, y and z."""


def length(text: str) -> float:
    """Return meters: ``8mm``, ``1cm``, ``0.02m``; a plain number is meters."""
    match = LENGTH.fullmatch(text)
    if match is None:
        raise click.BadParameter(f"{text!r} is not a length; write 8mm, 1cm, 0.02m or a number of meters")
    # By the decimal exponent, because a product such as 7 * 0.001 is not the number 0.007.
    return float(f"{match[1]}e{DECIMAL_EXPONENT[match[2]]}")


def bit_rate(text: str) -> float:
    """Return bits per second: ``24k``, ``1.5M``, ``16000``."""
    match = RATE.fullmatch(text)
    if match is None:
        raise click.BadParameter(f"{text!r} is not a bit rate; write 24k, 1.5M or a number of bits per second")
    return float(f"{match[1]}e{RATE_EXPONENT[match[2].lower()]}")


def duration(text: str) -> float:
    """Return seconds: ``100ms``, ``2s``; a plain number is seconds."""
    match = DURATION.fullmatch(text)
    if match is None:
        raise click.BadParameter(f"{text!r} is not a time; write 100ms, 2s or a number of seconds")
    return float(f"{match[1]}e{-3 if match[2] == 'ms' else 0}")


def depth_error(text: str) -> DepthErrorConfig:
    """Return the bound of ``model``, ``5mm``, ``1%``, ``level`` or ``lossless``."""
    from threedvc.config import DepthErrorConfig, DepthErrorKind

    named = (DepthErrorKind.MODEL, DepthErrorKind.LEVEL, DepthErrorKind.LOSSLESS)
    if text in named:
        return DepthErrorConfig(kind=DepthErrorKind(text))
    if (percent := PERCENT.fullmatch(text)) is not None:
        return DepthErrorConfig(kind=DepthErrorKind.RELATIVE, size=float(f"{percent[1]}e-2"))
    if LENGTH.fullmatch(text) is None:
        raise click.BadParameter(f"{text!r} is no bound; write model, level, lossless, a length such as 5mm, or 1%")
    return DepthErrorConfig(kind=DepthErrorKind.ABSOLUTE, size=length(text))


def positive_number(text: str) -> float:
    """Return a finite number above zero."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise click.BadParameter(f"{text!r} is not a positive number")
    return value


def frame_range(text: str) -> tuple[int | None, int | None, int | None]:
    """Return start, stop and step of ``A:B`` or ``A:B:S`` as in a slice; what is left open is None."""
    match = RANGE.fullmatch(text)
    if match is None:
        raise click.BadParameter(f"{text!r} is not a range of frames; write A:B or A:B:STEP, such as 0:100 or 50:")
    start, stop, step = (int(part) if part else None for part in match.groups())
    return start, stop, step


def frame_span(text: str) -> tuple[int, int | None]:
    """Return the ends of ``A:B``, frames A to B-1; an open end is None."""
    start, stop, step = frame_range(text)
    if step is not None:
        raise click.BadParameter(f"{text!r} has a step; decoding takes A:B")
    if stop is not None and stop <= (start or 0):
        raise ConfigError(f"--frames {text} is empty; the end must be above the start")
    return start or 0, stop


def picture_size(text: str) -> tuple[int, int]:
    """Return width and height in pixels of ``WxH``."""
    match = SIZE.fullmatch(text)
    if match is None:
        raise click.BadParameter(f"{text!r} is not a picture size; write WIDTHxHEIGHT, such as 640x480")
    return int(match[1]), int(match[2])


def decoded_outputs(text: str) -> frozenset[str]:
    """Return the set named by a comma-separated list of color, depth and labels."""
    names = frozenset(text.split(","))
    if not names <= set(OUTPUTS):
        raise click.BadParameter(f"{text!r} names something else than {', '.join(OUTPUTS)}")
    return names


def object_numbers(text: str) -> tuple[int, ...]:
    """Return the object numbers, 0 to 255, of a comma-separated list."""
    parts = text.split(",")
    if not all(re.fullmatch(r"\d{1,3}", part) and int(part) < LABEL_LIMIT for part in parts):
        raise click.BadParameter(f"{text!r} is not a list of object numbers from 0 to 255; write 1,3")
    return tuple(sorted({int(part) for part in parts}))


def segmentation(text: str) -> SegmentationConfig:
    """Return the choice named by ``none``, ``masks``, ``motion``, ``auto`` or ``depth:NEAR..FAR`` (lengths)."""
    from threedvc.config import SegmentationConfig, SegmentationMode

    if text in ("none", "masks", "motion", "auto"):
        return SegmentationConfig(mode=SegmentationMode(text))
    near, dots, far = text.removeprefix("depth:").partition("..")
    if not text.startswith("depth:") or not dots:
        raise click.BadParameter(
            f"{text!r} is not none, masks, motion, auto or depth:NEAR..FAR, such as depth:10cm..1.2m"
        )
    return SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=length(near), far_m=length(far))


def focus(text: str) -> RegionOfInterest:
    """Return the focus of ``OBJECT=WEIGHT`` or ``X0..X1,Y0..Y1,Z0..Z1=WEIGHT`` (signed lengths)."""
    from threedvc.config import RegionOfInterest

    place, _, weight = text.rpartition("=")
    if OBJECT.fullmatch(place):
        return RegionOfInterest(weight=positive_number(weight), number=int(place))
    box = BOX.fullmatch(place)
    if box is None:
        raise click.BadParameter(
            f"{text!r} is not OBJECT=WEIGHT or X0..X1,Y0..Y1,Z0..Z1=WEIGHT, such as 1=4 or -20cm..20cm,0..1,0.5..2=4"
        )
    x0, x1, y0, y1, z0, z1 = (-length(each[1:]) if each[0] == "-" else length(each) for each in box.groups())
    return RegionOfInterest(weight=positive_number(weight), box_m=(x0, x1, y0, y1, z0, z1))


def reader_options(function: F) -> F:
    """Add the options of a `ReaderRequest`: each a tuple, given once, or once for each sensor."""
    options = [
        click.option("--layout", type=click.Choice(layout_names()), multiple=True,
                     help="Layout of the recording.  [default: auto]"),
        click.option("--color", metavar="DIR", multiple=True, help="Folder of color pictures."),
        click.option("--depth", metavar="DIR", multiple=True, help="Folder of 16-bit depth pictures."),
        click.option("--intrinsics", metavar="FILE|FX,FY,CX,CY", multiple=True,
                     help="Cameras: an intrinsics.json, or four numbers."),
        click.option("--depth-scale", type=positive_number, metavar="N", multiple=True,
                     help="Units of depth pictures per meter."),
        click.option("--fps", type=positive_number, metavar="N", multiple=True, help="Frame rate of the recording."),
        click.option("--poses", metavar="READING", multiple=True,
                     help="What its camera poses are: as-given, inverted (world-to-camera), opengl (y up, z back), "
                     "w-first (quaternions w x y z), millimeters, centimeters, body (x forward, z up), left-handed; or "
                     "several joined by +."),
    ]  # fmt: skip
    for option in reversed(options):
        function = option(function)
    return function


def stream_argument(function: F) -> F:
    """Add the argument INPUT.3dvc, where - is standard input."""
    path = click.Path(path_type=Path, allow_dash=True)
    return click.argument("source", metavar="INPUT.3dvc", type=path)(function)


def threads_option(function: F) -> F:
    """Add ``--threads``."""
    return click.option(
        "--threads",
        type=click.IntRange(min=1),
        metavar="N",
        help="Number of threads; the result does not depend on it.  [default: all processors]",
    )(function)


def force_option(function: F) -> F:
    """Add ``--force``."""
    return click.option("--force", is_flag=True, help="Replace files that 3dvc did not write, too.")(function)


def json_option(function: F) -> F:
    """Add ``--json``."""
    return click.option("--json", "as_json", is_flag=True, help="Print the report as JSON on standard output.")(
        function
    )
