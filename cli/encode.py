# SPDX-License-Identifier: MIT
"""`3dvc encode`: a folder of RGB-D frames into a stream."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from threedvc.cli.options import (
    bit_rate,
    depth_error,
    duration,
    focus,
    force_option,
    frame_range,
    json_option,
    length,
    reader_options,
    segmentation,
    threads_option,
)
from threedvc.cli.progress import Progress
from threedvc.cli.requests import EncodeRequest
from threedvc.cli.signals import Terminated, stop_on_signals
from threedvc.errors import SequenceError
from threedvc.units import MILLIMETERS

if TYPE_CHECKING:
    from threedvc.formats.encoding import EncodeReport

__all__ = ["encode"]

STANDARD_OUTPUT = Path("-")
PRESETS = ("live", "fast", "medium", "slow")
SENSORS = ("auto", "ideal", "kinect1", "realsense", "lidar")


@click.command(short_help="Encode a folder of RGB-D frames.")
@click.argument("sources", metavar="INPUT", nargs=-1, type=click.Path(path_type=Path))
@click.argument("output", metavar="OUTPUT.3dvc", type=click.Path(path_type=Path, allow_dash=True))
@click.option("--input", "inputs", metavar="DIR", multiple=True, type=click.Path(path_type=Path),
              help="A further sensor's INPUT, or the first one's.")  # fmt: skip
@click.option("--extrinsics", metavar="FILE|TX,TY,TZ,QX,QY,QZ,QW", multiple=True,
              help="Pose of each sensor after the first in the first one's depth camera.  "
              "[default: T_rig_depth of intrinsics.json]")  # fmt: skip
@click.option("--delay", type=float, metavar="SECONDS", multiple=True,
              help="Add to the times of each sensor after the first.  [default: 0]")  # fmt: skip
@reader_options
@click.option("--max-depth", type=length, metavar="LENGTH", help="Ignore measurements beyond.")
@click.option("--frames", type=frame_range, metavar="A:B[:S]", help="Encode frames A to B-1, every S-th.")
@click.option("--voxel-size", type=length, metavar="LENGTH", help="Edge of a cell.  [default: from the first frame]")
@click.option("--motion", type=click.Choice(["auto", "known", "track"]), default="auto", show_default=True,
              help="Use the poses of INPUT, or track.")  # fmt: skip
@click.option("--segment", type=segmentation, metavar="none|depth:N..F|masks|motion|auto", default="auto",
              show_default=True,
              help="Divide frames into objects: not at all, by a depth range, by the masks of INPUT, by what moves; "
              "auto: by masks, and where there are none a file by what moves, if anything does."
              )  # fmt: skip
@click.option("--sensor", type=click.Choice(SENSORS), multiple=True, help="Noise of the depth.  [default: auto]")
@click.option("--preset", type=click.Choice(PRESETS), default="medium", show_default=True,
              help="How much work: send at once; fit colors; refine cameras and poses, too; for longer.")  # fmt: skip
@click.option("--latency", type=duration, metavar="TIME",
              help="Longest time that a frame waits for the others of its packets, such as 100ms or 2s (live).  "
              "[default: 1s]")  # fmt: skip
@click.option("--bitrate", type=bit_rate, metavar="RATE", help="Bits per second, such as 24k.")
@click.option("--quality", type=int, metavar="1..100",
              help="Fineness of cells and colors: below 32 the smallest streams, at 50 at least 29 dB, at 90 visually "
              "lossless.  [default: 50]")  # fmt: skip
@click.option("--favor", type=click.Choice(["color", "depth"]),
              help="What gets more of the bytes of a file than usual.  [default: neither]")  # fmt: skip
@click.option("--relief", type=click.IntRange(0, 3), metavar="0..3",
              help="Bits that tell where in a cell the surface passes.  [default: 1 if cheap]")  # fmt: skip
@click.option("--depth-video", type=click.Choice(["auto", "on", "off"]), default="auto", show_default=True,
              help="Add a video of the depth as filmed, as far as the rate leaves room; auto: where it is not rigid, "
              "if it is worth its bytes (medium, slow).")  # fmt: skip
@click.option("--depth-error", type=depth_error, default="model", show_default=True,
              metavar="model|5mm|1%|level|lossless",
              help="Largest error of every measured depth: that of the models, a length, a share, the next depth that "
              "the sensor tells, or none.")  # fmt: skip
@click.option("--color-video", type=click.Choice(["auto", "on", "off"]), default="auto", show_default=True,
              help="Add a video of the pictures in place of the models' colors; auto: if that looks better at as many "
              "bytes, or live if the rate has room for it.")  # fmt: skip
@click.option("--lossless", is_flag=True,
              help="Keep every color and depth exactly: the same as --color-video on, without loss, and --depth-error "
              "lossless.")  # fmt: skip
@click.option("--focus", type=focus, multiple=True, metavar="OBJECT|BOX=WEIGHT",
              help="Let errors of an object's colors, or in a box X0..X1,Y0..Y1,Z0..Z1 of the background, count more."
              )  # fmt: skip
@click.option("--causal", is_flag=True, help="The same as --preset live.")
@click.option("--verify", is_flag=True, help="Decode while encoding and compare.")
@force_option
@threads_option
@json_option
def encode(
    sources: tuple[Path, ...],
    inputs: tuple[Path, ...],
    output: Path,
    verify: bool,
    force: bool,
    as_json: bool,
    **choices: Any,
) -> None:
    """Encode the RGB-D frames in the folder INPUT into a stream; OUTPUT.3dvc may be - (standard output).

    Lengths: 8mm, 1cm, 0.02m; a plain number is meters.

    A live encode that is interrupted or terminated ends its stream with the frames so far; others keep what can be
    decoded beside OUTPUT.3dvc, as OUTPUT.3dvc.part, or leave nothing.

    Several sensors that are mounted together have a folder each, INPUT and --input; options from --layout to --fps
    and --sensor are then given once, or once for each sensor in their order.
    """
    from threedvc.formats import encoding
    from threedvc.formats.container import check_output

    if as_json and output == STANDARD_OUTPUT:
        raise click.UsageError("--json and the output - both write to standard output; name a file for one of them")
    folders = [*sources, *inputs]
    if not folders:
        raise click.UsageError("no INPUT; name the folder of RGB-D frames, then OUTPUT.3dvc")
    request = EncodeRequest(**choices)
    config = request.configuration(len(folders))
    check_output(output, force=force)
    sequence = request.open(folders)
    info = sequence.info
    live = config.causal
    with ExitStack() as opened:
        progress = opened.enter_context(Progress("encode", info.frame_count, info.fps))
        stop = opened.enter_context(stop_on_signals()) if live else None
        try:
            report = encoding.encode(
                sequence,
                output,
                config,
                verify=verify,
                force=force,
                on_frame=lambda frame: progress.advance(frame.index + 1, frame.bytes_so_far),
                on_notice=lambda notice: click.echo(notice, err=True),
                stop=stop,
            )
        except SequenceError:
            if stop is not None and stop.number is not None:  # before the first frame
                raise Terminated(stop.number) from None
            raise
        progress.summary(_summary(report, output))
    if as_json:
        click.echo(json.dumps(_as_map(report), indent=1))
    if stop is not None and stop.number is not None:
        ended = Terminated(stop.number)
        ended.add_note(f"{output} holds the {report.frames} frames so far")
        raise ended


def _summary(report: EncodeReport, output: Path) -> str:
    lost = f", lost: {len(report.lost_frames)}" if report.lost_frames else ""
    return (
        f"{output}: {report.frames} frames, {report.file_bytes:,} bytes, "
        f"{report.file_bytes * 8 / report.duration_s / 1000:.1f} kbit/s, "
        f"cells of {MILLIMETERS * report.voxel_size_m:g} mm, {report.frames / report.seconds:.1f} frames/s{lost}"
    )


def _as_map(report: EncodeReport) -> dict[str, Any]:
    return {
        "file_bytes": report.file_bytes,
        "frames": report.frames,
        "duration_s": report.duration_s,
        "kbit_s": report.file_bytes * 8 / report.duration_s / 1000,
        "seconds": report.seconds,
        "latency_s": report.latency_s,
        "voxel_size_m": report.voxel_size_m,
        "lost_frames": list(report.lost_frames),
        "digest": report.digest.hex(),
        "notices": [asdict(notice) for notice in report.notices],
    }
