# SPDX-License-Identifier: MIT
"""Compare 3dvc with other codecs over the whole range of quality, from models alone to no loss.

Two parts: ``rates`` encodes each sequence at several rates with 3dvc and with AV1 for color and AV1 for depth, for
bytes at equal quality and BD-rate; ``exact`` holds depth without loss or within a bound, and color without loss,
against coders that can do the same. All is scored by `threedvc.metrics.picture_quality`; tables and plots are written::

    python benchmarks/rd.py [FOLDER...] [--parts rates,exact] [--frames N] [--rates KBIT_S,...] [--out FILE.md]

Without folders all sequences in ``$THREEDVC_DATA``, or in ``../shared/data``, are taken. Needs the extra ``[bench]``.
Points that were measured are kept, so that a run that was broken off goes on; those of 3dvc are measured anew
when its sources change.
"""

from __future__ import annotations

import argparse
import math
import platform
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from av1 import MissingCodec, library
from exact_coders import NotExact, pictures_library
from rd_exact import ExactResult, color_points, depth_points, our_exact_points
from rd_plot import plot
from rd_points import COLOR, DEPTH, Point, Recording, Store, av1_points, threedvc_points
from rd_report import Result, report
from reporting import REPOSITORY, commit
from sequences import DATA
from threedvc import ThreedvcError
from threedvc.parallel import default_threads

__all__ = ["PARTS", "main", "measured", "measured_exact", "recorded"]

PARTS = ("rates", "exact")
STORE = REPOSITORY / "build" / "bench-rd"
OUTPUT = Path(__file__).with_name("RESULTS.md")
MIN_POINTS = 2
"""Of a curve: one rate is no curve."""


def recorded() -> list[Path]:
    """Return the folders of all recorded sequences."""
    return sorted(path.parent for path in DATA.glob("*/intrinsics.json"))


def measured(recording: Recording, store: Store) -> Result:
    """Measure all points of one sequence, or take those that were measured."""
    name = recording.run.sequence
    ours = _told(f"{name}: 3dvc", threedvc_points(recording, store))

    def theirs(kind: str, measure: str) -> list[Point]:
        best = max(point.quality[measure] for point in ours)
        points = av1_points(recording, store, kind, lambda point: point.quality[measure] > best)
        return _told(f"{name}: AV1 {kind}", points)

    return Result(
        sequence=name,
        options=recording.run.options,
        frames=len(recording.frames),
        seconds=recording.seconds,
        color=theirs("color", COLOR),
        depth=theirs("depth", DEPTH),
        ours=ours,
    )


def measured_exact(recording: Recording, store: Store) -> ExactResult:
    """Measure all points of one sequence that are lossless or bounded, or take those that were measured."""
    name = recording.run.sequence
    ours = {}
    for option, point in our_exact_points(recording, store):
        _tell(f"{name}: 3dvc", point)
        ours[option] = point
    return ExactResult(
        sequence=name,
        frames=len(recording.frames),
        seconds=recording.seconds,
        ours=ours,
        depth=_told(f"{name}: depth", depth_points(recording, store)),
        color=_told(f"{name}: color", color_points(recording, store)),
    )


def _told(what: str, points: Iterable[Point]) -> list[Point]:
    """Return points, and say so as each is there."""
    return list(_telling(what, points))


def _telling(what: str, points: Iterable[Point]) -> Iterator[Point]:
    for point in points:
        _tell(what, point)
        yield point


def _tell(what: str, point: Point) -> None:
    print(f"{what}, {point.setting}: {point.size:,} bytes", file=sys.stderr, flush=True)


def results(
    folders: Sequence[Path], options: argparse.Namespace, failures: list[str]
) -> tuple[list[Result], list[ExactResult]]:
    """Measure sequences, and note those that cannot be."""
    store = Store(options.cache, options.reuse)
    found: list[Result] = []
    exact: list[ExactResult] = []
    for folder in folders:
        try:
            recording = Recording.of(folder, options.frames)
            if options.rates:
                recording = replace(recording, run=replace(recording.run, rates=options.rates))
            if "rates" in options.parts:
                found.append(measured(recording, store))
            if "exact" in options.parts:
                exact.append(measured_exact(recording, store))
        except (ThreedvcError, NotExact) as error:
            print(error, file=sys.stderr)
            failures.append(f"{folder.name}: {error}")
    return found, exact


def heading(parts: Sequence[str]) -> str:
    """Return which codecs were compared, and where."""
    machine = f"{default_threads()} cores, {platform.machine()}, Python {platform.python_version()}"
    pictures = ""
    if "exact" in parts:
        pictures = f"; JPEG-XL, JPEG-LS, PNG and LERC are those of imagecodecs {pictures_library().__version__}"
    return (
        f"Written by `make bench-rd` at commit {commit()}, on {machine}. SVT-AV1, dav1d, x265 and FFV1 are those of "
        f"the wheel of PyAV {library().__version__}{pictures}."
    )


def count(text: str) -> int:
    """Return a whole number above zero.

    Raises
    ------
    ValueError
        If it is none.
    """
    if int(text) < 1:
        raise ValueError(text)
    return int(text)


def rates_of(text: str) -> tuple[float, ...]:
    """Return the rates of a list with commas, rising.

    Raises
    ------
    ValueError
        If one is no positive number, or there are too few for a curve.
    """
    rates = tuple(sorted({float(part) for part in text.split(",")}))
    if len(rates) < MIN_POINTS or not 0 < rates[0] <= rates[-1] < math.inf:
        raise ValueError(text)
    return rates


def parts_of(text: str) -> tuple[str, ...]:
    """Return the parts of a list with commas.

    Raises
    ------
    ValueError
        If one is not known.
    """
    parts = tuple(text.split(","))
    if not set(parts) <= set(PARTS):
        raise ValueError(text)
    return parts


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Compare 3dvc with other codecs, over the range of quality.")
    parser.add_argument("folders", type=Path, nargs="*", help=f"sequences (default: all in {DATA})")
    parser.add_argument("--frames", type=count, metavar="N", help="measure the first N frames of each")
    parser.add_argument("--parts", type=parts_of, default=PARTS, metavar=",".join(PARTS), help="what to measure")
    parser.add_argument("--rates", type=rates_of, metavar="KBIT_S,...", default=(),
                        help="rates of 3dvc (default: those of the table of runs)")  # fmt: skip
    parser.add_argument("--out", type=Path, default=OUTPUT, help="file to write; plots go to a folder beside it")
    parser.add_argument("--cache", type=Path, default=STORE, help="folder of points that were measured")
    parser.add_argument("--reuse", action="store_true", help="take points of other versions of the codecs, too")
    options = parser.parse_args(arguments)
    return options


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line, measure, write tables and plots."""
    options = parsed(arguments)
    folders = options.folders or recorded()
    if not folders:
        print(f"no recorded sequences in {DATA}; set THREEDVC_DATA to their folder", file=sys.stderr)
        return
    try:
        library()
        if "exact" in options.parts:
            pictures_library()
    except MissingCodec as error:
        sys.exit(str(error))
    failures: list[str] = []
    found, exact = results(folders, options, failures)
    plots = options.out.with_name("plots")
    plots.mkdir(parents=True, exist_ok=True)
    for result in found:
        plot(result, plots / f"{result.sequence}.png", next((e for e in exact if e.sequence == result.sequence), None))
    text = report(found, heading(options.parts), Path(plots.name), failures, exact)
    options.out.write_text(text, encoding="utf-8")
    print(options.out)
    if failures:
        sys.exit(f"{len(failures)} of the sequences failed")


if __name__ == "__main__":
    main()
