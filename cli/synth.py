# SPDX-License-Identifier: MIT
"""`3dvc synth`: an exact synthetic RGB-D sequence as a folder in the plain layout."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from threedvc.cli.options import force_option, picture_size, threads_option
from threedvc.cli.progress import Progress

__all__ = ["synth"]

# Written out here because the modules that define them load the compiler, which --help must not wait for.
SCENES = ("paper", "objects", "room")
NOISES = ("ideal", "kinect")


@click.command(short_help="Make a synthetic sequence with poses and masks.")
@click.argument("folder", metavar="OUTDIR", type=click.Path(path_type=Path))
@click.option("--scene", type=click.Choice(SCENES), required=True, help="What to show.")
@click.option("--frames", type=int, metavar="N", help="Number of frames.  [default: 150; objects: 120]")
@click.option(
    "--size", type=picture_size, metavar="WxH", help="Size of the pictures.  [default: 320x240; paper: 100x100]"
)
@click.option("--noise", type=click.Choice(NOISES), default="ideal", show_default=True, help="Depth sensor.")
@click.option("--sensors", type=click.IntRange(1, 16), metavar="N", default=1, show_default=True,
              help="Sensors that are mounted together; several write OUTDIR/sensor0, OUTDIR/sensor1, ...")  # fmt: skip
@click.option("--seed", type=int, metavar="N", default=0, show_default=True, help="Varies textures, motion and noise.")
@force_option
@threads_option
def synth(
    folder: Path,
    scene: str,
    frames: int | None,
    size: tuple[int, int] | None,
    noise: str,
    sensors: int,
    seed: int,
    force: bool,
    threads: int | None,
) -> None:
    """Render a scene into OUTDIR, with exact poses and, where things move, masks.

    \b
    paper    one gray toy before a wall, nearer than 1.2 m, as in the experiment of Martins & Moura (1995)
    objects  three toys that hide each other before a fixed camera; one of them pauses
    room     a hand-held camera in a furnished room that comes back to where it started
    """
    from threedvc.formats.sinks.plain import SYNTH, PlainSink, sensor_folder
    from threedvc.geometry.pose import inverse
    from threedvc.synthesis import make_scene, mounted_sequences

    sequences = mounted_sequences(make_scene(scene, frames=frames, size=size, seed=seed), sensors, noise, seed, threads)
    with Progress("synth", sum(len(sequence) for sequence, _ in sequences)) as progress:
        for number, (sequence, T) in enumerate(sequences):
            info = sequence.info.with_rigs([replace(sequence.info.rig, T_depth_rig=inverse(T))])
            place = folder if sensors == 1 else sensor_folder(folder, number)
            with PlainSink(place, info, mounted=sensors > 1, writer=SYNTH, force=force, threads=threads) as sink:
                for frame in sequence:
                    sink.write_frame(frame)
                    progress.advance(progress.frames + 1)
        progress.summary(f"{folder}: {progress.frames} frames, {progress.frames_per_second:.1f} frames/s")
