# SPDX-License-Identifier: MIT
"""The plain layout: what `3dvc decode` writes and the simplest layout to produce.

::

    color/NNNNNN.png       8-bit, 1 or 3 channels (or .jpg)
    depth/NNNNNN.png       16-bit, 0 = no measurement
    intrinsics.json        width, height, fx, fy, cx, cy, optional distortion [k1 k2 p1 p2 k3],
                           depth_scale (units per meter, 1000 if absent), fps (30 if absent);
                           or, for two cameras, `color` and `depth` with those entries, and T_color_depth (4x4)
    poses.txt              optional: NNNNNN tx ty tz qx qy qz qw, T_world_camera, meters;
                           a number alone, or no line, stands for a frame whose pose is not known
    masks/NNNNNN.png       optional: 8-bit labels in the depth camera, 0 = background; of the first frame
                           and as many others as there are
    object_poses.json      optional: label -> one 4x4 T_camera_object per frame in order, null where not known
    timestamps.txt         optional: NNNNNN timestamp_ns [color_timestamp_ns]; without it the clock is regular

NNNNNN is the frame's number. Numbers may begin anywhere and have gaps; a gap takes time on the regular clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import TypeVar

import numpy as np

from threedvc.errors import SequenceError
from threedvc.formats.sources.assembly import assemble
from threedvc.formats.sources.association import Pairing, pair_pictures
from threedvc.formats.sources.files.intrinsics import REMEDY, find_cameras
from threedvc.formats.sources.files.masks import MAX_LABEL, Masks, find_masks
from threedvc.formats.sources.files.poses import pose_from_row, rigid_poses
from threedvc.formats.sources.files.text import Row, read_json, read_rows
from threedvc.formats.sources.files.timestamps import UNITS, Clock, clock_of, parse_nanoseconds, regular_stamp, unit_of
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import DEFAULT_FPS, FrameFiles, Layout, Recording, SourceOptions, chosen_folder
from threedvc.geometry.pose import Pose
from threedvc.units import MILLIMETERS

__all__ = ["LAYOUT"]

Item = TypeVar("Item")

INTRINSICS = "intrinsics.json"
POSES = "poses.txt"
OBJECT_POSES = "object_poses.json"
TIMESTAMPS = "timestamps.txt"


def recognizes(folder: Path) -> bool:
    """Tell whether the folder has our intrinsics, poses or times beside ``color/`` or ``depth/``."""
    own_files = any((folder / name).exists() for name in (INTRINSICS, POSES, OBJECT_POSES, TIMESTAMPS))
    return own_files and ((folder / "color").is_dir() or (folder / "depth").is_dir())


def read(folder: Path, options: SourceOptions) -> Recording:
    """List a recording in the plain layout; raises SequenceError or ConfigError."""
    color = chosen_folder(folder, options.color, folder / "color", "--color")
    pairing = pair_pictures(color, chosen_folder(folder, options.depth, folder / "depth", "--depth"))
    own_file = folder / INTRINSICS
    cameras = find_cameras(folder, options, pairing.pairs[0], own_file if own_file.exists() else None)
    if cameras is None:
        raise SequenceError(f"{own_file}: no camera intrinsics; add the file, or {REMEDY}")
    for path, _ in pairing.pairs:
        _require_number(path)
    clock = _clock(folder, pairing, options.fps or cameras.fps)
    masks = find_masks(folder, pairing)
    has_times = (folder / TIMESTAMPS).exists() and not pairing.stamps
    return assemble(
        folder,
        _frames(folder, pairing, clock, masks),
        cameras,
        options,
        depth_scale=MILLIMETERS,
        fps=clock.fps,
        poses_from=folder / POSES,
        notices=(*(() if has_times else pairing.notices), *clock.notices, *masks.notices),
    )


def _frames(folder: Path, pairing: Pairing, clock: Clock, masks: Masks) -> list[FrameFiles]:
    numbers = pairing.numbers
    poses = _camera_poses(folder / POSES, numbers)
    objects = _object_poses(folder / OBJECT_POSES, len(numbers))
    return [
        FrameFiles(
            color=color,
            depth=depth,
            mask=masks.of_frames.get(number),
            object_masks=masks.of_objects.get(number, {}),
            timestamp_ns=stamp,
            color_timestamp_ns=color_stamp,
            T_world_camera=poses.get(number),
            T_camera_object=objects_here,
        )
        for number, (color, depth), objects_here, (stamp, color_stamp) in zip(
            numbers, pairing.pairs, objects, clock.stamps, strict=True
        )
    ]


def _require_number(path: Path) -> None:
    if not path.stem.isdecimal():
        raise SequenceError(f"{path}: is not named by its frame number (NNNNNN); rename it or choose --layout bare")


def _camera_poses(path: Path, numbers: Sequence[int]) -> dict[int, Pose | None]:
    if not path.exists():
        return {}
    rows = _rows_by_number(path)
    if not rows.keys() & set(numbers):
        raise SequenceError(
            f"{path}: no pose for frame {numbers[0]} or any other ({len(rows)} for {len(numbers)} frames); number the "
            "lines as the pictures are, or remove the file"
        )
    unknown = sorted(rows.keys() - set(numbers))
    if unknown:
        raise SequenceError(
            f"{rows[unknown[0]].place}: pose of frame {unknown[0]}, which has no pictures "
            f"({len(rows)} poses for {len(numbers)} frames); remove the line or add the pictures"
        )
    return {number: pose_from_row(row) if len(row.fields) > 1 else None for number, row in rows.items()}


def _clock(folder: Path, pairing: Pairing, told: float | None) -> Clock:
    """Return the times of the file, else those in the names, else those of a regular clock."""
    path, numbers = folder / TIMESTAMPS, pairing.numbers
    if not path.exists() and pairing.stamps:
        return clock_of(pairing.stamps, len(numbers), told, str(folder))
    fps = told or DEFAULT_FPS
    regular = Clock([(regular_stamp(number - numbers[0], fps), None) for number in numbers], fps)
    if not path.exists():
        return regular
    stamps = _file_stamps(path, numbers)
    unit = unit_of([Decimal(stamp) for stamp, _ in stamps], "nanoseconds")
    if unit is None:
        counted = Notice(f"{path}: its stamps count frames; they are taken to be {fps:g} per second")
        return replace(regular, notices=(counted,))
    ticks = UNITS[unit]
    timed = [(stamp * ticks, None if color in (None, stamp) else color * ticks) for stamp, color in stamps]
    clock = clock_of(timed, len(timed), told, str(path))
    taken = (Notice(f"{path}: its stamps are taken for {unit}"),) if ticks > 1 else ()
    return replace(clock, notices=(*taken, *clock.notices))


def _file_stamps(path: Path, numbers: Sequence[int]) -> list[tuple[int, int | None]]:
    rows = _rows_by_number(path)
    _require_all(path, numbers, rows, "timestamp")
    stamps = [_row_stamps(rows[number]) for number in numbers]
    for number, (stamp, _), (earlier, _) in zip(numbers[1:], stamps[1:], stamps, strict=False):
        if stamp < earlier:
            raise SequenceError(f"{rows[number].place}: time {stamp} ns runs backwards; correct the line")
    return stamps


def _row_stamps(row: Row) -> tuple[int, int | None]:
    if len(row.fields) not in (2, 3):
        raise SequenceError(f"{row.place}: expected frame, timestamp_ns and at most color_timestamp_ns; correct it")
    try:
        stamps = [parse_nanoseconds(field) for field in row.fields[1:]]
    except ValueError as error:
        raise SequenceError(f"{row.place}: {error}; write whole nanoseconds") from None
    return stamps[0], stamps[1] if len(stamps) > 1 else None


def _rows_by_number(path: Path) -> dict[int, Row]:
    rows: dict[int, Row] = {}
    for row in read_rows(path):
        other = rows.setdefault(row.integer(0), row)
        if other is not row:
            raise SequenceError(f"{row.place}: frame {row.fields[0]} was given on line {other.line}; keep one line")
    return rows


def _require_all(path: Path, numbers: Sequence[int], found: Mapping[int, Item], what: str) -> None:
    missing = [number for number in numbers if number not in found]
    if missing:
        raise SequenceError(
            f"{path}: no {what} for frame {missing[0]} ({len(found)} for {len(numbers)} frames); "
            f"add it or remove {path.name}"
        )


def _object_poses(path: Path, count: int) -> list[dict[int, Pose]]:
    frames: list[dict[int, Pose]] = [{} for _ in range(count)]
    if not path.exists():
        return frames
    for label, entries in read_json(path).items():
        for frame, pose in _poses_of_object(path, label, entries, count):
            frames[frame][int(label)] = pose
    return frames


def _poses_of_object(path: Path, label: str, entries: object, count: int) -> list[tuple[int, Pose]]:
    if not label.isdecimal() or int(label) > MAX_LABEL:
        raise SequenceError(f"{path}: {label!r} is not a label in 0..{MAX_LABEL}; use the labels of the masks")
    if not isinstance(entries, list) or len(entries) != count:
        length = len(entries) if isinstance(entries, list) else "no list of"
        raise SequenceError(f"{path}: object {label} has {length} poses for {count} frames; write null where not known")
    known = [frame for frame, entry in enumerate(entries) if entry is not None]
    try:
        matrices = np.array([entries[frame] for frame in known], dtype=np.float64).reshape(len(known), 4, 4)
    except (TypeError, ValueError):
        raise SequenceError(f"{path}: object {label} has an entry that is not a 4x4 matrix; correct the file") from None
    poses = rigid_poses(matrices, [f"{path}: object {label}, frame {frame}" for frame in known])
    return list(zip(known, poses, strict=True))


LAYOUT = Layout(name="plain", recognizes=recognizes, read=read, takes_folders=True, trial=40)
