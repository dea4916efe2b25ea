# SPDX-License-Identifier: MIT
"""Put a recording together out of what its layout found, its cameras, and what the user says."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from threedvc.formats.sources.files.intrinsics import CameraFile
from threedvc.formats.sources.files.masks import unread_masks
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import FrameFiles, Recording, SourceOptions
from threedvc.stream.notes.input_options import InputOptions

__all__ = ["assemble"]


def assemble(
    folder: Path,
    frames: Sequence[FrameFiles],
    cameras: CameraFile,
    options: SourceOptions,
    *,
    depth_scale: float,
    fps: float,
    poses_from: Path | None = None,
    notices: Iterable[Notice] = (),
) -> Recording:
    """Return a recording.

    Parameters
    ----------
    folder, frames
        Where it was found, and its frames in order of time.
    cameras, options
        What the intrinsics say, and the user.
    depth_scale
        Units per meter that are the custom of the layout, for neither saying any.
    fps
        Frame rate.
    poses_from
        Where the camera poses were read from.
    notices
        Decisions of the layout's reader; the doubts about the cameras, and masks that it did not read, are added.
    """
    told = options.depth_scale or cameras.depth_scale or (options.known.depth_scale if options.known else None)
    return Recording(
        folder=folder,
        frames=tuple(frames),
        rig=cameras.rig,
        depth_scale=told or depth_scale,
        depth_scale_told=told is not None,
        fps=fps,
        T_rig_depth=cameras.T_rig_depth,
        poses_from=poses_from,
        notices=(*notices, *unread_masks(folder, frames), *cameras.notices),
        read_as=_contradiction(options.depth_scale, cameras.depth_scale),
    )


def _contradiction(asked: float | None, told: float | None) -> InputOptions:
    """Return the depth scale that the user gives where the recording tells another one."""
    return {} if asked is None or told in (None, asked) else {"depth_scale": asked}
