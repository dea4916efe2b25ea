# SPDX-License-Identifier: MIT
"""The report of the paper's experiment: its accounting, eq. (8) to (10), beside what a real stream weighs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reporting import commit, markdown_table
from threedvc.formats.evaluation.report import StreamStatistics
from threedvc.geometry.pose import Pose
from threedvc.metrics.depth_errors import DepthErrors
from threedvc.metrics.paper_accounting import PaperAccounting
from threedvc.units import MILLIMETERS

__all__ = ["BACKGROUND", "CASES", "EARLY", "OBJECT", "PAPER_CELLS", "Case", "Result", "Snapshot", "report"]

BACKGROUND, OBJECT = 0, 1
"""Numbers of the two in the stream."""
EARLY = 2
"""Frames after which the paper counts cells in its realistic case."""
PAPER_CELLS = {2: 1056, 150: 3962}
"""M, the number of occupied cells that the paper gives, by frames."""


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
"""The results that the paper prints; its realistic ones under both readings of its motion."""


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
    return f"{MILLIMETERS * result.final.voxel_size_m:g} mm cells"


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
    ("cells of the background", lambda r: f"{MILLIMETERS * r.statistics.objects[BACKGROUND].voxel_size_m:g} mm"),
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
"""Rows of the table of the real stream: a name, and how a result tells it."""
