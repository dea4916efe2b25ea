# SPDX-License-Identifier: MIT
"""What a layout reader hands over: which files make up each frame, and what holds for all of them.

A layout is one module that defines a `Layout`; `registry.py` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from threedvc.errors import SequenceError
from threedvc.formats.sources.notices import Notice
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose
from threedvc.stream.notes.input_options import InputOptions

__all__ = [
    "DEFAULT_FPS",
    "FrameFiles",
    "Layout",
    "Recording",
    "SourceOptions",
    "chosen_folder",
    "first_folder",
    "resolved",
]

DEFAULT_FPS = 30.0
"""What depth cameras do unless told otherwise."""


@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """What a user may say about a recording; None leaves it to the recording.

    Attributes
    ----------
    color, depth
        Folders of pictures, relative to the recording or to the current folder.
    intrinsics
        A file, or ``fx,fy,cx,cy``.
    depth_scale
        Units per meter of the depth pictures.
    fps
        Nominal frame rate.
    poses
        What the camera poses are to be taken for, see `threedvc.geometry.pose_readings`.
    known
        Cameras for a recording that tells none.
    """

    color: str | None = None
    depth: str | None = None
    intrinsics: str | None = None
    depth_scale: float | None = None
    fps: float | None = None
    poses: str | None = None
    known: KnownCameras | None = None


@dataclass(frozen=True, kw_only=True)
class KnownCameras:
    """Cameras that are known beside the recording: those of a stream that was made of it.

    They stand in for what neither the user nor the recording says.
    """

    rig: CameraRig
    depth_scale: float
    fps: float


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameFiles:
    """The files and the known facts of one frame; the names are those of `threedvc.frames.frame.Frame`.

    Where each object has a mask of its own, `object_masks` names them by label.
    """

    color: Path
    depth: Path
    timestamp_ns: int
    mask: Path | None = None
    object_masks: Mapping[int, Path] = field(default_factory=dict)
    color_timestamp_ns: int | None = None
    T_world_camera: Pose | None = None
    T_camera_object: Mapping[int, Pose] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """A recorded sequence before any picture is decoded.

    Attributes
    ----------
    folder
        Where it was found.
    frames
        In order of time.
    rig
        Cameras.
    depth_scale
        Units per meter of the depth pictures.
    depth_scale_told
        Whether the user or the recording says so; else it is a custom of the layout.
    fps
        Nominal frame rate.
    T_rig_depth
        Pose of the depth camera on the mount that it shares with other sensors, or None where that is not told.
    poses_from
        File or folder that the camera poses were read from, for messages.
    notices
        Decisions of the reader that the user should know.
    read_as
        The options that the user gave, so that the recording can be read so again.
    """

    folder: Path
    frames: tuple[FrameFiles, ...]
    rig: CameraRig
    depth_scale: float
    fps: float
    depth_scale_told: bool = False
    T_rig_depth: Pose | None = None
    poses_from: Path | None = None
    notices: tuple[Notice, ...] = ()
    read_as: InputOptions = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """One way to lay out an RGB-D recording in a folder.

    Attributes
    ----------
    name
        What a user calls it.
    recognizes
        Tells, without opening a picture, whether a folder has this layout.
    read
        Lists a recording; raises SequenceError or ConfigError.
    takes_folders
        Whether the color and depth folders can be given.
    trial
        When it is tried, where the layout is not told: the more telling its files, the sooner.
    """

    name: str
    recognizes: Callable[[Path], bool]
    read: Callable[[Path, SourceOptions], Recording]
    takes_folders: bool = False
    trial: int = 60


def resolved(folder: Path, given: str) -> Path:
    """Return the path a user means: relative to the recording, or to the current folder if it exists only there."""
    inside, outside = folder / given, Path(given)
    return outside if outside.exists() and not inside.exists() else inside


def chosen_folder(folder: Path, given: str | None, default: Path | None, option: str) -> Path:
    """Return the folder of pictures that the user gives, else the recording's own.

    Raises
    ------
    SequenceError
        If it does not exist.
    """
    chosen = default if given is None else resolved(folder, given)
    if chosen is None or not chosen.is_dir():
        raise SequenceError(f"{chosen or folder}: no such folder of pictures; give it with {option} DIR")
    return chosen


def first_folder(folder: Path, names: tuple[str, ...]) -> Path | None:
    """Return the first of several subfolders that exists."""
    return next((folder / name for name in names if (folder / name).is_dir()), None)
