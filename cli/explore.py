# SPDX-License-Identifier: MIT
"""`3dvc explore`: from where to record next."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from threedvc.cli.options import json_option, object_numbers, stream_argument, threads_option
from threedvc.cli.progress import Progress
from threedvc.units import MILLIMETERS

if TYPE_CHECKING:
    from threedvc.formats.view_planning import Exploration, ExploredObject
    from threedvc.view_planning.planner import Proposal

__all__ = ["explore"]

# Written out here because the module that defines them loads the compiler, which --help must not wait for.
SENSORS = ("ideal", "kinect1", "realsense", "lidar")


@click.command(short_help="Propose views to record next.")
@stream_argument
@click.option("--candidates", type=int, metavar="N", default=200, show_default=True,
              help="Views to choose from, for each object.")  # fmt: skip
@click.option("--best", type=int, metavar="K", default=5, show_default=True, help="Views to propose.")
@click.option("--objects", type=object_numbers, metavar="LIST",
              help="Explore these, such as 0,2; 0 is all that rests.  [default: what moves]")  # fmt: skip
@click.option("--sensor", type=click.Choice(SENSORS), default="kinect1", show_default=True,
              help="Noise and reach of the depth.")  # fmt: skip
@threads_option
@json_option
def explore(
    source: Path,
    candidates: int,
    best: int,
    objects: tuple[int, ...] | None,
    sensor: str,
    threads: int | None,
    as_json: bool,
) -> None:
    """Propose camera poses that would tell most of what INPUT.3dvc (- is standard input) leaves unknown.

    Views from where the camera can go, or of all sides of an object that moves, are ranked by the
    entropy that they are expected to take away, each beyond what the ones before it do.
    """
    from threedvc.config import ExplorationConfig, Sensor
    from threedvc.formats.view_planning import explore
    from threedvc.parallel import default_threads

    config = ExplorationConfig(
        candidates=candidates,
        best=best,
        objects=objects,
        sensor=Sensor(sensor),
        threads=threads or default_threads(),
    )
    with Progress("explore", None) as progress:
        report = explore(source, config, on_frame=lambda index: progress.advance(index + 1))
    click.echo(report.to_json() if as_json else "\n".join(_lines(report)))


def _lines(report: Exploration) -> Iterator[str]:
    state = "" if report.complete else "  TRUNCATED: the stream ends before its END packet"
    yield f"{report.name}, {report.frames} frames, {report.candidates:,} candidates{state}"
    yield ""
    yield f"{'object':>6} {'cells':>10} {'cell':>8} {'free':>6} {'occupied':>8} {'entropy':>15} {'in sight':>15}"
    yield from map(_object, report.objects)
    yield ""
    yield f"{'rank':>4} {'object':>6} {'gain':>13} {'share':>6} {'position (m)':>21} {'looks along':>18}  from last"
    yield from (_proposal(rank, item) for rank, item in enumerate(report.proposals, 1))


def _object(item: ExploredObject) -> str:
    return (
        f"{item.id:>6} {item.cells:>10,} {MILLIMETERS * item.cell_m:>5.0f} mm {item.free:>6.1%} {item.occupied:>8.1%}"
        f" {item.entropy_bits:>10,.0f} bits {item.in_sight_bits:>10,.0f} bits"
    )


def _proposal(rank: int, item: Proposal) -> str:
    place = " ".join(f"{value:6.2f}" for value in item.T_field_camera[:3, 3])
    way = " ".join(f"{value:5.2f}" for value in item.T_field_camera[:3, 2])
    turn = math.degrees(item.turn_rad)
    return (
        f"{rank:>4} {item.number:>6} {item.gain_bits:>8,.0f} bits {item.share:>6.1%} {place:>21} {way:>18}"
        f"  {item.move_m:.2f} m {turn:.0f} deg"
    )
