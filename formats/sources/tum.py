# SPDX-License-Identifier: MIT
"""TUM RGB-D benchmark: ``rgb.txt`` and ``depth.txt`` (stamp and path), or a ready associations file.

Depth has 5000 units per metre and is registered to colour. Colour and depth pictures are paired by time, uniquely and
within 20 ms; the rest is left out, as everybody does with this benchmark. ``groundtruth.txt`` (camera-to-world,
about 100 Hz) is interpolated at the time of the depth picture. The cameras of freiburg1 to 3 are known by the
sequence's name, which is that of the folder or stands in the header of ``rgb.txt``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from threedvc.camera import Camera
from threedvc.errors import SequenceError
from threedvc.formats.sources.assembly import assemble
from threedvc.formats.sources.association import associate
from threedvc.formats.sources.intrinsics import find_cameras, published_camera
from threedvc.formats.sources.poses import interpolate_pose, pose_from_row
from threedvc.formats.sources.recording import (
    DEFAULT_FPS,
    FrameFiles,
    Layout,
    Recording,
    SourceOptions,
)
from threedvc.formats.sources.text import Row, read_rows, read_text
from threedvc.formats.sources.timestamps import fps_of_stamps, parse_seconds
from threedvc.pose import Pose

__all__ = ["DEPTH_SCALE", "LAYOUT"]

DEPTH_SCALE = 5000.0
ASSOCIATIONS = "assoc*.txt"
GROUND_TRUTH = "groundtruth.txt"
GLUED_ROW = re.compile(r"#.*?qw\s*([-+\d].*)")

CAMERAS = {
    "1": Camera(
        width=640,
        height=480,
        fx=517.306,
        fy=516.469,
        cx=318.643,
        cy=255.314,
        distortion=(0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    ),
    "2": Camera(
        width=640,
        height=480,
        fx=520.9,
        fy=521.0,
        cx=325.1,
        cy=249.7,
        distortion=(0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    ),
    "3": Camera(width=640, height=480, fx=535.4, fy=539.2, cx=320.1, cy=247.6),
}


@dataclass(frozen=True)
class StampedPair:
    """A colour and a depth picture with their times in nanoseconds."""

    color_stamp: int
    color: Path
    depth_stamp: int
    depth: Path


def recognises(folder: Path) -> bool:
    """Tell whether the folder has ``rgb.txt`` and ``depth.txt``, or an associations file."""
    lists = (folder / "rgb.txt").is_file() and (folder / "depth.txt").is_file()
    return lists or any(folder.glob(ASSOCIATIONS))


def read(folder: Path, options: SourceOptions) -> Recording:
    """List a TUM RGB-D sequence; raises SequenceError or ConfigError."""
    pairs = _pairs(folder)
    first = (pairs[0].color, pairs[0].depth)
    cameras = find_cameras(folder, options, first) or published_camera(_known_camera(folder), first)
    stamps, poses = _ground_truth(folder / GROUND_TRUTH)
    frames = tuple(
        FrameFiles(
            color=pair.color,
            depth=pair.depth,
            timestamp_ns=pair.depth_stamp,
            color_timestamp_ns=pair.color_stamp,
            T_world_camera=interpolate_pose(stamps, poses, pair.depth_stamp),
        )
        for pair in pairs
    )
    fps = options.fps or cameras.fps or fps_of_stamps([frame.timestamp_ns for frame in frames], DEFAULT_FPS)
    return assemble(
        folder, frames, cameras, options, depth_scale=DEPTH_SCALE, fps=fps, poses_from=folder / GROUND_TRUTH
    )


def _pairs(folder: Path) -> list[StampedPair]:
    if any(folder.glob(ASSOCIATIONS)):
        pairs = [_association(folder, row) for row in read_rows(min(folder.glob(ASSOCIATIONS)))]
    else:
        colors, depths = _stamped_paths(folder / "rgb.txt"), _stamped_paths(folder / "depth.txt")
        matches = associate([stamp for stamp, _ in colors], [stamp for stamp, _ in depths])
        pairs = [StampedPair(*colors[i], *depths[j]) for i, j in matches]
    if not pairs:
        raise SequenceError(f"{folder}: no colour picture within 20 ms of a depth picture; check rgb.txt and depth.txt")
    return sorted(pairs, key=lambda pair: pair.depth_stamp)


def _association(folder: Path, row: Row) -> StampedPair:
    """Read one line: a stamp and a path for colour and for depth, in either order."""
    names_depth = ["depth" in field.lower() for field in row.fields[1::2]]
    if len(row.fields) != 4 or sorted(names_depth) != [False, True]:
        raise SequenceError(f"{row.place}: expected stamp, colour path, stamp, depth path; correct the line")
    stamped = [(_stamp(row.fields[column], row.place), folder / row.fields[column + 1]) for column in (0, 2)]
    depth, color = stamped if names_depth[0] else reversed(stamped)
    return StampedPair(*color, *depth)


def _stamped_paths(path: Path) -> list[tuple[int, Path]]:
    rows = read_rows(path)
    for row in rows:
        if len(row.fields) != 2:
            raise SequenceError(f"{row.place}: expected a stamp and a path; correct the line")
    return sorted((_stamp(row.fields[0], row.place), path.parent / row.fields[1]) for row in rows)


def _stamp(text: str, place: str) -> int:
    """Return decimal seconds in nanoseconds; raises SequenceError naming the place."""
    try:
        return parse_seconds(text)
    except ValueError as error:
        raise SequenceError(f"{place}: {error}; correct the line") from None


def _ground_truth(path: Path) -> tuple[list[int], list[Pose]]:
    if not path.is_file():
        return [], []
    poses = {_stamp(row.fields[0], row.place): pose_from_row(row) for row in _ground_truth_rows(path)}
    ordered: Sequence[int] = sorted(poses)
    return list(ordered), [poses[stamp] for stamp in ordered]


def _ground_truth_rows(path: Path) -> list[Row]:
    """Return the rows, with the first one where a writer left no newline after the header comment."""
    rows = read_rows(path)
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        glued = GLUED_ROW.fullmatch(line.strip())
        if glued and len(glued[1].split()) == 8:
            rows.insert(0, Row(path, number, tuple(glued[1].split())))
    return rows


def _known_camera(folder: Path) -> Camera | None:
    header = read_text(folder / "rgb.txt")[:200] if (folder / "rgb.txt").is_file() else ""
    sequence = re.search(r"(?:freiburg|fr)([123])(?!\d)", f"{folder.resolve().name} {header}")
    return CAMERAS[sequence[1]] if sequence else None


LAYOUT = Layout(name="tum", recognises=recognises, read=read)
