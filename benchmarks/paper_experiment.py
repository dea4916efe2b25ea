# SPDX-License-Identifier: MIT
"""Repeat the experiment of Martins and Moura (1995), sec. 3, and set its figures beside ours.

A gray video of 100x100 pixels shows one rigid object in motion before a static background; depth is
exact, poses are known, a depth threshold finds the object. The program prints a report and writes it
with streams and pictures into a folder::

    python benchmarks/paper_experiment.py build/paper
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import montage
from paper_report import EARLY, OBJECT, Result, Snapshot, report
from spheres import Spheres, View, draw, spheres_of_cells
from threedvc.config import ColorVideo, EncoderConfig, Motion, SegmentationConfig, SegmentationMode, Sensor
from threedvc.encoder.fusion.surface_extraction import extract_surface
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.reconstruction.scene_object import SceneObject
from threedvc.formats.container import open_output
from threedvc.formats.decoding import open_stream
from threedvc.formats.evaluation.statistics import statistics
from threedvc.formats.sinks.plain import PlainSink
from threedvc.formats.sources import open_sequence
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import rotation_from_vector
from threedvc.metrics.depth_errors import DepthErrors, depth_units
from threedvc.metrics.picture_quality import psnr
from threedvc.parallel import default_threads
from threedvc.synthesis import SyntheticSequence, make_scene
from threedvc.synthesis.scenes import PAPER_THRESHOLD_M
from threedvc.units import MILLIMETERS

__all__ = ["main", "run", "write_decoded", "write_input", "write_spheres"]

Picture = NDArray[np.uint8]

FRAMES = 150
"""Of the paper's video: 5 s."""
SEGMENTATION = SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0.1, far_m=PAPER_THRESHOLD_M)
"""The paper finds the object by a threshold of depth."""

# A cell whose probability is nearer to 1/2 was hardly measured.
LEARNED_LOG_ODDS = 0.1
SPHERES_WIDTH_PX = 800
"""Of a figure, on a page."""
ASIDE_RAD = np.radians(25.0)
"""Of views of the model against the camera's: aslant, so that depth is seen."""
DOWNWARD = -0.3
"""Slope of these views: a little from above."""
RANGE_ENLARGEMENT = 3
"""Pixels of 100x100 pictures would be too small to see."""
DARKEST_GRAY = 40
"""Of the farthest depth: black stands for none."""
ROW_HEIGHT_PX = 240
"""Of the montage of frames, on a page."""


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line, run the experiment, print and write the report."""
    parser = argparse.ArgumentParser(description="Repeat the experiment of Martins and Moura (1995).")
    parser.add_argument("folder", type=Path, nargs="?", default=Path("build/paper"), help="where everything goes")
    parser.add_argument("--frames", type=int, default=FRAMES, help=f"frames of the video (default: {FRAMES})")
    options = parser.parse_args(arguments)
    if options.frames < EARLY:
        parser.error(f"--frames {options.frames}: the experiment needs at least {EARLY}")
    folder: Path = options.folder
    source = folder / "input"
    write_input(source, options.frames)
    sequence = open_sequence(source)
    fine = run(sequence, folder / "pixel.3dvc", pixel_size(sequence))
    coarse = run(sequence, folder / "default.3dvc", None)
    write_decoded(sequence, folder / "pixel.3dvc", folder)
    write_spheres(fine, folder)
    text = report(fine, coarse)
    (folder / "report.md").write_text(text, encoding="utf-8")
    print(text)
    print(f"Report, streams and pictures: {folder}")


def write_input(folder: Path, frames: int) -> None:
    """Make the video, as ``3dvc synth --scene paper`` does."""
    sequence = SyntheticSequence(make_scene("paper", frames=frames))
    with PlainSink(folder, sequence.info) as sink:
        for frame in sequence:
            sink.write_frame(frame)


def pixel_size(sequence: FrameSequence) -> float:
    """Return what a pixel covers at the object's median depth in the first frame, in meters to 0.1 mm."""
    depth = sequence[0].depth
    near = depth[(depth > 0) & (depth < PAPER_THRESHOLD_M)]
    return round(float(np.median(near)) / sequence.info.rig.depth.fx, 4)


def run(sequence: FrameSequence, path: Path, voxel_size_m: float | None) -> Result:
    """Encode the sequence into a file and measure it; None: the encoder chooses the size of cells."""
    # Cameras and poses are exact as they are; refining them would only add error.
    config = EncoderConfig(
        color_video=ColorVideo.OFF,
        voxel_size_m=voxel_size_m,
        motion=Motion.KNOWN,
        sensor=Sensor.IDEAL,
        segmentation=SEGMENTATION,
        refine=False,
    )
    with open_output(path) as writer:
        for packet in Encoder(sequence.info, config).packets(sequence):
            writer.write(packet)
    psnr_db, depth = object_quality(sequence, path)
    return Result(
        snapshots=snapshots(sequence, config),
        statistics=statistics(path, sequence),
        object_psnr=psnr_db,
        object_depth=depth,
    )


def snapshots(sequence: FrameSequence, config: EncoderConfig) -> dict[int, Snapshot]:
    """Fuse the sequence as the encoder does; return the object's model after two and after all frames."""
    scene = Scene(sequence.info, config)
    found: dict[int, Snapshot] = {}
    for frame in sequence:
        scene.add(frame)
        if frame.index + 1 in (EARLY, len(sequence)):
            found[frame.index + 1] = snapshot(scene.objects[OBJECT])
    return found


def snapshot(item: SceneObject) -> Snapshot:
    """Read the model of an object as it is now."""
    model = item.evidence
    log_odds = model.log_odds[: model.index.count]
    cells, positions = model.index.flagged((log_odds > LEARNED_LOG_ODDS).astype(np.uint8))
    return Snapshot(
        voxel_size_m=model.voxel_size_m,
        sent=len(extract_surface(model, default_threads()).cells),
        cells=cells,
        probability=1 / (1 + np.exp(-log_odds.reshape(-1)[positions].astype(np.float64))),
        colors=model.color.reshape(-1, 3)[positions],
        T_camera_object=item.poses[-1],
    )


def object_quality(sequence: FrameSequence, path: Path) -> tuple[float, DepthErrors]:
    """Return mean PSNR and pooled depth errors of a stream over the pixels of the object."""
    unit_mm = MILLIMETERS / sequence.info.depth_scale
    psnrs: list[float] = []
    errors: list[DepthErrors] = []
    for given, drawn in zip(sequence, open_stream(path), strict=True):
        here = (given.depth > 0) & (given.depth < PAPER_THRESHOLD_M)
        psnrs.append(psnr(given.color[here], drawn.color[here]))
        expected, found = (
            depth_units(np.where(here, depth, np.float32(0)), sequence.info.depth_scale)
            for depth in (given.depth, drawn.depth)
        )
        errors.append(DepthErrors.measure(expected, found, unit_mm))
    return float(np.mean(psnrs)), sum(errors[1:], start=errors[0])


def write_decoded(sequence: FrameSequence, path: Path, folder: Path) -> None:
    """Write the decoded frames, every range picture beside its input, and a montage of a few frames."""
    stream = open_stream(path)
    (folder / "range").mkdir(exist_ok=True)
    near_m = min(float(frame.depth[frame.depth > 0].min()) for frame in sequence)
    far_m = max(float(frame.depth.max()) for frame in sequence)
    with PlainSink(folder / "decoded", stream.info) as sink:
        for given, drawn in zip(sequence, stream, strict=True):
            sink.write(
                drawn.index,
                drawn.timestamp_ns,
                color=drawn.color,
                depth=drawn.depth,
                labels=drawn.labels,
                T_world_camera=drawn.T_world_camera,
                T_camera_object=drawn.T_camera_object,
            )
            pair = np.hstack([range_picture(depth, near_m, far_m) for depth in (given.depth, drawn.depth)])
            write_picture(folder / "range" / f"{drawn.index:06}.png", pair)
    chosen = montage.chosen_frames(None, len(sequence))
    write_picture(folder / "frames.png", montage.montage(folder / "input", folder / "decoded", chosen, ROW_HEIGHT_PX))


def range_picture(depth: NDArray[np.float32], near_m: float, far_m: float) -> Picture:
    """Return depth in meters as gray by its inverse, near is bright and nothing is black, each pixel enlarged."""
    valid = depth > 0
    inverse = 1 / np.where(valid, depth, far_m)
    nearness = np.clip((inverse - 1 / far_m) / (1 / near_m - 1 / far_m), 0, 1)
    gray = np.where(valid, DARKEST_GRAY + (255 - DARKEST_GRAY) * nearness, 0).astype(np.uint8)
    return np.kron(gray, np.ones((RANGE_ENLARGEMENT, RANGE_ENLARGEMENT), dtype=np.uint8))


def write_spheres(result: Result, folder: Path) -> None:
    """Draw the model after two and after all frames, from the camera's side and from the other."""
    forward = result.early.T_camera_object[2, :3]
    final = _spheres(result.final)
    for count, state in result.snapshots.items():
        pictures: list[Picture] = []
        for side, turn in (("the camera's side", ASIDE_RAD), ("the other side", ASIDE_RAD + np.pi)):
            level = rotation_from_vector(np.array([0.0, 0.0, turn])) @ forward
            view = View.around(final, np.array([level[0], level[1], DOWNWARD]), SPHERES_WIDTH_PX)
            drawn = draw(_spheres(state), view)[..., ::-1]
            pictures.append(montage.labeled(drawn, view.height, f"model after {count} frames, from {side}"))
        write_picture(folder / f"spheres_{count:03}.png", np.vstack(pictures))


def _spheres(state: Snapshot) -> Spheres:
    return spheres_of_cells(state.cells, state.probability, state.colors, state.voxel_size_m)


def write_picture(path: Path, picture: Picture) -> None:
    """Write a picture, BGR or gray."""
    if not cv2.imwrite(str(path), picture):
        raise SystemExit(f"{path}: cannot be written; choose another folder")


if __name__ == "__main__":
    main()
