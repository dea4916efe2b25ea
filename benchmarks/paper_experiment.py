# SPDX-License-Identifier: MIT
"""Repeat the experiment of Martins and Moura (1995), sec. 3, and set its figures beside ours.

A grey video of 100x100 pixels shows one rigid object in motion before a static background; depth is
exact, poses are known, a depth threshold finds the object. The program prints a report and writes it
with streams and pictures into a folder::

    python benchmarks/paper_experiment.py build/paper
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import montage
import numpy as np
from numpy.typing import NDArray
from reporting import commit, markdown_table
from spheres import Spheres, View, draw, spheres_of_cells

from threedvc.config import EncoderConfig, Motion, SegmentationConfig, SegmentationMode, Sensor
from threedvc.encoder import Encoder
from threedvc.formats.api import open_stream
from threedvc.formats.container import open_output
from threedvc.formats.sinks.plain import PlainSink
from threedvc.formats.sources import open_sequence
from threedvc.formats.statistics import StreamStatistics, statistics
from threedvc.frame import FrameSequence
from threedvc.metrics import DepthErrors, PaperAccounting, depth_units, psnr
from threedvc.parallel import default_threads
from threedvc.pose import Pose, rotation_from_vector
from threedvc.readout import read_surface
from threedvc.report import FrameReport
from threedvc.scene import SceneObject
from threedvc.synthesis import SyntheticSequence, make_scene
from threedvc.synthesis.scenes import PAPER_THRESHOLD_M

__all__ = ["CASES", "Case", "Result", "Snapshot", "accounting_rows", "main", "report", "run"]

Picture = NDArray[np.uint8]

FRAMES = 150
SEGMENTATION = SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0.1, far_m=PAPER_THRESHOLD_M)
BACKGROUND, OBJECT = 0, 1
EARLY = 2
PAPER_CELLS = {2: 1056, 150: 3962}

# A cell whose probability is nearer to 1/2 was hardly measured.
LEARNED_LOG_ODDS = 0.1
SPHERES_WIDTH_PX = 800
ASIDE_RAD = np.radians(25.0)
DOWNWARD = -0.3
RANGE_ENLARGEMENT = 3
ROW_HEIGHT_PX = 240


@dataclass(frozen=True, kw_only=True)
class Case:
    """A line of the paper's results.

    Attributes
    ----------
    name
        What it stands for.
    sight
        Frames after which the model has M cells: the paper takes 2 for a realistic and 150 for the worst case.
    frames, pose_frames, pose_rule
        F, F_m, and how F_m follows from F.
    paper
        N of the 1:N that the paper prints.
    """

    name: str
    sight: int
    frames: int
    pose_frames: float
    pose_rule: str
    paper: int

    def ratio(self, cells: int) -> float:
        """Return N of 1:N by eq. (8)-(10) for M cells."""
        return PaperAccounting(cells=cells, pose_frames=self.pose_frames, frames=self.frames).ratio


CASES = (
    Case(name="worst case, 5 s", sight=150, frames=150, pose_frames=150, pose_rule="F", paper=77),
    Case(name="worst case, 1 min", sight=150, frames=1800, pose_frames=1800, pose_rule="F", paper=304),
    Case(name="realistic, 5 s", sight=2, frames=150, pose_frames=45, pose_rule="3F/10", paper=277),
    Case(name="realistic, 5 s", sight=2, frames=150, pose_frames=50, pose_rule="F/3", paper=277),
    Case(name="realistic, 1 min", sight=2, frames=1800, pose_frames=540, pose_rule="3F/10", paper=967),
    Case(name="realistic, 1 min", sight=2, frames=1800, pose_frames=600, pose_rule="F/3", paper=967),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """The model of the object after some frames.

    Attributes
    ----------
    sent
        Number of cells that the decoder needs: those at the surface.
    cells, probability, colors
        (n, 3), (n,), (n, 3): the cells that are occupied by maximum a posteriori, inside ones included.
    T_camera_object
        Pose in the last of the frames.
    """

    voxel_size_m: float
    sent: int
    cells: NDArray[np.int32]
    probability: NDArray[np.float64]
    colors: NDArray[np.float32]
    T_camera_object: Pose


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """One encoding of the sequence.

    Attributes
    ----------
    snapshots
        By number of frames: after two, and after all.
    statistics
        Of the stream, compared with the input.
    object_psnr, object_depth
        PSNR in dB, mean over frames, and depth errors over the pixels of the object alone.
    """

    snapshots: Mapping[int, Snapshot]
    statistics: StreamStatistics
    object_psnr: float
    object_depth: DepthErrors

    @property
    def early(self) -> Snapshot:
        """The model after two frames."""
        return self.snapshots[min(self.snapshots)]

    @property
    def final(self) -> Snapshot:
        """The model after all frames."""
        return self.snapshots[max(self.snapshots)]


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
    """Return what a pixel covers at the object's median depth in the first frame, in metres to 0.1 mm."""
    depth = sequence[0].depth
    near = depth[(depth > 0) & (depth < PAPER_THRESHOLD_M)]
    return round(float(np.median(near)) / sequence.info.rig.depth.fx, 4)


def run(sequence: FrameSequence, path: Path, voxel_size_m: float | None) -> Result:
    """Encode the sequence into a file and measure it; None: the encoder chooses the size of cells."""
    config = EncoderConfig(
        voxel_size_m=voxel_size_m, motion=Motion.KNOWN, sensor=Sensor.IDEAL, segmentation=SEGMENTATION
    )
    encoder = Encoder(sequence.info, config)
    snapshots: dict[int, Snapshot] = {}

    def keep(frame: FrameReport) -> None:
        if frame.index + 1 in (EARLY, len(sequence)):
            snapshots[frame.index + 1] = snapshot(encoder.scene.objects[OBJECT])

    with open_output(path) as writer:
        for packet in encoder.packets(sequence, keep):
            writer.write(packet)
    psnr_db, depth = object_quality(sequence, path)
    return Result(snapshots=snapshots, statistics=statistics(path, sequence), object_psnr=psnr_db, object_depth=depth)


def snapshot(item: SceneObject) -> Snapshot:
    """Read the model of an object as it is now."""
    model = item.evidence
    log_odds = model.log_odds[: model.index.count]
    cells, positions = model.index.flagged((log_odds > LEARNED_LOG_ODDS).astype(np.uint8))
    return Snapshot(
        voxel_size_m=model.voxel_size_m,
        sent=len(read_surface(model, default_threads()).cells),
        cells=cells,
        probability=1 / (1 + np.exp(-log_odds.reshape(-1)[positions].astype(np.float64))),
        colors=model.color.reshape(-1, 3)[positions],
        T_camera_object=item.poses[-1],
    )


def object_quality(sequence: FrameSequence, path: Path) -> tuple[float, DepthErrors]:
    """Return mean PSNR and pooled depth errors of a stream over the pixels of the object."""
    unit_mm = 1000 / sequence.info.depth_scale
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
    first = sequence[0].depth
    near_m, far_m = float(first[first > 0].min()), float(first.max())
    with PlainSink(folder / "decoded", stream.info) as sink:
        for given, drawn in zip(sequence, stream, strict=True):
            sink.write(drawn.index, drawn.timestamp_ns, color=drawn.color, depth=drawn.depth, labels=drawn.labels)
            pair = np.hstack([range_picture(depth, near_m, far_m) for depth in (given.depth, drawn.depth)])
            write_picture(folder / "range" / f"{drawn.index:06}.png", pair)
    chosen = montage.chosen_frames(None, len(sequence))
    write_picture(folder / "frames.png", montage.montage(folder / "input", folder / "decoded", chosen, ROW_HEIGHT_PX))


def range_picture(depth: NDArray[np.float32], near_m: float, far_m: float) -> Picture:
    """Return depth in metres as grey, near is bright and nothing is black, each pixel enlarged."""
    nearness = np.clip((far_m - depth) / max(far_m - near_m, 1e-9), 0, 1)
    grey = np.where(depth > 0, 40 + 215 * nearness, 0).astype(np.uint8)
    return np.kron(grey, np.ones((RANGE_ENLARGEMENT, RANGE_ENLARGEMENT), dtype=np.uint8))


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
            pictures.append(montage.labelled(drawn, view.height, f"model after {count} frames, from {side}"))
        write_picture(folder / f"spheres_{count:03}.png", np.vstack(pictures))


def _spheres(state: Snapshot) -> Spheres:
    return spheres_of_cells(state.cells, state.probability, state.colors, state.voxel_size_m)


def write_picture(path: Path, picture: Picture) -> None:
    """Write a picture, BGR or grey."""
    if not cv2.imwrite(str(path), picture):
        raise SystemExit(f"{path}: cannot be written; choose another folder")


def report(fine: Result, coarse: Result) -> str:
    """Return the report as Markdown.

    Parameters
    ----------
    fine, coarse
        The experiment with cells of a pixel, which the paper's own M suggests, and with the encoder's choice.
    """
    parts = [
        "# The experiment of 1995",
        f"Written by `make paper` at commit {commit()}; docs/paper.md explains it.",
        "## Occupied cells M of the object",
        markdown_table(*cell_table(fine, coarse)),
        "## Compression 1:N by the paper's equations",
        markdown_table(
            ["case", "F_m", "F", "paper", "M of the paper", "1:N", "our M", "1:N"],
            accounting_rows(fine),
            text_columns=2,
        ),
        *remarks(),
        "## The real stream",
        markdown_table(["", *(cells_of(result) for result in (fine, coarse))], stream_rows(fine, coarse)),
    ]
    return "\n\n".join(parts) + "\n"


def cell_table(*results: Result) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the numbers of cells."""
    header = ["after"]
    header += [f"{kind}, {cells_of(result)}" for result in results for kind in ("sent", "P > 1/2")]
    rows = []
    for count in sorted(results[0].snapshots):
        states = [result.snapshots[count] for result in results]
        numbers = [number for state in states for number in (state.sent, len(state.cells))]
        paper = PAPER_CELLS.get(count)
        rows.append([f"{count} frames", *map(str, numbers), "" if paper is None else str(paper)])
    return [*header, "paper"], rows


def cells_of(result: Result) -> str:
    """Return the size of the object's cells in words."""
    return f"{1000 * result.final.voxel_size_m:g} mm cells"


def accounting_rows(result: Result) -> list[list[str]]:
    """Return every case with the ratio as printed, by the equations for the paper's M, and for ours."""
    rows = []
    for case in CASES:
        theirs = PAPER_CELLS[case.sight]
        ours = result.early.sent if case.sight == EARLY else result.final.sent
        ratios = [f"{case.ratio(cells):.1f}" for cells in (theirs, ours)]
        rows.append(
            [case.name, case.pose_rule, str(case.frames), str(case.paper), str(theirs), ratios[0], str(ours), ratios[1]]
        )
    return rows


def remarks() -> Iterator[str]:
    """Say which F_m gives the figures that the paper prints."""
    for rule in dict.fromkeys(case.pose_rule for case in CASES):
        cases = [case for case in CASES if case.pose_rule == rule]
        found = [case for case in cases if abs(case.ratio(PAPER_CELLS[case.sight]) - case.paper) < 1]
        verb = "reproduces" if len(found) == len(cases) else "does not reproduce"
        yield f"F_m = {rule} {verb} the paper's {' and '.join(str(case.paper) for case in cases)}."


def stream_rows(*results: Result) -> list[list[str]]:
    """Return what the streams weigh and how well they draw, a column for each."""
    return [[name, *(tell(result) for result in results)] for name, tell in STREAM_ROWS]


def _model_bytes(item: StreamStatistics) -> int:
    return item.objects[OBJECT].bytes - item.packets["POSE"].bytes


def _measure(name: str, form: str) -> Callable[[Result], str]:
    return lambda result: form.format((result.statistics.quality or {})[name])


STREAM_ROWS: tuple[tuple[str, Callable[[Result], str]], ...] = (
    ("cells of the background", lambda r: f"{1000 * r.statistics.objects[BACKGROUND].voxel_size_m:g} mm"),
    ("file", lambda r: f"{r.statistics.file_bytes:,} bytes"),
    ("rate", lambda r: f"{r.statistics.kbit_s:.2f} kbit/s"),
    ("against the 8-bit video (eq. 9)", lambda r: f"1:{r.statistics.paper.raw_bytes / r.statistics.file_bytes:.0f}"),
    ("against video and 16-bit range", lambda r: f"1:{r.statistics.ratio:.0f}"),
    ("eq. (8) for this M and F_m", lambda r: f"{r.statistics.paper.coded_bytes:,} bytes"),
    ("F_m, frames with a pose", lambda r: str(r.statistics.objects[OBJECT].poses)),
    (
        "bytes per pose (paper: 24)",
        lambda r: f"{r.statistics.packets['POSE'].bytes / r.statistics.paper.pose_frames:.2f}",
    ),
    ("M, cells of the object", lambda r: str(r.statistics.objects[OBJECT].cells)),
    (
        "bits per cell (paper: 32)",
        lambda r: f"{8 * _model_bytes(r.statistics) / r.statistics.objects[OBJECT].cells:.2f}",
    ),
    ("model of the object", lambda r: f"{_model_bytes(r.statistics):,} bytes"),
    ("background (paper: not counted)", lambda r: f"{r.statistics.objects[BACKGROUND].bytes:,} bytes"),
    ("PSNR", _measure("psnr_rgb", "{:.2f} dB")),
    ("SSIM", _measure("ssim_y", "{:.4f}")),
    ("range: RMSE", _measure("depth_rmse_mm", "{:.1f} mm")),
    ("range: median error", _measure("depth_median_mm", "{:.1f} mm")),
    ("range: within 1 %", _measure("depth_within_1pct", "{:.4f}")),
    ("range: lost", _measure("depth_lost", "{:.4f}")),
    ("object alone: PSNR", lambda r: f"{r.object_psnr:.2f} dB"),
    ("object alone: range RMSE", lambda r: f"{r.object_depth.rmse_mm():.1f} mm"),
    ("object alone: range median error", lambda r: f"{r.object_depth.quantile_mm(0.5):.1f} mm"),
    ("object alone: range within 10 mm", lambda r: f"{r.object_depth.within_mm(10):.4f}"),
)


if __name__ == "__main__":
    main()
