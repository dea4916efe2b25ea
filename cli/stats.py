# SPDX-License-Identifier: MIT
"""`3dvc stats`: what a stream weighs, what moves in it, and how well it draws."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from threedvc.cli.options import force_option, json_option, reader_options, stream_argument
from threedvc.cli.plotting import check_plotting, is_plot, plot_statistics
from threedvc.cli.progress import Progress
from threedvc.cli.report_lines import report_lines
from threedvc.cli.requests import ReaderRequest
from threedvc.formats.outputs import Kind, check_target, is_direct, write_output

if TYPE_CHECKING:
    from threedvc.formats.evaluation.report import FrameStatistics

__all__ = ["stats"]

FRAME_COLUMNS = ("frame", "timestamp_ns", "bytes", "entropy_bits", "status", "visible_objects", "sensor")
TRAJECTORY_HEADING = "# trajectory by 3dvc stats:"
STANDARD_OUTPUT = "-"
POSITION_COLUMNS = ("camera_x_m", "camera_y_m", "camera_z_m")


@click.command(short_help="Report sizes and quality of a stream.")
@stream_argument
@click.option("--reference", "references", type=click.Path(path_type=Path), metavar="FOLDER", multiple=True,
              help="Compare with these frames; once for each sensor of the stream.")  # fmt: skip
@reader_options
@json_option
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    metavar="FILE.png",
    help="Draw bytes, entropy, which objects are visible, and shares.",
)
@click.option("--per-frame", type=click.Path(path_type=Path), metavar="FILE.csv", help="Write a row for each frame.")
@click.option(
    "--trajectory",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write the (first sensor's) camera's poses: frame tx ty tz qx qy qz qw.",
)
@force_option
def stats(
    source: Path,
    references: tuple[Path, ...],
    as_json: bool,
    plot: Path | None,
    per_frame: Path | None,
    trajectory: Path | None,
    force: bool,
    **choices: Any,
) -> None:
    """Report sizes, objects, motion, entropy and, with --reference, the quality of INPUT.3dvc (- is standard input).

    The folder of --reference has the frames that were encoded, in any layout that encode reads. Poses and masks that
    are known there tell the errors of the trajectory and of the objects. It is read as the recording was; what the
    stream does not tell of that is given as for encode, once or once for each --reference.
    """
    from threedvc.formats.evaluation.statistics import statistics

    if plot is not None:
        check_plotting(plot)
    outputs = ((per_frame, _is_table, "table"), (trajectory, _is_trajectory, "trajectory"), (plot, is_plot, "plot"))
    _check_outputs([(path, kind, what) for path, kind, what in outputs if path is not None], source, force=force)
    with Progress("compare", None) as progress:
        report = statistics(
            source,
            references or None,
            options=ReaderRequest.of(choices).for_references(len(references)),
            on_frame=lambda index: progress.advance(index + 1),
            on_notice=lambda notice: click.echo(notice, err=True),
        )
    if per_frame is not None:
        write_output(per_frame, _table(report.per_frame), _is_table, "table", force=force)
    if trajectory is not None:
        write_output(trajectory, _trajectory(report.per_frame), _is_trajectory, "trajectory", force=force)
    if plot is not None:
        plot_statistics(report, plot, force=force)
    click.echo(report.to_json() if as_json else "\n".join(report_lines(report)))


def _check_outputs(outputs: Sequence[tuple[Path, Kind, str]], source: Path, *, force: bool) -> None:
    """Check before any work is done that files may be written, and that they are different ones."""
    places = [source.resolve()]
    for path, kind, what in outputs:
        if str(path) == STANDARD_OUTPUT:
            raise click.UsageError(
                f"the {what} and the report both write to standard output; name a file for the {what}"
            )
        if path.resolve() in places and not is_direct(path):
            raise click.UsageError(f"{path} is named twice; give every file a name of its own")
        places.append(path.resolve())
        check_target(path, kind, what, force=force)


def _is_table(head: bytes) -> bool:
    return head.startswith(",".join(FRAME_COLUMNS).encode())


def _is_trajectory(head: bytes) -> bool:
    return head.startswith(TRAJECTORY_HEADING.encode())


def _table(frames: Sequence[FrameStatistics]) -> bytes:
    measures = list(frames[0].quality) if frames else []
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*FRAME_COLUMNS, *POSITION_COLUMNS, *measures])
    for item in frames:
        position = (item.T_world_camera[:3, 3] + 0.0).tolist()
        writer.writerow([*(getattr(item, name) for name in FRAME_COLUMNS), *position, *item.quality.values()])
    return text.getvalue().encode()


def _trajectory(frames: Sequence[FrameStatistics]) -> bytes:
    from threedvc.formats.sinks.poses import pose_lines

    own = (item.T_world_camera for item in frames if not item.sensor)
    lines = pose_lines(enumerate(own))
    return "".join(f"{line}\n" for line in [TRAJECTORY_HEADING + lines[0].lstrip("#"), *lines[1:]]).encode()
