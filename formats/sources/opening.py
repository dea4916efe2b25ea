# SPDX-License-Identifier: MIT
"""Open a recording in whatever layout it has."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

from threedvc.errors import ConfigError, SequenceError
from threedvc.formats.layout_names import AUTO
from threedvc.formats.sources.files.intrinsics import MAX_FPS, MIN_FPS
from threedvc.formats.sources.recording import KnownCameras, Recording, SourceOptions
from threedvc.formats.sources.registry import find_layout
from threedvc.formats.sources.sequence import FolderSequence
from threedvc.geometry.pose_readings import AS_GIVEN, PoseReading, pose_reading
from threedvc.stream.notes.input_options import InputOptions

__all__ = ["FrameRange", "open_sequence", "require_folder"]

FrameRange = tuple[int | None, int | None, int | None]


def open_sequence(
    path: str | os.PathLike[str],
    *,
    layout: str = AUTO,
    color: str | os.PathLike[str] | None = None,
    depth: str | os.PathLike[str] | None = None,
    intrinsics: str | os.PathLike[str] | None = None,
    depth_scale: float | None = None,
    fps: float | None = None,
    poses: str | None = None,
    max_depth_m: float | None = None,
    frames: FrameRange | None = None,
    known: KnownCameras | None = None,
) -> FolderSequence:
    """Open an RGB-D recording as a sequence of frames.

    Parameters
    ----------
    path
        The recording's folder.
    layout
        ``auto`` or one of `threedvc.formats.layout_names`.
    color, depth
        Folders of pictures, relative to `path` or to the current folder, for layouts that take them.
    intrinsics
        A JSON file (ours or Open3D's), a text file with a 3x3 matrix, or ``fx,fy,cx,cy`` in pixels.
    depth_scale
        Units per meter of the depth pictures.
    fps
        Nominal frame rate; a layout with a clock of its own keeps its stamps.
    poses
        What the camera poses of the recording are to be taken for: ``as-given``, ``inverted``, ``opengl`` or others of
        `threedvc.geometry.pose_readings`, several joined by ``+``.
    max_depth_m
        Depth beyond this many meters is no measurement.
    frames
        ``(start, stop, step)`` as in a slice, except that a range beyond the end is an error and `step` is
        positive. Frames are numbered from 0 again and keep their stamps.
    known
        Cameras, depth scale and rate for a recording that does not tell them: those of a stream that was made of it.

    Returns
    -------
    FolderSequence
        Meters, OpenCV axes, camera-to-world poses, nanoseconds.

    Raises
    ------
    SequenceError
        If the recording is missing, incomplete, unreadable or implausible.
    ConfigError
        If an option has an impossible value.
    """
    for name, value in (("--depth-scale", depth_scale), ("--fps", fps), ("--max-depth", max_depth_m)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ConfigError(f"{name} {value:g}: must be a positive number; correct it or leave it out")
    if fps is not None and not MIN_FPS <= fps <= MAX_FPS:
        raise ConfigError(f"--fps {fps:g}: must be within {MIN_FPS:g} and {MAX_FPS:g}; correct it or leave it out")
    folder = Path(path)
    require_folder(folder)
    options = SourceOptions(
        color=_text(color),
        depth=_text(depth),
        intrinsics=_text(intrinsics),
        depth_scale=depth_scale,
        fps=fps,
        poses=poses,
        known=known,
    )
    reading = pose_reading(poses or AS_GIVEN)
    recording = _with_reading(find_layout(folder, layout, options).read(folder, options), reading)
    recording = replace(recording, read_as={**recording.read_as, **_given(folder, layout, options)})
    return FolderSequence(_cut(recording, frames) if frames else recording, max_depth_m=max_depth_m)


def _given(folder: Path, layout: str, options: SourceOptions) -> InputOptions:
    """Return what a reader cannot tell by itself; folders only where they are in it: others are nobody's business."""
    given: dict[str, str | float] = {}
    if layout != AUTO and layout != _own_layout(folder, options):
        given["layout"] = layout
    for name in ("color", "depth"):
        place = getattr(options, name)
        if place is not None and not Path(place).is_absolute() and (folder / place).is_dir():
            given[name] = place
    if options.poses is not None:
        given["poses"] = options.poses
    return given


def _own_layout(folder: Path, options: SourceOptions) -> str | None:
    try:
        return find_layout(folder, AUTO, options).name
    except SequenceError:
        return None


def _with_reading(recording: Recording, reading: PoseReading) -> Recording:
    """Take the camera poses for what the user says they are."""
    if reading.name == AS_GIVEN:
        return recording
    frames = tuple(
        frame if frame.T_world_camera is None else replace(frame, T_world_camera=reading.convert(frame.T_world_camera))
        for frame in recording.frames
    )
    return replace(recording, frames=frames)


def _text(path: str | os.PathLike[str] | None) -> str | None:
    return None if path is None else os.fspath(path)


def require_folder(folder: Path) -> None:
    """Check that a recording is a folder that is there; raises SequenceError."""
    if folder.is_file():
        raise SequenceError(f"{folder}: is a file; give the folder of an RGB-D recording")
    if not folder.is_dir():
        raise SequenceError(f"{folder}: no such folder; give the folder of an RGB-D recording")


def _cut(recording: Recording, frames: FrameRange) -> Recording:
    start, stop, step = frames
    count = len(recording.frames)
    asked = ":".join("" if part is None else str(part) for part in frames)
    if step is not None and step < 1:
        raise ConfigError(f"--frames {asked}: the step must be 1 or more; correct the range")
    if max(start or 0, stop or 0) > count or min(start or 0, stop or 0) < -count:
        raise SequenceError(f"{recording.folder}: --frames {asked} reaches beyond its {count} frames; shorten it")
    chosen = recording.frames[start:stop:step]
    if not chosen:
        raise SequenceError(f"{recording.folder}: --frames {asked} selects none of its {count} frames; widen it")
    return replace(recording, frames=chosen, fps=recording.fps / (step or 1))
