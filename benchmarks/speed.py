# SPDX-License-Identifier: MIT
"""Measure how fast whole commands run, start-up included, and how much memory they take at most.

Sequences are made by ``3dvc synth``; folders given on the command line are measured, too::

    python benchmarks/speed.py [FOLDER...] [--output FILE.md]
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from reporting import commit, markdown_table
from threedvc.parallel import default_threads

__all__ = ["Cost", "main", "measured"]

PROGRAM = [sys.executable, "-c", "from threedvc.cli.main import main; main()"]
SYNTHETIC = {
    "paper": ["--scene", "paper", "--frames", "60"],
    "objects": ["--scene", "objects", "--frames", "60"],
    "room": ["--scene", "room", "--frames", "60", "--noise", "kinect"],
}
VOXEL_SIZE = "16mm"
KIBIBYTES = 1 if sys.platform.startswith("linux") else 1024  # the unit of ru_maxrss


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one run of a command took: wall time in seconds, and peak memory in MiB."""

    seconds: float
    peak_mib: float


def measured(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> Cost:
    """Run ``3dvc`` with some arguments.

    Raises
    ------
    SystemExit
        If the command fails.
    """
    began = time.perf_counter()
    surroundings = {**os.environ, **(environment or {})}
    process = subprocess.Popen(
        [*PROGRAM, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=surroundings
    )
    assert process.stderr is not None
    message = process.stderr.read().decode()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"3dvc {' '.join(arguments)}: {message}")
    return Cost(seconds=time.perf_counter() - began, peak_mib=usage.ru_maxrss / KIBIBYTES / 1024)


def frame_count(folder: Path) -> int:
    """Return the number of frames of a folder of the plain layout."""
    return len(list((folder / "depth").glob("*.png")))


def rows(folder: Path, place: Path) -> Iterator[list[str]]:
    """Yield the rows of one sequence: encoding and decoding, on one thread and on all."""
    frames, stream = frame_count(folder), place / f"{folder.name}.3dvc"
    motions = ["known", "track"] if has_poses(folder) else ["track"]
    for threads in sorted({1, default_threads()}):
        choice = ["--threads", str(threads)]
        for motion in motions:
            options = ["--voxel-size", VOXEL_SIZE, "--motion", motion, *choice]
            cost = measured(["encode", str(folder), str(stream), *options])
            yield row(folder.name, f"encode, {motion}", threads, frames, cost)
        cost = measured(["decode", str(stream), str(place / f"{folder.name}-{threads}"), *choice])
        yield row(folder.name, "decode", threads, frames, cost)


def has_poses(folder: Path) -> bool:
    """Tell whether a folder of the plain layout knows how things move."""
    return any((folder / name).is_file() for name in ("poses.txt", "object_poses.json"))


def row(sequence: str, job: str, threads: int, frames: int, cost: Cost) -> list[str]:
    """Return one line of the table."""
    rate = frames / cost.seconds
    return [sequence, job, str(threads), f"{cost.seconds:.2f}", f"{rate:.1f}", f"{cost.peak_mib:.0f}"]


def start_rows(folder: Path, place: Path) -> list[list[str]]:
    """Return what starting costs: help alone, and the first encode with no compiled code on disk."""
    few = ["--frames", "0:2", "--voxel-size", VOXEL_SIZE]
    encode = ["encode", str(folder), str(place / "start.3dvc"), *few]
    cold = {"NUMBA_CACHE_DIR": str(place / "empty")}
    costs = {
        "3dvc --help": measured(["--help"]),
        "encode 2 frames, nothing compiled": measured(encode, cold),
        "encode 2 frames, compiled before": measured(encode, cold),
    }
    return [[name, f"{cost.seconds:.2f}", f"{cost.peak_mib:.0f}"] for name, cost in costs.items()]


def report(folders: Sequence[Path], place: Path) -> str:
    """Measure everything and return it as Markdown."""
    start = start_rows(folders[0], place)
    for folder in folders:  # compiles what each sequence needs, so that the table has none of it
        measured(["encode", str(folder), str(place / "warm.3dvc"), "--frames", "0:3", "--motion", "track"])
        measured(["decode", str(place / "warm.3dvc"), str(place / "warm" / folder.name)])
    table = [line for folder in folders for line in rows(folder, place)]
    return "\n".join(
        [
            "# Speed",
            "",
            f"Written by `make bench` at commit {commit()}, on {machine()}. Cells of {VOXEL_SIZE}. Times are wall "
            "times of whole commands, with their start and with reading and writing PNG files.",
            "",
            markdown_table(["start", "s", "MiB"], start),
            "",
            markdown_table(["sequence", "job", "threads", "s", "frames/s", "MiB"], table, text_columns=2),
            "",
        ]
    )


def machine() -> str:
    """Return the processor and the number of threads in words."""
    model = platform.processor() or platform.machine()
    listing = Path("/proc/cpuinfo")
    if listing.is_file():
        lines = listing.read_text(encoding="utf-8").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    return f"{model}, {default_threads()} threads, Python {platform.python_version()}"


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line, measure, print and write the tables."""
    parser = argparse.ArgumentParser(description="Measure the speed of encoding and decoding.")
    parser.add_argument("folders", type=Path, nargs="*", help="sequences of the plain layout to measure, too")
    parser.add_argument("--scenes", default=",".join(SYNTHETIC), help="synthetic sequences (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_name("SPEED.md"), help="file to write")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        folders = [place / scene for scene in options.scenes.split(",")]
        for folder in folders:
            measured(["synth", str(folder), *SYNTHETIC[folder.name]])
        text = report([*folders, *options.folders], place)
    options.output.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
