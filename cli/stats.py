# SPDX-License-Identifier: MIT
"""`3dvc stats`: what a stream weighs and how well it draws."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from threedvc.cli.files import write_file
from threedvc.cli.options import json_option, stream_argument
from threedvc.cli.plotting import check_plotting, plot_statistics
from threedvc.cli.progress import Progress

if TYPE_CHECKING:
    from threedvc.formats.statistics import FrameStatistics, StreamStatistics
    from threedvc.metrics import TrajectoryError

__all__ = ["stats"]

COLUMN = 18
FRAME_COLUMNS = ("frame", "timestamp_ns", "bytes", "entropy_bits", "status")


@click.command(short_help="Report sizes and quality of a stream.")
@stream_argument
@click.option("--reference", type=click.Path(path_type=Path), metavar="FOLDER", help="Compare with these frames.")
@json_option
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE.png", help="Draw bytes, entropy and shares.")
@click.option("--per-frame", type=click.Path(path_type=Path), metavar="FILE.csv", help="Write a row for each frame.")
def stats(source: Path, reference: Path | None, as_json: bool, plot: Path | None, per_frame: Path | None) -> None:
    """Report sizes, objects, entropy and, with --reference, the quality of INPUT.3dvc (- is standard input).

    The folder of --reference has the frames that were encoded, in any layout that encode reads.
    """
    from threedvc.formats.statistics import statistics

    if plot is not None:
        check_plotting(plot)
    with Progress("compare", None) as progress:
        report = statistics(source, reference, on_frame=lambda index: progress.advance(index + 1))
    if per_frame is not None:
        _write_rows(per_frame, report.per_frame)
    if plot is not None:
        plot_statistics(report, plot)
    click.echo(report.to_json() if as_json else "\n".join(_lines(report)))


def _write_rows(path: Path, frames: Sequence[FrameStatistics]) -> None:
    measures = list(frames[0].quality) if frames else []
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*FRAME_COLUMNS, *measures])
    for item in frames:
        writer.writerow([*(getattr(item, name) for name in FRAME_COLUMNS), *item.quality.values()])
    write_file(path, text.getvalue().encode())


def _lines(report: StreamStatistics) -> Iterator[str]:
    state = "" if report.complete else "  TRUNCATED: the stream ends before its END packet"
    yield _row("stream", f"{report.name}, {report.frames} frames, {report.duration_s:.2f} s{state}")
    yield _row("size", f"{report.file_bytes:,} bytes, {report.kbit_s:.1f} kbit/s")
    yield _row("raw", f"{report.raw_bytes:,} bytes, 1:{report.ratio:.0f}")
    yield from _packets(report)
    yield from _objects(report)
    yield from _course(report)
    yield _row("paper", _paper(report))
    yield from _motion(report)
    if report.quality is not None:
        yield ""
        yield from (_row(name, _measure(name, value)) for name, value in report.quality.items())


def _row(name: str, text: str) -> str:
    return f"{name:<{COLUMN}}  {text}"


def _packets(report: StreamStatistics) -> Iterator[str]:
    yield ""
    yield f"{'packets':<{COLUMN}}  {'count':>8} {'bytes':>12} {'share':>7}"
    for name, total in sorted(report.packets.items(), key=lambda item: -item[1].bytes):
        yield f"  {name:<{COLUMN - 2}}  {total.count:>8,} {total.bytes:>12,} {total.bytes / report.file_bytes:>7.1%}"


def _objects(report: StreamStatistics) -> Iterator[str]:
    yield ""
    yield f"{'objects':<{COLUMN}}  {'cells':>8} {'bytes':>12} {'poses':>7} {'cell':>8}"
    for item in report.objects:
        cell = f"{1000 * item.voxel_size_m:g} mm"
        yield f"  {item.id:<{COLUMN - 2}}  {item.cells:>8,} {item.bytes:>12,} {item.poses:>7,} {cell:>8}"


def _course(report: StreamStatistics) -> Iterator[str]:
    yield ""
    if report.frames:
        largest = max(report.per_frame, key=lambda item: item.bytes)
        mean = report.file_bytes / report.frames
        yield _row("bytes per frame", f"mean {mean:.0f}, largest {largest.bytes:,} (frame {largest.frame})")
    entropy = [item.entropy_bits for item in report.per_frame if item.entropy_bits is not None]
    if entropy:
        yield _row(
            "entropy", f"{entropy[0]:,.0f} bits at first, {max(entropy):,.0f} at most, {entropy[-1]:,.0f} at last"
        )
    if report.status:
        yield _row("poses", ", ".join(f"{count} {status}" for status, count in report.status.items()))


def _paper(report: StreamStatistics) -> str:
    sizes = report.paper
    return (
        f"M {sizes.cells:,}, F_m {sizes.pose_frames:,}, S_3DVC {sizes.coded_bytes:,}, S_raw {sizes.raw_bytes:,}, "
        f"1:{sizes.ratio:.1f}"
    )


def _motion(report: StreamStatistics) -> Iterator[str]:
    if report.camera is not None:
        yield _row("camera", _trajectory(report.camera))
    for number, error in report.object_motion.items():
        yield _row(f"object {number}", _trajectory(error))


def _trajectory(error: TrajectoryError) -> str:
    return (
        f"ATE {error.ate_rmse_mm:.1f} mm (largest {error.ate_max_mm:.1f}), "
        f"RPE {error.rpe_translation_mm:.2f} mm {error.rpe_rotation_deg:.3f} deg"
    )


def _measure(name: str, value: float) -> str:
    if name.startswith("psnr"):
        return f"{value:.2f} dB"
    return f"{value:.1f} mm" if name.endswith("_mm") else f"{value:.4f}"
