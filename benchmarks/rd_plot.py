# SPDX-License-Identifier: MIT
"""Draw rate-distortion curves of 3dvc and AV1."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rd_exact import ExactResult
from rd_points import COLOR, DEPTH
from rd_report import Result
from threedvc.metrics.picture_quality import MAX_PSNR_DB

__all__ = ["plot"]

OUR_COLOR, THEIR_COLOR = "tab:blue", "tab:orange"
STEPS = 200
"""Points of a drawn curve: it looks smooth."""


TICKS = 12
"""Of the axis of rates at most: two for each power of ten, from a few kbit/s to what lossless color takes."""


def plot(result: Result, picture: Path, exact: ExactResult | None = None) -> None:
    """Draw quality of color and of depth over rate, and what 3dvc and the AV1 pair need for both.

    Files whose depth is within a bound are points of their own; one without loss is a line, as its PSNR is infinite.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 4.5), layout="constrained")
    color, depth, pair = figure.subplots(1, 3)
    _their_curve(color, result, COLOR)
    _their_curve(depth, result, DEPTH)
    _their_pairs(pair, result)
    for axes, measure in ((color, COLOR), (depth, DEPTH), (pair, COLOR)):
        rates, qualities = result.line(result.ours, measure)
        axes.plot(rates, qualities, "o-", color=OUR_COLOR, label="3dvc, whole file")
        if exact is not None and axes is not pair:
            _exact(axes, exact, measure)
        _finish(axes)
    color.set_ylabel("PSNR RGB, dB")
    depth.set_ylabel("share within 1 % of the true depth")
    pair.set_ylabel("PSNR RGB, dB, at equal share within 1 %")
    figure.suptitle(f"{result.sequence}, {result.frames} frames")
    figure.savefig(picture, dpi=100)


def _their_curve(axes: Any, result: Result, measure: str) -> None:
    curve = result.curves[measure]
    qualities = np.linspace(curve.lowest, curve.highest, STEPS)
    rates = [result.kbit_s(size) for size in np.exp(curve.log_rate(qualities))]
    axes.plot(rates, qualities, color=THEIR_COLOR, label="AV1, hull")
    points = result.color if measure == COLOR else result.depth
    axes.plot(*result.line(points, measure), ".", color=THEIR_COLOR, label="AV1, points")


def _their_pairs(axes: Any, result: Result) -> None:
    needs = [
        (size, point.quality[COLOR]) for point in result.ours if (size := result.equal(point, COLOR, DEPTH)) is not None
    ]
    rates = [result.kbit_s(size) for size, _ in needs]
    axes.plot(rates, [quality for _, quality in needs], "s-", color=THEIR_COLOR, label="AV1, color and depth")


def _exact(axes: Any, exact: ExactResult, measure: str) -> None:
    points = list(exact.ours.values())
    bounded = [point for point in points if point.quality[COLOR] < MAX_PSNR_DB]
    rates = [exact.kbit_s(point.size) for point in bounded]
    axes.plot(rates, [point.quality[measure] for point in bounded], "D", color=OUR_COLOR, label="3dvc, --depth-error")
    for point in points:
        if point not in bounded:
            axes.axvline(exact.kbit_s(point.size), color=OUR_COLOR, linestyle=":", label="3dvc, --lossless")


def _finish(axes: Any) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 3), numticks=TICKS))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda rate, _: f"{rate:g}" if rate < 1000 else f"{rate / 1000:g}k"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("kbit/s")
    axes.grid(visible=True, alpha=0.3)
    axes.legend()
