# SPDX-License-Identifier: MIT
"""`3dvc decode`: a stream into a folder of frames that `3dvc encode` can read."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from threedvc.cli.options import (
    decoded_outputs,
    force_option,
    frame_span,
    object_numbers,
    picture_size,
    stream_argument,
    threads_option,
)
from threedvc.cli.progress import Progress
from threedvc.errors import TruncatedStream
from threedvc.stream.packets import VideoCodec

if TYPE_CHECKING:
    from threedvc.geometry.pose import Pose

__all__ = ["decode"]

FILTERS = ("all", "none", "silhouettes", "surfaces")


@click.command(short_help="Decode a stream into a folder of frames.")
@stream_argument
@click.argument("folder", metavar="OUTDIR", type=click.Path(path_type=Path))
@click.option("--frames", type=frame_span, metavar="A:B", help="Decode frames A to B-1.")
@click.option("--what", type=decoded_outputs, metavar="LIST", default="color,depth,labels", show_default=True,
              help="Pictures to write.")  # fmt: skip
@click.option("--size", type=picture_size, metavar="WxH", help="Size of the pictures.  [default: as encoded]")
@click.option("--objects", type=object_numbers, metavar="LIST", help="Draw only these objects, such as 0,2.")
@click.option("--sensor", type=click.IntRange(min=0), metavar="N", help="Decode only this sensor's frames, from 0.")
@click.option("--camera-path", type=click.Path(path_type=Path), metavar="FILE",
              help="Draw from these viewpoints: lines as in poses.txt.")  # fmt: skip
@click.option("--filter", "filter_parts", type=click.Choice(FILTERS), default="all", show_default=True,
              help="Where to apply the stream's filter of color pictures.")  # fmt: skip
@click.option("--depth", "depth_from", type=click.Choice(["filmed", "models"]), default="filmed", show_default=True,
              help="Depth as filmed, where the stream has a video of it, or always that of the models.")  # fmt: skip
@click.option("--colors", "color_from", type=click.Choice(["filmed", "models"]), default="filmed", show_default=True,
              help="Color as filmed, where the stream has a video of it, or always that of the models.")  # fmt: skip
@click.option("--supersample", type=click.IntRange(1, 4), metavar="1..4",
              help="Rays per pixel side for color.  [default: 2 on small pictures, else 1]")  # fmt: skip
@force_option
@threads_option
def decode(
    source: Path,
    folder: Path,
    frames: tuple[int, int | None] | None,
    what: frozenset[str],
    size: tuple[int, int] | None,
    objects: tuple[int, ...] | None,
    sensor: int | None,
    camera_path: Path | None,
    filter_parts: str,
    depth_from: str,
    color_from: str,
    supersample: int | None,
    force: bool,
    threads: int | None,
) -> None:
    """Decode INPUT.3dvc (- is standard input) into color/, depth/ and masks/ with the cameras and poses in OUTDIR.

    An earlier output of decode is replaced when the first frame comes; other recordings stay as they are. The frames of
    several sensors go into OUTDIR/sensor0, OUTDIR/sensor1, ... A stream that ends too early is decoded
    as far as it goes; the exit code is then 1.
    """
    from threedvc.config import FilterParts, RenderConfig
    from threedvc.formats.decoding import open_stream
    from threedvc.formats.sinks.plain import PlainSink, sensor_folder
    from threedvc.parallel import default_threads

    stream = open_stream(
        source,
        frames=frames,
        what=what,
        size=size,
        objects=objects,
        camera_path=None if camera_path is None else _camera_path(camera_path),
        sensor=sensor,
        render=RenderConfig(
            supersample=supersample,
            filter_parts=FilterParts(filter_parts),
            captured_depth=depth_from == "filmed",
            captured_color=color_from == "filmed",
            threads=threads or default_threads(),
        ),
    )
    several = len(stream.infos) > 1 and sensor is None and camera_path is None
    with Progress("decode", stream.info.frame_count) as progress, ExitStack() as opened:
        opened.callback(stream.close)
        places = [sensor_folder(folder, number) for number in range(len(stream.infos))] if several else [folder]
        infos = stream.infos if several else [stream.info]
        sinks = [
            opened.enter_context(PlainSink(place, info, what=what, mounted=several, force=force))
            for place, info in zip(places, infos, strict=True)
        ]
        try:
            for frame in stream:
                sinks[frame.sensor if several else 0].write(
                    frame.number,
                    frame.timestamp_ns,
                    color=frame.color,
                    depth=frame.depth,
                    labels=frame.labels,
                    saturated=frame.saturated,
                    T_world_camera=frame.T_world_camera,
                    T_camera_object=frame.T_camera_object,
                    color_timestamp_ns=frame.color_timestamp_ns,
                )
                progress.advance(progress.frames + 1)
        except TruncatedStream as error:
            raise TruncatedStream(f"{error}; {progress.frames} frames were decoded into {folder}") from None
        for shown, codec in stream.unread_codecs.items():
            click.echo(f"{source}: {_unread(shown, codec)}", err=True)
        progress.summary(f"{folder}: {progress.frames} frames, {progress.frames_per_second:.1f} frames/s")


def _unread(shown: str, codec: int) -> str:
    decoders = {VideoCodec.AV1: "dav1d", VideoCodec.AV1_FULL_CHROMA: "dav1d", VideoCodec.FFV1: "FFV1"}
    remedy = f"install av with {decoders[VideoCodec(codec)]}" if codec in decoders else "use a newer 3dvc"
    models = {"color": "colors"}.get(shown, shown)
    return f"cannot decode its {shown} video (codec {codec}), so the pictures show the models' {models}; {remedy}"


def _camera_path(path: Path) -> list[Pose]:
    from threedvc.formats.sources.files.poses import pose_from_row
    from threedvc.formats.sources.files.text import read_rows

    return [pose_from_row(row) for row in read_rows(path)]
