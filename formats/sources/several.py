# SPDX-License-Identifier: MIT
"""Open what several sensors recorded, each in a folder of its own, as one sequence."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from threedvc.errors import ConfigError, SequenceError
from threedvc.formats.layout_names import AUTO
from threedvc.formats.sources.files.poses import pose_from_numbers, read_matrix, rigid_poses
from threedvc.formats.sources.files.text import read_json_value
from threedvc.formats.sources.opening import FrameRange, open_sequence
from threedvc.formats.sources.sequence import FolderSequence
from threedvc.frames.multi_sensor import MergedSequence
from threedvc.geometry.pose import Pose, inverse
from threedvc.units import NANOSECONDS

__all__ = ["open_sensors", "read_extrinsic"]

Value = TypeVar("Value")

MOUNT = "T_rig_depth"
FORMS = "give a file with a 4x4 matrix, or tx,ty,tz,qx,qy,qz,qw in meters"


def open_sensors(
    paths: Sequence[str | os.PathLike[str]],
    *,
    extrinsics: Sequence[str] = (),
    delays_s: Sequence[float] = (),
    layout: Sequence[str] = (),
    color: Sequence[str] = (),
    depth: Sequence[str] = (),
    intrinsics: Sequence[str] = (),
    depth_scale: Sequence[float] = (),
    fps: Sequence[float] = (),
    poses: Sequence[str] = (),
    max_depth_m: float | None = None,
    frames: FrameRange | None = None,
) -> MergedSequence:
    """Open the recordings of several sensors that are mounted together.

    Parameters
    ----------
    paths
        A folder for each sensor, at least two. Poses belong to the frame of the first one's depth camera, the rig.
    extrinsics
        For each sensor after the first where its depth camera is in the frame of the first one's,
        ``p_first = T_first_sensor @ p_sensor``: a file with a 4x4 matrix (text, or JSON as a list or under
        ``T_rig_depth``), or ``tx,ty,tz,qx,qy,qz,qw`` (meters). Empty: every recording's intrinsics.json has a
        ``T_rig_depth``, the pose of its depth camera on the mount.
    delays_s
        For each sensor after the first, seconds to add to its times; empty: all clocks agree.
    layout, color, depth, intrinsics, depth_scale, fps, poses
        As of `open_sequence`, one for each sensor or one for all; empty: as the recordings say.
    max_depth_m, frames
        As of `open_sequence`; `frames` are cut from each recording.

    Raises
    ------
    SequenceError
        If a recording or an extrinsic cannot be read, or tells less than is needed.
    ConfigError
        If an option has an impossible value or does not fit the number of sensors.
    """
    count = len(paths)
    layouts, colors, depths, cameras, scales, rates, readings = (
        _for_each("--layout", layout, count),
        _for_each("--color", color, count),
        _for_each("--depth", depth, count),
        _for_each("--intrinsics", intrinsics, count),
        _for_each("--depth-scale", depth_scale, count),
        _for_each("--fps", fps, count),
        _for_each("--poses", poses, count),
    )
    sequences = [
        open_sequence(
            path, layout=layouts[k] or AUTO, color=colors[k], depth=depths[k], intrinsics=cameras[k],
            depth_scale=scales[k], fps=rates[k], poses=readings[k], max_depth_m=max_depth_m, frames=frames,
        )
        for k, path in enumerate(paths)
    ]  # fmt: skip
    if delays_s and len(delays_s) != count - 1:
        raise ConfigError(
            f"--delay is given {len(delays_s)} times for {count} sensors; give it once for each after the first"
        )
    delays_ns = [round(delay * NANOSECONDS) for delay in delays_s] or None
    return MergedSequence(sequences, _mounts(sequences, extrinsics, paths), delays_ns)


def read_extrinsic(text: str) -> Pose:
    """Read T_first_sensor from a file or from seven numbers; see `open_sensors`.

    Raises
    ------
    SequenceError, ConfigError
        If it cannot be read, or is not rigid.
    """
    path = Path(text)
    if not path.is_file():
        numbers = _numbers(text)
        if len(numbers) != 7:
            raise ConfigError(f"--extrinsics {text}: neither a file nor seven numbers; {FORMS}")
        return pose_from_numbers(numbers, f"--extrinsics {text}")
    if path.suffix.lower() != ".json":
        return read_matrix(path)
    content = read_json_value(path)
    if isinstance(content, dict):
        content = content.get(MOUNT)
    try:
        matrix = np.array(content, dtype=np.float64).reshape(4, 4)
    except (TypeError, ValueError):
        raise SequenceError(f"{path}: holds no 4x4 matrix, alone or under {MOUNT}; {FORMS}") from None
    pose: Pose = rigid_poses(matrix[None], [str(path)])[0]
    return pose


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return []


def _mounts(
    sequences: Sequence[FolderSequence], extrinsics: Sequence[str], paths: Sequence[str | os.PathLike[str]]
) -> list[Pose]:
    """Return T_first_sensor of each sensor after the first."""
    if extrinsics:
        if len(extrinsics) != len(sequences) - 1:
            raise ConfigError(
                f"--extrinsics is given {len(extrinsics)} times for {len(sequences)} sensors; give it once for each "
                "after the first"
            )
        return [read_extrinsic(text) for text in extrinsics]
    told = [sequence.T_rig_depth for sequence in sequences]
    for path, pose in zip(paths, told, strict=True):
        if pose is None:
            raise SequenceError(
                f"{os.fspath(path)}: does not tell how its sensor is mounted; give --extrinsics for each sensor after "
                f"the first, or {MOUNT} in every intrinsics.json"
            )
    known = [pose for pose in told if pose is not None]
    return [inverse(known[0]) @ pose for pose in known[1:]]


def _for_each(name: str, given: Sequence[Value], count: int) -> list[Value | None]:
    """Return what is said of each sensor; None where nothing is."""
    if len(given) not in (0, 1, count):
        raise ConfigError(f"{name} is given {len(given)} times for {count} sensors; give it once or for each of them")
    return [None] * count if not given else list(given) if len(given) == count else [given[0]] * count
