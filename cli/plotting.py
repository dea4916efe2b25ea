# SPDX-License-Identifier: MIT
"""The picture of `3dvc stats --plot`; the one place that needs Matplotlib."""

from __future__ import annotations

import io
from importlib.util import find_spec
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from threedvc.errors import ConfigError
from threedvc.formats.outputs import write_output
from threedvc.stream.pose_status import PoseStatus

if TYPE_CHECKING:
    from threedvc.formats.evaluation.frame_ranges import FrameSpan
    from threedvc.formats.evaluation.report import StreamStatistics

__all__ = ["check_plotting", "is_plot", "plot_statistics"]

FORMATS = (".png", ".pdf", ".svg")
MAKER = b"3dvc stats"
STATUS_COLORS = {PoseStatus.RELOCALIZED: "tab:blue", PoseStatus.WEAK: "tab:orange", PoseStatus.LOST: "tab:red"}


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


def is_plot(head: bytes) -> bool:
    """Tell whether a file is a plot that `plot_statistics` drew."""
    return MAKER in head and head.startswith((b"\x89PNG", b"%PDF", b"<?xml"))


def plot_statistics(report: StreamStatistics, path: Path, *, force: bool = False) -> None:
    """Draw cumulative bytes, model entropy, visible objects and status over time, and packet shares, into a file."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 11), layout="constrained")
    size, entropy, course, shares = figure.subplots(4, 1)
    figure.suptitle(f"{report.name}: {report.frames} frames, {report.file_bytes:,} bytes, {report.kbit_s:.1f} kbit/s")
    _draw_bytes(size, report)
    _draw_entropy(entropy, report)
    course.sharex(size)
    _draw_course(course, report)
    _draw_shares(shares, report)
    data = io.BytesIO()
    kind = path.suffix.lower().removeprefix(".")
    figure.savefig(data, format=kind, dpi=120, metadata={"Software" if kind == "png" else "Creator": MAKER.decode()})
    write_output(path, data.getvalue(), is_plot, "plot", force=force)


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


def _draw_course(axes: Any, report: StreamStatistics) -> None:
    """Draw a bar for each run of frames that show an object, and shade frames by a status worth a look."""
    names = [str(item.id) for item in report.objects]
    for row, item in enumerate(report.objects):
        axes.broken_barh([_stretch(span) for span in item.spans], (row - 0.3, 0.6), color="tab:gray")
    for name, spans in report.status_spans.items():
        shade = STATUS_COLORS[PoseStatus(name)]
        for span in spans:
            start, length = _stretch(span)
            label = name if span is spans[0] else None
            axes.axvspan(start, start + length, color=shade, alpha=0.4, linewidth=0, label=label)
    if report.status_spans:
        axes.legend(loc="upper right")
    axes.set(xlabel="frame", ylabel="visible object")
    axes.set_yticks(range(len(names)), names)


def _stretch(span: FrameSpan) -> tuple[float, int]:
    """Return where the frames of a span begin on the axis, and how many they are."""
    return span.first - 0.5, span.last - span.first + 1


def _draw_shares(axes: Any, report: StreamStatistics) -> None:
    totals = sorted(report.packets.items(), key=lambda item: item[1].bytes)
    bars = axes.barh([name for name, _ in totals], [total.bytes / 1000 for _, total in totals])
    axes.bar_label(bars, [f"{total.bytes / report.file_bytes:.1%}" for _, total in totals], padding=3)
    axes.set(xlabel="kB")
    axes.margins(x=0.1)
