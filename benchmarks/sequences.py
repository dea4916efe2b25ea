# SPDX-License-Identifier: MIT
"""Encode, decode and score recorded sequences with the settings of `RUNS`; write the table of results.

Every step is a run of ``3dvc`` in a process of its own, so that time and memory are those of a user::

    python benchmarks/sequences.py [FOLDER...] [--frames A:B] [--output FILE.md]

Without folders all sequences of `RUNS` are taken from ``$THREEDVC_DATA``, or from ``../shared/data``. A folder
that no run names is encoded with the encoder's own choices.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reporting import REPOSITORY, commit, markdown_table
from speed import PROGRAM, Cost, measured
from threedvc.parallel import default_threads

__all__ = ["RUNS", "Outcome", "Run", "main", "results", "runs_of"]

DATA = Path(os.environ.get("THREEDVC_DATA") or REPOSITORY.parent / "shared" / "data")
WORK = REPOSITORY / "build" / "bench"
BUSY_LOAD = 0.5
"""Tasks per processor from which a warning is given: times would be too long."""
HEADER = (
    "sequence", "options", "bytes", "kbit/s", "ratio", "PSNR RGB", "PSNR Y", "SSIM Y", "within 1 %", "lost",
    "median mm", "ATE mm", "lost poses", "encode fps", "decode fps", "encode MiB", "decode MiB",
)  # fmt: skip
NOTE = """\
Bytes are those of the whole file; the ratio is against raw 8-bit color and 16-bit depth. PSNR and SSIM are means over
frames, in dB; "within 1 %" and "median" are depth errors over the pixels measured in the input, "lost" the fraction of
them without decoded depth. ATE is the error of the camera's trajectory, or the largest of the objects', against the
poses of the input. Frames per second and peak memory are those of whole commands, with their start and with reading
and writing PNG files, on all cores."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One line of the table: a sequence by the name of its folder, and options of ``3dvc encode``.

    Comparisons with other codecs also name rates in kbit/s.
    """

    sequence: str
    options: str = ""
    rates: tuple[float, ...] = ()


RUNS = (
    Run(sequence="kitchen300", options="--voxel-size 16mm --motion known"),
    Run(sequence="kitchen300", options="--voxel-size 16mm --motion track"),
    Run(sequence="fr1_rpy", options="--motion known"),
    Run(sequence="fr1_rpy", options="--motion track"),
    Run(sequence="realsense_desk", options="--max-depth 4m"),
    Run(sequence="iphone_door", options="--motion known"),
    Run(sequence="iphone_door", options="--motion track"),
    Run(sequence="room_orbit", options="--segment none --motion known"),
    Run(sequence="room_orbit", options="--segment none --motion track"),
    Run(sequence="cereal_box", options="--segment masks"),
    Run(sequence="paper_cow", options="--segment depth:0.1m..1.2m --motion known"),
    Run(sequence="paper_cow", options="--segment depth:0.1m..1.2m --motion track"),
    Run(sequence="cow_turn", options="--segment masks --motion known"),
    Run(sequence="cow_turn", options="--segment masks --motion track"),
    Run(sequence="two_toys", options="--segment masks --motion known"),
    Run(sequence="two_toys", options="--segment masks --motion track"),
)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one run came to.

    Attributes
    ----------
    statistics
        Report of ``3dvc stats --json``.
    encode, decode
        Costs of the two commands.
    """

    run: Run
    statistics: Mapping[str, Any]
    encode: Cost
    decode: Cost

    def row(self) -> list[str]:
        """Return the cells under `HEADER`."""
        report, quality = self.statistics, self.statistics["quality"]
        frames = report["frames"]
        return [
            self.run.sequence,
            self.run.options,
            f"{report['file_bytes']:,}",
            f"{report['kbit_s']:.1f}",
            f"{report['ratio']:.0f}",
            *(number(quality[name], 2) for name in ("psnr_rgb", "psnr_y")),
            *(number(quality[name], 4) for name in ("ssim_y", "depth_within_1pct", "depth_lost")),
            number(quality["depth_median_mm"], 1),
            number(trajectory_error(report["trajectory"]), 1),
            str(report["trajectory"]["status"].get("lost", 0)),
            *(f"{frames / cost.seconds:.1f}" for cost in (self.encode, self.decode)),
            *(f"{cost.peak_mib:.0f}" for cost in (self.encode, self.decode)),
        ]


def number(value: float | None, digits: int) -> str:
    """Return a number in words; what is not known is a dash."""
    return "-" if value is None else f"{value:.{digits}f}"


def trajectory_error(trajectory: Mapping[str, Any]) -> float | None:
    """Return the camera's error in mm, or the largest of the objects'; None where the input has no poses."""
    if "ate_rmse_mm" in trajectory:
        return float(trajectory["ate_rmse_mm"])
    return max((float(error["ate_rmse_mm"]) for error in trajectory.get("objects", {}).values()), default=None)


def runs_of(folders: Sequence[Path]) -> list[tuple[Path, Run]]:
    """Return the runs of each folder: those that name it, or one without options."""
    return [
        (folder, run)
        for folder in folders
        for run in [run for run in RUNS if run.sequence == folder.resolve().name]
        or [Run(sequence=folder.resolve().name)]
    ]


def recorded() -> list[Path]:
    """Return the folders of `DATA` that `RUNS` names, in its order."""
    return [DATA / name for name in dict.fromkeys(run.sequence for run in RUNS) if (DATA / name).is_dir()]


def outcome(folder: Path, run: Run, frames: str | None) -> Outcome:
    """Encode, decode and score one sequence; only the stream is kept.

    Raises
    ------
    SystemExit
        If a command fails.
    """
    stream, decoded = WORK / f"{run.sequence}.3dvc", WORK / run.sequence
    chosen = shlex.split(run.options) + (["--frames", frames] if frames else [])
    try:
        encode = measured(["encode", str(folder), str(stream), *chosen])
        decode = measured(["decode", str(stream), str(decoded)])
    finally:
        shutil.rmtree(decoded, ignore_errors=True)
    return Outcome(run=run, statistics=scored(stream, folder), encode=encode, decode=decode)


def scored(stream: Path, folder: Path) -> dict[str, Any]:
    """Return the report of ``3dvc stats`` on a stream against its input.

    Raises
    ------
    SystemExit
        If the command fails.
    """
    arguments = ["stats", str(stream), "--reference", str(folder), "--json"]
    result = subprocess.run([*PROGRAM, *arguments], capture_output=True, text=True, check=False)
    if result.returncode:
        sys.exit(f"3dvc {' '.join(arguments)}: {result.stderr}")
    report: dict[str, Any] = json.loads(result.stdout)
    return report


def warm_up() -> None:
    """Compile everything once, so that no run of the table has to."""
    folder, stream = WORK / "warm", WORK / "warm.3dvc"
    measured(["synth", str(folder), "--scene", "objects", "--frames", "4", "--size", "80x60"])
    measured(["encode", str(folder), str(stream), "--motion", "track"])
    measured(["encode", str(folder), str(stream), "--motion", "known"])
    measured(["decode", str(stream), str(WORK / "warm_decoded")])
    scored(stream, folder)


def results(outcomes: Sequence[Outcome], failures: Sequence[str]) -> str:
    """Return the report as Markdown."""
    table = markdown_table(HEADER, [item.row() for item in outcomes], text_columns=2)
    machine = f"{default_threads()} cores, {platform.machine()}, Python {platform.python_version()}"
    load = f"load {os.getloadavg()[0]:.1f} when it ended" if hasattr(os, "getloadavg") else "load not known"
    parts = [
        "# Recorded sequences",
        f"Written by `make bench` at commit {commit()}, on {machine}, {load}.",
        table,
        NOTE,
        *(f"Failed: `{failure}`." for failure in failures),
    ]
    return "\n\n".join(parts) + "\n"


def measured_runs(runs: Sequence[tuple[Path, Run]], frames: str | None, failures: list[str]) -> Iterator[Outcome]:
    """Yield the outcomes of runs, and note those that fail."""
    for place, (folder, run) in enumerate(runs, 1):
        print(f"{place}/{len(runs)} {run.sequence} {run.options}", file=sys.stderr, flush=True)
        try:
            yield outcome(folder, run, frames)
        except SystemExit as error:
            print(str(error.code).strip(), file=sys.stderr)
            failures.append(f"{run.sequence} {run.options}".strip())


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line, measure, print and write the table."""
    parser = argparse.ArgumentParser(description="Encode, decode and score recorded sequences.")
    parser.add_argument("folders", type=Path, nargs="*", help="sequences (default: those of the table in this file)")
    parser.add_argument("--frames", metavar="A:B", help="encode only these frames of each")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_name("SEQUENCES.md"), help="file to write")
    options = parser.parse_args(arguments)
    folders = options.folders or recorded()
    if not folders:
        print(f"no recorded sequences in {DATA}; set THREEDVC_DATA to their folder", file=sys.stderr)
        return
    if hasattr(os, "getloadavg") and os.getloadavg()[0] > BUSY_LOAD * default_threads():
        print("the machine is busy; times will be too long", file=sys.stderr)
    WORK.mkdir(parents=True, exist_ok=True)
    warm_up()
    failures: list[str] = []
    text = results(list(measured_runs(runs_of(folders), options.frames, failures)), failures)
    options.output.write_text(text, encoding="utf-8")
    print(text)
    if failures:
        sys.exit(f"{len(failures)} of the runs failed")


if __name__ == "__main__":
    main()
