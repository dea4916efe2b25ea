# SPDX-License-Identifier: MIT
"""The picture of `3dvc stats --plot`; the one place that needs Matplotlib."""

from __future__ import annotations

import io
from importlib.util import find_spec
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from threedvc.cli.files import write_file
from threedvc.errors import ConfigError

if TYPE_CHECKING:
    from threedvc.formats.statistics import StreamStatistics

__all__ = ["check_plotting", "plot_statistics"]

FORMATS = (".png", ".pdf", ".svg")


def check_plotting(path: Path) -> None:
    """Find out, before any work is done, whether `path` can be drawn.

    Raises
    ------
    click.UsageError
        If the name is not that of a picture.
    ConfigError
        If Matplotlib is not installed.
    """
    if path.suffix.lower() not in FORMATS:
        raise click.UsageError(f"{path} is not the name of a picture; end it in {', '.join(FORMATS)}")
    if find_spec("matplotlib") is None:
        raise ConfigError("--plot needs Matplotlib; install it with: pip install '3dvc[plot]'")


def plot_statistics(report: StreamStatistics, path: Path) -> None:
    """Draw cumulative bytes, model entropy and packet shares over time into a picture file."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 9), layout="constrained")
    size, entropy, shares = figure.subplots(3, 1)
    figure.suptitle(f"{report.name}: {report.frames} frames, {report.file_bytes:,} bytes, {report.kbit_s:.1f} kbit/s")
    _draw_bytes(size, report)
    _draw_entropy(entropy, report)
    _draw_shares(shares, report)
    data = io.BytesIO()
    figure.savefig(data, format=path.suffix.lower().removeprefix("."), dpi=120)
    write_file(path, data.getvalue())


def _draw_bytes(axes: Any, report: StreamStatistics) -> None:
    sizes = [item.bytes for item in report.per_frame]
    totals = [total / 1000 for total in accumulate(sizes)]
    axes.plot(range(len(sizes)), totals)
    axes.set(xlabel="frame", ylabel="kB sent", ylim=(0, None))
    axes.grid(alpha=0.3)


def _draw_entropy(axes: Any, report: StreamStatistics) -> None:
    points = [(item.frame, item.entropy_bits / 1000) for item in report.per_frame if item.entropy_bits is not None]
    axes.plot([frame for frame, _ in points], [bits for _, bits in points])
    axes.set(xlabel="frame", ylabel="model entropy, kbit")
    axes.grid(alpha=0.3)


def _draw_shares(axes: Any, report: StreamStatistics) -> None:
    totals = sorted(report.packets.items(), key=lambda item: item[1].bytes)
    bars = axes.barh([name for name, _ in totals], [total.bytes / 1000 for _, total in totals])
    axes.bar_label(bars, [f"{total.bytes / report.file_bytes:.1%}" for _, total in totals], padding=3)
    axes.set(xlabel="kB")
    axes.margins(x=0.1)
