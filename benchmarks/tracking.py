# SPDX-License-Identifier: MIT
"""Track recorded sequences without their poses, as recorded and disturbed; write the table of errors and speed.

Only the first pass is run, segmentation, registration and fusion: what a file encoder refines afterwards is measured
by ``3dvc stats --reference``::

    python benchmarks/tracking.py [FOLDER...] [--frames N] [--out FILE.md]

Without folders all sequences in ``$THREEDVC_DATA``, or in ``../shared/data``, are taken.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from rd import recorded
from rd_points import Recording
from reporting import commit, markdown_table
from threedvc.config import Motion
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.pose import Pose, inverse
from threedvc.metrics.trajectory import object_pose_error, trajectory_error
from threedvc.parallel import default_threads
from threedvc.stream.pose_status import PoseStatus

__all__ = ["DISTURBANCES", "StreamTimeline", "main", "tracked"]

OUTPUT = Path(__file__).with_name("TRACKING.md")
DISTURBED = ("kitchen300",)
WARM_UP = 3
"""Frames tracked before anything is measured, so that all code is compiled."""
FIRST, LAST, LAST_REMOVED = 100, 110, 129
"""Frames that are disturbed, and the last of those removed: some seconds after the start."""
COUNTED = (PoseStatus.TRACKED, PoseStatus.WEAK, PoseStatus.RELOCALIZED, PoseStatus.LOST)
HEADER = ("sequence", "disturbance", "frames", *map(str, COUNTED), "ATE mm", "RPE mm", "RPE deg", "object deg",
          "object mm", "fps, tracking", "fps, all")  # fmt: skip
NOTE = """\
ATE is the root of the mean squared distance of camera positions after alignment, RPE that of the error from frame to
frame, over all frames that were not lost; of objects the largest median error of turn and place after alignment of
their frames. Frames per second are those of registration alone, and of all that the first pass does, without reading
pictures. Luma counts a tenth for the background, as in a live stream and a file's first pass (decision 0040).
"black": depth is missing in frames 100 to 110; "covered": color, too; "removed": frames 100 to 129 are."""


def black(frames: Sequence[Frame]) -> list[Frame]:
    """Return frames without depth in some of them."""
    gone = range(FIRST, LAST + 1)
    return [replace(frame, depth=np.zeros_like(frame.depth)) if frame.index in gone else frame for frame in frames]


def covered(frames: Sequence[Frame]) -> list[Frame]:
    """Return frames of which some show nothing at all."""
    gone = range(FIRST, LAST + 1)
    dark = black(frames)
    return [replace(frame, color=np.zeros_like(frame.color)) if frame.index in gone else frame for frame in dark]


def removed(frames: Sequence[Frame]) -> list[Frame]:
    """Return frames without some of them, numbered anew."""
    left = [frame for frame in frames if not FIRST <= frame.index <= LAST_REMOVED]
    return [replace(frame, index=index) for index, frame in enumerate(left)]


DISTURBANCES: dict[str, Callable[[Sequence[Frame]], list[Frame]]] = {
    "": list,
    "black": black,
    "covered": covered,
    "removed": removed,
}


@dataclass
class StreamTimeline:
    """How tracking went: status of every frame, poses found and true, seconds."""

    status: list[PoseStatus] = field(default_factory=list)
    camera: list[tuple[Pose, Pose]] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    objects: dict[int, list[tuple[Pose, Pose]]] = field(default_factory=dict)
    tracking_s: float = 0.0
    seconds: float = 0.0

    def row(self, sequence: str, disturbance: str) -> list[str]:
        """Return the cells of the table."""
        count, statuses = len(self.status), Counter(self.status)
        cells = [sequence, disturbance, str(count)]
        cells += [str(statuses[status]) for status in COUNTED]
        if self.camera:
            true, found = zip(*self.camera, strict=True)
            error = trajectory_error(true, found, self.numbers)
            cells += [f"{error.ate_rmse_mm:.1f}", f"{error.rpe_translation_mm:.1f}", f"{error.rpe_rotation_deg:.3f}"]
        else:
            cells += ["-"] * 3
        errors = [object_pose_error(*zip(*pairs, strict=True)) for pairs in self.objects.values()]
        turn = max((error.rotation_median_deg for error in errors), default=None)
        way = max((error.translation_median_mm for error in errors), default=None)
        cells += ["-" if value is None else f"{value:.2f}" for value in (turn, way)]
        return [*cells, f"{count / self.tracking_s:.1f}", f"{count / self.seconds:.1f}"]


def tracked(frames: Sequence[Frame], info: SequenceInfo, recording: Recording) -> StreamTimeline:
    """Track all frames as the first pass of the encoder does."""
    scene, timeline = Scene(info, replace(recording.config, motion=Motion.TRACK)), StreamTimeline()
    for frame in frames:
        began = time.perf_counter()
        timeline.status.append(scene.add(frame))
        timeline.seconds += time.perf_counter() - began
        for number, item in scene.objects.items():
            at = item.found[-1]
            if at is None or not at.usable:
                continue
            if not number and frame.T_world_camera is not None:
                timeline.camera.append((frame.T_world_camera, inverse(at.T_camera_object)))
                timeline.numbers.append(frame.index)
            elif number in frame.T_camera_object:
                timeline.objects.setdefault(number, []).append((frame.T_camera_object[number], at.T_camera_object))
    trackers = [item.tracker for item in scene.objects.values() if item.tracker is not None]
    timeline.tracking_s = max(sum(tracker.stopwatch.seconds for tracker in trackers), 1e-9)
    return timeline


def rows(folders: Sequence[Path], limit: int | None) -> Iterator[list[str]]:
    """Yield the rows of the table as they are measured."""
    for folder in folders:
        recording = Recording.of(folder, limit)
        frames = list(recording.encoder_frames())
        tracked(frames[:WARM_UP], recording.info, recording)
        for name, disturb in DISTURBANCES.items():
            if not name or folder.name in DISTURBED:
                timeline = tracked(disturb(frames), recording.info, recording)
                yield timeline.row(folder.name, name)


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line, measure, print and write the table."""
    parser = argparse.ArgumentParser(description="Measure how well and how fast recorded sequences are tracked.")
    parser.add_argument("folders", type=Path, nargs="*", help="sequences (default: all recorded ones)")
    parser.add_argument("--frames", type=int, metavar="N", help="take the first N frames of each")
    parser.add_argument("--out", type=Path, default=OUTPUT, help="file to write (default: %(default)s)")
    options = parser.parse_args(arguments)
    folders = options.folders or recorded()
    if not folders:
        print("no recorded sequences; set THREEDVC_DATA to their folder")
        return
    table = []
    for row in rows(folders, options.frames):
        print(*row, sep="\t", flush=True)
        table.append(row)
    machine = f"{default_threads()} cores, {platform.machine()}, Python {platform.python_version()}"
    heading = f"# Tracking\n\nWritten by `make bench` at commit {commit()}, on {machine}. {NOTE}\n\n"
    options.out.write_text(heading + markdown_table(HEADER, table, text_columns=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
