# SPDX-License-Identifier: MIT
"""Measure what decoded frames are good for: odometry, reconstruction and matching, on raw and on coded frames.

Each task is done with the recording as it is, with frames that 3dvc gives back at several parts of the raw size, and
with AV1 pairs of the same sizes::

    python benchmarks/tasks.py [FOLDER...] [--scenes room] [--frames N] [--ratios 1000,...] [--out FILE.md]

Without folders the sequences of `RECORDED` are taken from ``$THREEDVC_DATA``, or from ``../shared/data``. Needs the
extra ``[bench]``. What was coded and every score are kept, so that a run that was broken off goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import math
import platform
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import task_scores
import task_tools
from av1 import MissingCodec, library
from rd import count
from rd_points import COLOR, DEPTH, Point, Recording, Score, Store, file_name
from reporting import REPOSITORY, commit, markdown_table
from sequences import DATA, Run
from task_inputs import RAW, Version, check_recording, made_scene, scene_of, versions
from task_scores import GAP, STRIDE, SURFACE_M, View, agreeing_matches, f_score, trajectory_scores
from task_tools import MissingTool, distances, fused, open3d, open3d_steps, opencv_steps
from threedvc import ThreedvcError
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose
from threedvc.parallel import default_threads
from threedvc.synthesis.sequence import SyntheticSequence

__all__ = ["MEASURES", "Measure", "Subject", "Tasks", "main", "report"]

OUTPUT = Path(__file__).with_name("TASKS.md")
STORE = REPOSITORY / "build" / "bench-tasks"
RECORDED = ("kitchen300", "fr1_rpy", "room_orbit", "iphone_door")
"""Recordings with poses of the camera."""
SCENES = ("room",)
"""Of `3dvc synth`: those whose camera moves."""
OPTIONS = "--motion track"
"""Of 3dvc: no pose of the input may help it, since tasks are scored against them."""
FRAMES = 60
"""Of each sequence: two seconds, more than the longest task looks back."""
RATIOS = (1000, 400, 150)
"""Of the raw size to that of the file: 1:1000 is the goal, the finer ones show what more bytes bring."""
QUALITY = "quality"
WORSE = " ✗"
"""Marks a score that is worse than on raw frames."""


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One row of the table for each sequence.

    Attributes
    ----------
    task, words
        As in the table.
    name
        Of the score.
    digits
        After the point.
    larger
        Whether larger is better.
    """

    task: str
    name: str
    words: str
    digits: int = 1
    larger: bool = False

    def shown(self, value: float) -> str:
        """Return a score as in the table."""
        return f"{value:.{self.digits}f}"

    def worse(self, value: float, than: float) -> bool:
        """Tell whether a score is worse than another, in what the table shows of them."""
        shown, raw = (round(score, self.digits) for score in (value, than))
        return shown < raw if self.larger else shown > raw


OPEN3D, OPENCV, SURFACE, MATCHES = "Open3D odometry", "OpenCV odometry", "Open3D reconstruction", "ORB matches"
MEASURES = (
    *(
        Measure(task=task, name=name, words=words, digits=digits)
        for task in (OPEN3D, OPENCV)
        for name, words, digits in (("ate_mm", "ATE mm", 1), ("rpe_mm", "RPE mm", 2), ("rpe_deg", "RPE deg", 3))
    ),
    Measure(task=SURFACE, name="f_score", words="F-score at 1 cm", digits=3, larger=True),
    Measure(task=MATCHES, name="matches", words="a pair", digits=0, larger=True),
)
NOTE = f"""\
Raw is uncompressed RGB and 16-bit depth; "3dvc 1:1000" are the frames decoded from a file that `--bitrate` holds to a
thousandth of that, encoded with `{OPTIONS}`, so that no pose of the input helps; "AV1 1:1000" are those of two AV1
videos (color; 10-bit inverse depth without holes) that together have at most the bytes of this file. Depth may have
half of them, color what it leaves, each at the part of its size and the quality that are best by its own measure.

ATE is the root of the mean squared distance of camera positions after alignment, RPE that of the error from frame to
frame, against the poses of the recording; both odometries get color and depth of each pair of frames in turn, and no
more. The reconstruction fuses depth at the true poses; its F-score holds the surface against that of depth without
noise, and is for synthetic scenes alone. Matches are mutual best ORB matches of pictures {GAP} frames apart that lie
within 3 pixels of where the depth and the poses of the recording put them, on an average over pairs. Smaller is better
but for the F-score and matches."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """A sequence that tasks are done with.

    Attributes
    ----------
    recording
        Its frames.
    exact
        Depth (h, w) float32 in meters without noise, by number of the frame, where it is known.
    """

    recording: Recording
    exact: Callable[[int], NDArray[np.float32]] | None = None

    @property
    def camera(self) -> Camera:
        """The camera of all pictures."""
        return self.recording.info.rig.depth

    @cached_property
    def poses(self) -> list[Pose]:
        """T_world_camera of all frames."""
        return [frame.T_world_camera for frame in self.recording.frames if frame.T_world_camera is not None]

    @cached_property
    def depths(self) -> list[NDArray[np.float32]]:
        """The best depth that is known of all frames."""
        if self.exact is None:
            return list(self.recording.depths())
        return [self.exact(number) for number in range(len(self.poses))]

    @cached_property
    def surface(self) -> object:
        """Points of the true surface."""
        return fused(self.depths, self.poses, self.camera)


@dataclass(frozen=True)
class Tasks:
    """All tasks of one sequence, done with one version of its frames after the other."""

    subject: Subject
    store: Store

    def names(self) -> list[str]:
        """Return the tasks that the sequence is good for."""
        tasks = [QUALITY, OPEN3D, OPENCV, MATCHES]
        return tasks if self.subject.exact is None else [*tasks, SURFACE]

    def scores(self, version: Version) -> dict[str, Point]:
        """Return the scores of a version by task; those that were measured before are taken as they are."""
        frames: list[Frame] = []

        def loaded() -> list[Frame]:
            if not frames:
                frames.extend(version.frames)
            return frames

        return {task: self._score(task, version, loaded) for task in self.names()}

    def _score(self, task: str, version: Version, frames: Callable[[], list[Frame]]) -> Point:
        place = self.store.place(self.subject.recording, file_name(f"{version.name} {task}"))
        doing = {
            QUALITY: self.quality,
            OPEN3D: self.open3d_odometry,
            OPENCV: self.opencv_odometry,
            MATCHES: self.matches,
            SURFACE: self.surface,
        }[task]

        def measure() -> Point:
            return Point(setting=version.setting, size=version.size, quality=doing(frames()))

        point = self.store.point(place, f"{version.codec}, {version.size} bytes, {tools()}", measure)
        scores = ", ".join(f"{name} {value:.4g}" for name, value in point.quality.items())
        print(f"{self.subject.recording.run.sequence}, {version.name}, {task}: {scores}", file=sys.stderr, flush=True)
        return point

    def quality(self, frames: Sequence[Frame]) -> dict[str, float]:
        """Hold frames against the recording."""
        score = Score(depth_scale=self.subject.recording.info.depth_scale)
        for given, seen in zip(self.subject.recording.frames, frames, strict=True):
            score.add_color(given.color, seen.color)
            score.add_depth(given.depth, seen.depth)
        return score.quality()

    def open3d_odometry(self, frames: Sequence[Frame]) -> dict[str, float]:
        """Go from frame to frame by Open3D."""
        return trajectory_scores(self.subject.poses, open3d_steps(frames, self.subject.camera))

    def opencv_odometry(self, frames: Sequence[Frame]) -> dict[str, float]:
        """Go from frame to frame by OpenCV."""
        return trajectory_scores(self.subject.poses, opencv_steps(frames, self.subject.camera))

    def matches(self, frames: Sequence[Frame]) -> dict[str, float]:
        """Match pictures some frames apart."""
        views = [
            View(color=frame.color, depth=depth, T_world_camera=pose)
            for frame, depth, pose in zip(frames, self.subject.depths, self.subject.poses, strict=True)
        ]
        starts = range(0, len(views) - GAP, STRIDE)
        found = [agreeing_matches(views[k], views[k + GAP], self.subject.camera) for k in starts]
        return {"matches": float(np.mean(found)) if found else math.nan}

    def surface(self, frames: Sequence[Frame]) -> dict[str, float]:
        """Fuse depth at the true poses."""
        found = fused((frame.depth for frame in frames), self.subject.poses, self.subject.camera)
        true = self.subject.surface
        return {"f_score": f_score(distances(found, true), distances(true, found), SURFACE_M)}


def tools() -> str:
    """Return the versions of what does the tasks and judges them."""
    sources = "".join(inspect.getsource(module) for module in (task_scores, task_tools))
    digest = hashlib.sha256(sources.encode()).hexdigest()[:16]
    return f"Open3D {open3d().__version__}, OpenCV {cv2.__version__}, {digest}"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of one sequence: versions in their order, and their scores by task."""

    sequence: str
    frames: int
    seconds: float
    scores: dict[str, dict[str, Point]]

    def value(self, version: str, measure: Measure) -> float | None:
        """Return one score, or None where the task was not done."""
        point = self.scores[version].get(measure.task)
        value = None if point is None else point.quality[measure.name]
        return None if value is None or math.isnan(value) else value


def outcome(subject: Subject, ratios: Sequence[int], store: Store) -> Outcome:
    """Do all tasks with all versions of a sequence."""
    recording = subject.recording
    check_recording(recording)
    tasks = Tasks(subject, store)
    scores = {version.name: tasks.scores(version) for version in versions(recording, ratios, store)}
    return Outcome(
        sequence=recording.run.sequence, frames=len(recording.frames), seconds=recording.seconds, scores=scores
    )


def subjects(folders: Iterable[Path], scenes: Iterable[str], frames: int, cache: Path) -> Iterable[Subject]:
    """Yield recorded sequences, then scenes that are made."""
    for folder in folders:
        run = Run(sequence=folder.resolve().name, options=OPTIONS)
        yield Subject(recording=Recording(folder, run, frames))
    for name in scenes:
        folder = made_scene(name, frames, cache)
        exact = partial(_exact_depth, scene_of(name, frames, "ideal"))
        yield Subject(recording=Recording(folder, Run(sequence=folder.name, options=OPTIONS), frames), exact=exact)


def _exact_depth(scene: SyntheticSequence, number: int) -> NDArray[np.float32]:
    return np.asarray(scene.picture(number).depth, dtype=np.float32)


def report(outcomes: Sequence[Outcome], heading: str, failures: Sequence[str] = ()) -> str:
    """Return the report as Markdown."""
    parts = ["# What decoded frames are good for", heading]
    parts += [f"Failed: {failure}." for failure in failures]
    if outcomes:
        columns = list(dict.fromkeys(name for each in outcomes for name in each.scores))
        rows = [row for each in outcomes for row in _rows(each, columns)]
        parts += [markdown_table(("sequence", "task", "measure", *columns), rows, 3), _judged(outcomes), NOTE]
        parts += ["## What was coded", markdown_table(CODED, [row for each in outcomes for row in _coded(each)], 3)]
    return "\n\n".join(parts) + "\n"


def _rows(each: Outcome, columns: Sequence[str]) -> list[list[str]]:
    rows = []
    for measure in MEASURES:
        values = [each.value(name, measure) if name in each.scores else None for name in columns]
        if any(value is not None for value in values):
            cells = [_cell(measure, value, each.value(RAW, measure)) for value in values]
            rows.append([each.sequence, measure.task, measure.words, *cells])
    return rows


def _cell(measure: Measure, value: float | None, raw: float | None) -> str:
    if value is None:
        return "-"
    return measure.shown(value) + (WORSE if raw is not None and measure.worse(value, raw) else "")


def _judged(outcomes: Sequence[Outcome]) -> str:
    """Say of each codec and size how many scores are worse than on raw frames."""
    counts = []
    for name in dict.fromkeys(name for each in outcomes for name in each.scores if name != RAW):
        worse = [
            measure.worse(value, raw)
            for each in outcomes
            if name in each.scores
            for measure in MEASURES
            if (value := each.value(name, measure)) is not None and (raw := each.value(RAW, measure)) is not None
        ]
        counts.append(f"{name}: {sum(worse)} of {len(worse)}")
    return (
        f"The goal is that no task be worse than on raw frames at 1:1000. Scores that are, with a {WORSE.strip()}: "
        f"{'; '.join(counts)}."
    )


CODED = ("sequence", "version", "setting", "bytes", "kbit/s", "raw size to bytes", "PSNR RGB", "within 1 %", "lost")


def _coded(each: Outcome) -> list[list[str]]:
    rows = []
    raw = each.scores[RAW][QUALITY].size
    for name, scores in each.scores.items():
        point = scores[QUALITY]
        if name != RAW:
            rows.append([
                each.sequence, name, point.setting, f"{point.size:,}", f"{8 * point.size / each.seconds / 1000:.1f}",
                f"{raw / point.size:.0f}", f"{point.quality[COLOR]:.2f}", f"{point.quality[DEPTH]:.4f}",
                f"{point.quality['depth_lost']:.4f}",
            ])  # fmt: skip
    return rows


def heading(frames: int) -> str:
    """Return what did the tasks, and where."""
    machine = f"{default_threads()} cores, {platform.machine()}, Python {platform.python_version()}"
    return (
        f"Written by `make bench-tasks` at commit {commit()}, on {machine}; the first {frames} frames of each. "
        f"Open3D {open3d().__version__}: `compute_rgbd_odometry`, `VoxelBlockGrid`; OpenCV {cv2.__version__}: "
        f"`cv2.Odometry`, color and depth, `cv2.ORB`; AV1 is that of the wheel of PyAV {library().__version__}."
    )


def ratios_of(text: str) -> tuple[int, ...]:
    """Return the ratios of a list with commas, coarse to fine."""
    return tuple(sorted({count(part) for part in text.split(",")}, reverse=True))


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Measure what decoded frames are good for.")
    parser.add_argument("folders", type=Path, nargs="*", help=f"sequences (default: {', '.join(RECORDED)} in {DATA})")
    parser.add_argument("--scenes", nargs="*", default=SCENES, help="scenes of 3dvc synth (default: %(default)s)")
    parser.add_argument("--frames", type=count, metavar="N", default=FRAMES, help="first N frames of each")
    parser.add_argument("--ratios", type=ratios_of, metavar="R,...", default=RATIOS, help="raw size over that of files")
    parser.add_argument("--out", type=Path, default=OUTPUT, help="file to write")
    parser.add_argument("--cache", type=Path, default=STORE, help="folder of what was coded and measured")
    parser.add_argument("--reuse", action="store_true", help="take scores of other versions of programs, too")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line, do all tasks, write the report."""
    options = parsed(arguments)
    folders = options.folders or [place for name in RECORDED if (place := DATA / name).is_dir()]
    try:
        library(), open3d()
    except (MissingCodec, MissingTool) as error:
        sys.exit(str(error))
    found: list[Outcome] = []
    failures: list[str] = []
    for subject in subjects(folders, options.scenes, options.frames, options.cache):
        try:
            found.append(outcome(subject, options.ratios, Store(options.cache, options.reuse)))
        except ThreedvcError as error:
            print(error, file=sys.stderr)
            failures.append(f"{subject.recording.folder.name}: {error}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(report(found, heading(options.frames), failures), encoding="utf-8")
    print(options.out)
    if failures:
        sys.exit(f"{len(failures)} of the sequences failed")


if __name__ == "__main__":
    main()
