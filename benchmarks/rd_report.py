# SPDX-License-Identifier: MIT
"""What points of rate-distortion curves come to: rates at equal quality, Bjontegaard differences, tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bd_rate import Curve, bd_rate, geometric_mean
from rd_exact import ExactResult, exact_tables
from rd_points import COLOR, DEPTH, Point
from reporting import markdown_table

__all__ = ["Result", "report"]

MIDDLE_KBIT_S = (20.0, 150.0)
"""Rates over which a mean is taken: more than models alone need, and less than good videos of both."""
CHOICES = ((COLOR,), (DEPTH,), (COLOR, DEPTH))
NOTE = f"""\
3dvc is always counted with its whole file, which holds color, depth and motion; AV1 with its coded pictures alone, no
container. Color is 8-bit 4:2:0 at preset 4, constant quality, one key frame; depth is 10-bit inverse depth in luma,
with the pixels that have none filled smoothly and no mask of them. Both are coded at full, half, quarter and an eighth
of their size, from the coarsest quality to the first that is better than all points of 3dvc. Both codecs are scored on
the same pictures by `threedvc.metrics.picture_quality`; depth only where the input has a value, and a lost pixel is a
miss.

"Equal PSNR" is what AV1 needs for the PSNR-RGB of a point of 3dvc, color alone; "equal within 1 %" what it needs
for as many pixels within 1 % of the true depth, depth alone; "both" is their sum, two videos against one file. They
are read off the convex hull of AV1's points over all sizes, log rate interpolated by monotone cubics. ≤: the
cheapest point of AV1 is better than asked; a dash: its dearest is not as good. "AV1/3dvc" above 1 means that 3dvc is
smaller; for a sequence it is the geometric mean over its points, without those that AV1 cannot equal or that are
marked ≤, and without those that a smaller point of 3dvc equals in both measures.

"At equal quality, by rate" has this ratio for both together, by the rate that 3dvc was asked for; its last column is
the geometric mean of the points of 3dvc whose files have {MIDDLE_KBIT_S[0]:g} to {MIDDLE_KBIT_S[1]:g} kbit/s.

BD-rate is the mean difference of log rates over the qualities that both reach, in percent; negative means that 3dvc
needs less, a dash that they have no range in common. That of the pair runs over the PSNR of 3dvc's points and holds
each against the AV1 pair of the same PSNR and the same share within 1 %."""
SUMMARY = (
    "sequence", "frames", "BD-rate color", "BD-rate depth", "BD-rate pair",
    "AV1/3dvc, equal PSNR", "AV1/3dvc, equal within 1 %", "AV1/3dvc, both",
)  # fmt: skip
OURS = (
    "3dvc", "bytes", "kbit/s", "PSNR RGB", "PSNR Y", "SSIM Y", "within 1 %", "within 10 mm", "RMSE mm", "lost",
    "AV1 equal PSNR", "AV1 equal within 1 %", "AV1 both", "AV1/3dvc",
)  # fmt: skip
COLOR_HEADER = ("AV1 color", "bytes", "kbit/s", "PSNR RGB", "PSNR Y", "SSIM Y")
DEPTH_HEADER = ("AV1 depth", "bytes", "kbit/s", "within 1 %", "within 10 mm", "RMSE mm")
COLOR_CELLS = {"psnr_rgb": 2, "psnr_y": 2, "ssim_y": 4}
"""Digits after the point of each measure of color in the tables."""
DEPTH_CELLS = {"depth_within_1pct": 4, "depth_within_10mm": 4, "depth_rmse_mm": 1}
"""Digits after the point of each measure of depth."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """The points of one sequence.

    Attributes
    ----------
    sequence, options
        Its name and the options of ``3dvc encode``.
    frames, seconds
        Its length.
    ours, color, depth
        Points of 3dvc, of AV1 for color and of AV1 for depth.
    """

    sequence: str
    options: str
    frames: int
    seconds: float
    ours: Sequence[Point]
    color: Sequence[Point]
    depth: Sequence[Point]

    @cached_property
    def curves(self) -> dict[str, Curve]:
        """Curves of AV1 by measure of quality."""
        return {COLOR: curve(self.color, COLOR), DEPTH: curve(self.depth, DEPTH)}

    @cached_property
    def worthwhile(self) -> list[Point]:
        """Points of 3dvc that no other one equals in color and in depth with fewer bytes."""
        return [point for point in self.ours if not any(_beats(other, point) for other in self.ours)]

    def equal(self, point: Point, *measures: str) -> float | None:
        """Return the bytes AV1 needs to be as good as a point of 3dvc, for all measures together; None if it is not."""
        needs = [self.curves[measure].rate(point.quality[measure]) for measure in measures]
        reached = [need for need in needs if need is not None]
        return sum(reached) if len(reached) == len(needs) else None

    def at_most(self, point: Point, *measures: str) -> bool:
        """Tell whether AV1's cheapest point is better than a point of 3dvc, so that `equal` is only a bound."""
        return any(point.quality[measure] < self.curves[measure].lowest for measure in measures)

    def difference(self, measure: str) -> float | None:
        """Return the BD-rate of 3dvc against AV1 in percent, by one measure of quality."""
        return bd_rate(self.curves[measure], curve(self.ours, measure))

    def pair_difference(self) -> float | None:
        """Return the BD-rate of 3dvc against the AV1 pairs that are as good as its points, in percent."""
        ratios = [(point, ratio) for point in self.ours if (ratio := self._ratio(point, COLOR, DEPTH)) is not None]
        if not ratios:
            return None
        theirs = Curve.hull((ratio * point.size, point.quality[COLOR]) for point, ratio in ratios)
        return bd_rate(theirs, curve([point for point, _ in ratios], COLOR))

    def ratios(self) -> list[float | None]:
        """Return AV1's bytes over ours at equal PSNR, at equal within 1 % and at both, as means over our points."""
        return [_mean([self._ratio(point, *chosen) for point in self.worthwhile]) for chosen in CHOICES]

    def middle_ratio(self) -> float | None:
        """Return AV1's bytes over ours for both, as a mean over our worthwhile points of `MIDDLE_KBIT_S`."""
        low, high = MIDDLE_KBIT_S
        chosen = [point for point in self.worthwhile if low <= self.kbit_s(point.size) <= high]
        return _mean([self._ratio(point, COLOR, DEPTH) for point in chosen])

    def _ratio(self, point: Point, *measures: str) -> float | None:
        need = self.equal(point, *measures)
        return None if need is None or self.at_most(point, *measures) else need / point.size

    def line(self, points: Sequence[Point], measure: str) -> tuple[list[float], list[float]]:
        """Return the rates of points in kbit/s, and their qualities by one measure."""
        return [self.kbit_s(point.size) for point in points], [point.quality[measure] for point in points]

    def kbit_s(self, size: float) -> float:
        """Return a number of bytes as a rate."""
        return size * 8 / self.seconds / 1000


def _beats(other: Point, point: Point) -> bool:
    return other.size < point.size and all(other.quality[m] >= point.quality[m] for m in (COLOR, DEPTH))


def curve(points: Iterable[Point], measure: str) -> Curve:
    """Return the curve of points by one measure of quality."""
    return Curve.hull((point.size, point.quality[measure]) for point in points)


def report(
    results: Sequence[Result],
    heading: str,
    plots: Path | None = None,
    failures: Sequence[str] = (),
    exact: Sequence[ExactResult] = (),
) -> str:
    """Return the report as Markdown.

    Parameters
    ----------
    results, exact
        Points by rate, and points without loss or within a bound.
    heading
        Says which codecs were compared, and where.
    plots
        The folder of plots as the report names it.
    failures
        What could not be measured.
    """
    parts = ["# Rate and distortion", heading]
    if results:
        parts += [_summary(results), "## At equal quality, by rate: bytes of the AV1 pair over those of 3dvc"]
        parts += [_by_rate(results), "## How it is compared", NOTE]
    parts += exact_tables(exact)
    parts += [f"Failed: {failure}." for failure in failures]
    for result in results:
        options = f" with `{result.options}`" if result.options else ""
        parts += [f"## {result.sequence}", f"{result.frames} frames{options}."]
        if plots is not None:
            parts.append(f"![{result.sequence}]({plots.as_posix()}/{result.sequence}.png)")
        parts += [
            markdown_table(OURS, [_our_row(result, point) for point in result.ours]),
            markdown_table(COLOR_HEADER, [_row(result, point, COLOR_CELLS) for point in result.color]),
            markdown_table(DEPTH_HEADER, [_row(result, point, DEPTH_CELLS) for point in result.depth]),
        ]
    return "\n\n".join(parts) + "\n"


def _summary(results: Sequence[Result]) -> str:
    differences = [[r.difference(COLOR), r.difference(DEPTH), r.pair_difference()] for r in results]
    ratios = [r.ratios() for r in results]
    rows = [
        [r.sequence, str(r.frames), *map(_percent, changes), *map(_ratio, factors)]
        for r, changes, factors in zip(results, differences, ratios, strict=True)
    ]
    changes = [_mean([None if d is None else 1 + d / 100 for d in column]) for column in zip(*differences, strict=True)]
    factors = [_mean(column) for column in zip(*ratios, strict=True)]
    percents = [_percent(None if change is None else 100 * (change - 1)) for change in changes]
    return markdown_table(SUMMARY, [*rows, ["geometric mean", "", *percents, *map(_ratio, factors)]])


def _by_rate(results: Sequence[Result]) -> str:
    low, high = MIDDLE_KBIT_S
    settings = sorted({point.setting for result in results for point in result.ours}, key=_rate_of)
    rows = []
    for result in results:
        cells = {point.setting: _both(result, point) for point in result.ours}
        rows.append([result.sequence, *(cells.get(each, "") for each in settings), _ratio(result.middle_ratio())])
    mean = _mean([result.middle_ratio() for result in results])
    rows.append(["geometric mean", *[""] * len(settings), _ratio(mean)])
    return markdown_table(("sequence", *settings, f"{low:g} to {high:g} kbit/s"), rows)


def _rate_of(setting: str) -> float:
    """Return the number at the front of "8 kbit/s"."""
    return float(setting.split()[0])


def _both(result: Result, point: Point) -> str:
    both = result.equal(point, COLOR, DEPTH)
    bound = "≤ " if both is not None and result.at_most(point, COLOR, DEPTH) else ""
    return bound + _ratio(None if both is None else both / point.size)


def _mean(values: Sequence[float | None]) -> float | None:
    return geometric_mean([value for value in values if value is not None])


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:+.1f} %"


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _row(result: Result, point: Point, cells: dict[str, int]) -> list[str]:
    measures = [f"{point.quality[name]:.{digits}f}" for name, digits in cells.items()]
    return [point.setting, f"{point.size:,}", f"{result.kbit_s(point.size):.1f}", *measures]


def _our_row(result: Result, point: Point) -> list[str]:
    both = result.equal(point, COLOR, DEPTH)
    return [
        *_row(result, point, COLOR_CELLS | DEPTH_CELLS),
        f"{point.quality['depth_lost']:.4f}",
        *(_need(result.equal(point, measure), result.at_most(point, measure)) for measure in (COLOR, DEPTH)),
        _need(both, result.at_most(point, COLOR, DEPTH)),
        _ratio(None if both is None else both / point.size),
    ]


def _need(size: float | None, at_most: bool) -> str:
    return "-" if size is None else f"{'≤ ' if at_most else ''}{size:,.0f}"
