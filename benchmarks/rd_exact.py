# SPDX-License-Identifier: MIT
"""Depth without loss or within a bound, and color without loss: points of 3dvc and of the coders of `exact_coders`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import threedvc
from bd_rate import geometric_mean
from exact_coders import Coder, NotExact, Picture, checked_size, color_coders, depth_coders
from rd_points import COLOR, Point, Recording, Store, config_of, file_name, scored, source_digest
from reporting import markdown_table
from threedvc.metrics.depth_errors import depth_units
from threedvc.metrics.picture_quality import MAX_PSNR_DB
from threedvc.units import MILLIMETERS

__all__ = ["BOUND_MM", "ExactResult", "color_points", "depth_points", "exact_tables", "our_exact_points"]

BOUND_MM = 5
"""Largest error of bounded depth: that of a Kinect at 1.3 m."""
BOUNDED, LEVEL, EXACT, LOSSLESS = (
    f"--color-video on --depth-error {BOUND_MM}mm",
    "--color-video on --depth-error level",
    "--color-video on --depth-error lossless",
    "--lossless",
)
PROMISES = {BOUNDED: BOUND_MM, LEVEL: None, EXACT: 0, LOSSLESS: 0}
"""Options of 3dvc, and the largest error in millimeters that each allows; None: as far as to the next depth that the
sensor tells. A color video keeps colors apart from depth, so that the bytes of both are known."""
LIMIT, LARGEST, COLOR_BYTES = "limit_mm", "depth_max_mm", "color_bytes"
COLOR_PACKET = "COLOR_VIDEO"
UNTRUE = float(np.finfo(np.float32).eps)
"""Of a bound in millimeters: what rounding may add."""
NOTE = f"""\
kB are thousands of bytes a frame. Depth of 3dvc is all of its file but the color video: models and motion are counted
as depth. Sizes of other coders are those of coded pictures without a container; each was decoded and held against the
input. "levels": depths are numbered from 1, one number for each depth that occurs in the sequence, and the table of
them is counted; "steps": as few numbers as keep every depth within {BOUND_MM} mm. What has no depth stays without, in
all of them. "to 3dvc" is the geometric mean over sequences of the size over that of 3dvc with the same promise; above
1 means that 3dvc is smaller."""


@dataclass(frozen=True, kw_only=True)
class ExactResult:
    """Points of one sequence, all of which keep what they promise.

    Attributes
    ----------
    sequence, frames, seconds
        Its name and length.
    ours
        Points of 3dvc, whole files, by option.
    depth, color
        Points of the other coders.
    """

    sequence: str
    frames: int
    seconds: float
    ours: dict[str, Point]
    depth: Sequence[Point]
    color: Sequence[Point]

    def our_depth(self, option: str) -> float:
        """Return the bytes of depth in a file of 3dvc."""
        return self.ours[option].size - self.ours[option].quality[COLOR_BYTES]

    def kilobytes(self, size: float) -> float:
        """Return a size as thousands of bytes a frame."""
        return size / self.frames / 1000

    def kbit_s(self, size: float) -> float:
        """Return a size as a rate."""
        return size * 8 / self.seconds / 1000


def our_exact_points(recording: Recording, store: Store) -> Iterator[tuple[str, Point]]:
    """Yield options of 3dvc that bound errors, and the points they lead to."""
    version = source_digest()
    for option in PROMISES:
        place = store.place(recording, file_name(f"3dvc {recording.run.options} {option}"))
        yield option, store.point(place, version, partial(_ours, recording, option, place.with_suffix(".3dvc")))


def _ours(recording: Recording, option: str, stream: Path) -> Point:
    config = replace(config_of(f"{recording.run.options} {option}"), max_depth_m=None)
    size = recording.encode(stream, config)
    quality = scored(recording, stream)
    point = Point(setting=option, size=size, quality=quality | {COLOR_BYTES: _color_bytes(stream)})
    if not keeps_promise(point):
        raise NotExact(f"{recording.run.sequence}: 3dvc {option} comes to {quality}")
    return point


def keeps_promise(point: Point) -> bool:
    """Tell whether a point of 3dvc is as exact as its option says."""
    limit, quality = PROMISES[point.setting], point.quality
    within = limit is None or quality[LARGEST] <= limit * (1 + UNTRUE)
    same_color = point.setting != LOSSLESS or quality[COLOR] == MAX_PSNR_DB
    return within and same_color and quality["depth_lost"] == 0 and quality["depth_invented"] == 0


def _color_bytes(stream: Path) -> float:
    packets = threedvc.statistics(stream).packets
    return float(packets[COLOR_PACKET].bytes) if COLOR_PACKET in packets else 0.0


def depth_points(recording: Recording, store: Store) -> Iterator[Point]:
    """Yield the points of the coders of depth."""
    scale = recording.info.depth_scale
    pictures = [depth_units(depth, scale) for depth in recording.depths()]
    largest = max((int(picture.max(initial=0)) for picture in pictures), default=0)
    coders = depth_coders(largest, int(BOUND_MM * scale / MILLIMETERS + UNTRUE))
    yield from _points(recording, store, "depth", coders, pictures, MILLIMETERS / scale)


def color_points(recording: Recording, store: Store) -> Iterator[Point]:
    """Yield the points of the coders of color."""
    gray = recording.info.gray
    pictures: list[NDArray[np.uint8]] = [color[..., 0] if gray else color for color in recording.colors()]
    yield from _points(recording, store, "color", color_coders(gray), pictures, 1.0)


def _points(
    recording: Recording, store: Store, kind: str, coders: Iterator[Coder], pictures: Sequence[Picture], unit: float
) -> Iterator[Point]:
    for coder in coders:
        place = store.place(recording, file_name(f"exact-{kind}-{coder.name}-{coder.limit}"))
        yield store.point(place, coder.version, partial(_theirs, coder, pictures, unit))


def _theirs(coder: Coder, pictures: Sequence[Picture], unit: float) -> Point:
    size, worst = checked_size(coder, pictures)
    return Point(setting=coder.name, size=size, quality={LIMIT: unit * coder.limit, LARGEST: unit * worst})


def exact_tables(results: Sequence[ExactResult]) -> list[str]:
    """Return the parts of the report about what is lossless or bounded, as Markdown."""
    if not results:
        return []
    return [
        "## Depth and color without loss, or within a bound",
        NOTE,
        "### Lossless depth, kB a frame",
        _table(results, [EXACT], lambda result: [point for point in result.depth if point.quality[LIMIT] == 0]),
        f"### Depth within {BOUND_MM} mm, kB a frame",
        _table(results, [BOUNDED, LEVEL], lambda result: [point for point in result.depth if point.quality[LIMIT] > 0]),
        "### Lossless color, kB a frame",
        _table(results, [LOSSLESS], lambda result: result.color, of_color=True),
        "### Whole files of 3dvc",
        markdown_table(FILES, [_file(result, point) for result in results for point in result.ours.values()], 2),
    ]


FILES = ("sequence", "3dvc", "bytes", "kbit/s", "color kB", "depth kB", "PSNR RGB", "largest depth error mm")


def _file(result: ExactResult, point: Point) -> list[str]:
    color = point.quality[COLOR_BYTES]
    return [
        result.sequence,
        f"`{point.setting}`",
        f"{point.size:,}",
        f"{result.kbit_s(point.size):,.1f}",
        *(f"{result.kilobytes(size):.2f}" for size in (color, point.size - color)),
        f"{point.quality[COLOR]:.2f}",
        f"{point.quality[LARGEST]:.1f}",
    ]


def _table(
    results: Sequence[ExactResult],
    options: Sequence[str],
    theirs: Callable[[ExactResult], Sequence[Point]],
    of_color: bool = False,
) -> str:
    """Return sizes by coder and sequence; the first option of 3dvc is what others are held against."""
    sizes = [{point.setting: float(point.size) for point in theirs(result)} for result in results]
    ours = [
        {
            option: result.ours[option].quality[COLOR_BYTES] if of_color else result.our_depth(option)
            for option in options
        }
        for result in results
    ]
    names = dict.fromkeys(name for each in sizes for name in each)
    rows = [_sizes(f"3dvc `{option}`", option, results, ours, ours, options[0]) for option in options]
    rows += [_sizes(name, name, results, sizes, ours, options[0]) for name in names]
    return markdown_table(("coder", "to 3dvc", *(result.sequence for result in results)), rows)


def _sizes(
    words: str,
    name: str,
    results: Sequence[ExactResult],
    sizes: Sequence[dict[str, float]],
    ours: Sequence[dict[str, float]],
    reference: str,
) -> list[str]:
    ratios = [each[name] / our[reference] for each, our in zip(sizes, ours, strict=True) if name in each]
    cells = [
        f"{result.kilobytes(each[name]):.2f}" if name in each else "-"
        for result, each in zip(results, sizes, strict=True)
    ]
    mean = geometric_mean(ratios)
    return [words, "-" if mean is None else f"{mean:.2f}", *cells]
