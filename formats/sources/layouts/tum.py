# SPDX-License-Identifier: MIT
"""TUM RGB-D benchmark: ``rgb.txt`` and ``depth.txt`` (stamp and path), or a ready associations file.

Depth has 5000 units per meter and is registered to color. Color and depth pictures are paired by time, uniquely and
within 20 ms; the rest is left out, as everybody does with this benchmark. ``groundtruth.txt`` (camera-to-world,
about 100 Hz) is interpolated at the time of the depth picture. The cameras of freiburg1 to 3 are known by the
sequence's name, which is that of the folder or stands in the header of ``rgb.txt``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

from threedvc.errors import SequenceError
from threedvc.formats.sources.assembly import assemble
from threedvc.formats.sources.association import associate, left_out
from threedvc.formats.sources.files.intrinsics import find_cameras, published_camera
from threedvc.formats.sources.files.poses import interpolate_pose, pose_from_row
from threedvc.formats.sources.files.text import Row, read_lines, read_rows, read_text
from threedvc.formats.sources.files.timestamps import parse_stamp, rate_of, to_nanoseconds, unit_of
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import (
    DEFAULT_FPS,
    FrameFiles,
    Layout,
    Recording,
    SourceOptions,
)
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose

__all__ = ["DEPTH_SCALE", "LAYOUT"]

DEPTH_SCALE = 5000.0
"""Units per meter, by the benchmark's definition."""
ASSOCIATIONS = "assoc*.txt"
GROUND_TRUTH = "groundtruth.txt"
HEADING = re.compile(r"(?!nan|inf)[A-Za-z_]", re.IGNORECASE)
"""A first line that begins so names the columns; one that is no number stands for a time that is not known."""
DECIMAL_COMMA = re.compile(r"\d+,\d+\s+\S")
ASSOCIATION = re.compile(
    r"(?P<at>[^\s,]+)[\s,]+(?P<first>\S.*?\.\w+[\"']?)[\s,]+(?P<then>[^\s,]+)[\s,]+(?P<second>\S.*\.\w+[\"']?)[\s,]*"
)
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
"""As calibrated by the benchmark's authors, by the number of the sensor in the folder's name."""


@dataclass(frozen=True)
class StampedPair:
    """A color and a depth picture with their times in nanoseconds."""

    color_stamp: int
    color: Path
    depth_stamp: int
    depth: Path


def recognizes(folder: Path) -> bool:
    """Tell whether the folder has ``rgb.txt`` and ``depth.txt``, or an associations file."""
    lists = (folder / "rgb.txt").exists() and (folder / "depth.txt").exists()
    return lists or any(folder.glob(ASSOCIATIONS))


def read(folder: Path, options: SourceOptions) -> Recording:
    """List a TUM RGB-D sequence; raises SequenceError or ConfigError."""
    told = options.fps
    listed, notices = _pairs(folder, told or DEFAULT_FPS)
    first = (listed[0].color, listed[0].depth)
    cameras = find_cameras(folder, options, first) or published_camera(_known_camera(folder), first)
    stamps, poses = _ground_truth(folder / GROUND_TRUTH, told or DEFAULT_FPS)
    frames = tuple(
        FrameFiles(
            color=pair.color,
            depth=pair.depth,
            timestamp_ns=pair.depth_stamp,
            color_timestamp_ns=None if pair.color_stamp == pair.depth_stamp else pair.color_stamp,
            T_world_camera=interpolate_pose(stamps, poses, pair.depth_stamp),
        )
        for pair in listed
    )
    rate = rate_of([frame.timestamp_ns for frame in frames], told or cameras.fps, str(folder))
    return assemble(
        folder,
        frames,
        cameras,
        options,
        depth_scale=DEPTH_SCALE,
        fps=rate.fps,
        poses_from=folder / GROUND_TRUTH,
        notices=(*notices, *rate.notices),
    )


def _pairs(folder: Path, fps: float) -> tuple[list[StampedPair], list[Notice]]:
    """Return the pairs in order of time; frames that are counted get the times of a regular clock."""
    if any(folder.glob(ASSOCIATIONS)):
        pairs, notices = _associations(min(folder.glob(ASSOCIATIONS)), fps)
    else:
        colors, depths = (_stamped_paths(folder / name, fps) for name in ("rgb.txt", "depth.txt"))
        matches = associate([stamp for stamp, _ in colors.paths], [stamp for stamp, _ in depths.paths])
        pairs = [StampedPair(*colors.paths[i], *depths.paths[j]) for i, j in matches]
        notices = [*depths.notices, *left_out(len(colors.paths), len(depths.paths), len(pairs), str(folder))]
    if not pairs:
        raise SequenceError(f"{folder}: no color picture within 20 ms of a depth picture; check rgb.txt and depth.txt")
    return sorted(pairs, key=lambda pair: pair.depth_stamp), notices


def _associations(path: Path, fps: float) -> tuple[list[StampedPair], list[Notice]]:
    """Read lines of a stamp and a path for color and for depth, in either order."""
    columns: list[list[tuple[Decimal, Path]]] = [[], []]
    for index, (number, line) in enumerate(read_lines(path)):
        if index == 0 and HEADING.match(line):
            continue
        place = f"{path}:{number}"
        names = _stamped_names(line, place)
        stamped = [(_stamp(stamp, place), path.parent / _path(name)) for stamp, name in names]
        depth, color = stamped if "depth" in names[0][1].lower() else reversed(stamped)
        columns[0].append(color)
        columns[1].append(depth)
    unit, notices = _unit([stamp for stamp, _ in columns[1]], path, fps)
    return [
        StampedPair(to_nanoseconds(a, unit, fps), color, to_nanoseconds(b, unit, fps), depth)
        for (a, color), (b, depth) in zip(*columns, strict=True)
    ], notices


def _stamped_names(line: str, place: str) -> list[tuple[str, str]]:
    """Split a line into two stamps and two names, which may have spaces in them; raises SequenceError."""
    found = ASSOCIATION.fullmatch(line)
    if not found or ("depth" in found["first"].lower()) == ("depth" in found["second"].lower()):
        raise SequenceError(f"{place}: expected stamp, color path, stamp, depth path; correct the line")
    return [(found["at"], found["first"]), (found["then"], found["second"])]


@dataclass(frozen=True)
class _StampedPaths:
    """Pictures of one list with their times in nanoseconds, in order, and what was decided about these."""

    paths: list[tuple[int, Path]]
    notices: list[Notice]


def _stamped_paths(path: Path, fps: float) -> _StampedPaths:
    stamped: list[tuple[Decimal, Path]] = []
    for number, line in read_lines(path):
        place = f"{path}:{number}"
        if DECIMAL_COMMA.match(line):
            raise SequenceError(f"{place}: the time has a comma where its decimal point should be; write points")
        stamp, _, name = line.replace("\t", " ").partition("," if "," in line else " ")
        if not name.strip():
            raise SequenceError(f"{place}: expected a stamp and a path; correct the line")
        if stamped or not HEADING.match(stamp):
            stamped.append((_stamp(stamp.strip(), place), path.parent / _path(name)))
    stamped.sort()
    unit, notices = _unit([stamp for stamp, _ in stamped], path, fps)
    return _StampedPaths([(to_nanoseconds(stamp, unit, fps), picture) for stamp, picture in stamped], notices)


def _path(text: str) -> str:
    """Return the path of a list: quoted, with backslashes as on Windows, or with spaces in it."""
    return text.strip().strip("\"'").replace("\\", "/")


def _unit(stamps: Sequence[Decimal], path: Path, fps: float) -> tuple[str | None, list[Notice]]:
    """Return the unit of stamps; None where they count frames. The benchmark's own are seconds: others are told."""
    unit = unit_of(sorted(stamps), "seconds")
    if unit is None:
        return None, [Notice(f"{path}: its stamps count frames; they are taken to be {fps:g} per second")]
    return unit, [] if unit == "seconds" else [Notice(f"{path}: its stamps are taken for {unit}")]


def _stamp(text: str, place: str) -> Decimal:
    """Return a decimal number; raises SequenceError naming the place."""
    try:
        return parse_stamp(text)
    except ValueError as error:
        raise SequenceError(f"{place}: {error}; correct the line") from None


def _ground_truth(path: Path, fps: float) -> tuple[list[int], list[Pose]]:
    if not path.exists():
        return [], []
    poses = {_stamp(row.fields[0], row.place): pose_from_row(row) for row in _ground_truth_rows(path)}
    ordered = sorted(poses)
    unit, _ = _unit(ordered, path, fps)
    return [to_nanoseconds(stamp, unit, fps) for stamp in ordered], [poses[stamp] for stamp in ordered]


def _ground_truth_rows(path: Path) -> list[Row]:
    """Return the rows, with the first one where a writer left no newline after the header comment."""
    rows = read_rows(path)
    if rows and HEADING.match(rows[0].fields[0]):
        rows = rows[1:]
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        glued = GLUED_ROW.fullmatch(line.strip())
        if glued and len(glued[1].split()) == 8:
            rows.insert(0, Row(path, number, tuple(glued[1].split())))
    return rows


def _known_camera(folder: Path) -> Camera | None:
    header = read_text(folder / "rgb.txt")[:200] if (folder / "rgb.txt").exists() else ""
    sequence = re.search(r"(?:freiburg|fr)([123])(?!\d)", f"{folder.resolve().name} {header}")
    return CAMERAS[sequence[1]] if sequence else None


LAYOUT = Layout(name="tum", recognizes=recognizes, read=read, trial=20)
