# SPDX-License-Identifier: MIT
"""Bare folders of colour and depth pictures, paired by number or in sorted order; no poses, regular clock.

The intrinsics must be given; depth is in millimetres unless the scale is given.
"""

from __future__ import annotations

from pathlib import Path

from threedvc.errors import SequenceError
from threedvc.formats.sources.assembly import assemble
from threedvc.formats.sources.association import pair_pictures
from threedvc.formats.sources.intrinsics import REMEDY, find_cameras
from threedvc.formats.sources.recording import (
    DEFAULT_FPS,
    MILLIMETRES,
    FrameFiles,
    Layout,
    Recording,
    SourceOptions,
    chosen_folder,
    first_folder,
)
from threedvc.formats.sources.timestamps import regular_stamp

__all__ = ["LAYOUT"]

COLOR_NAMES = ("color", "rgb", "image", "images", "colour")
DEPTH_NAMES = ("depth", "depths")


def recognises(folder: Path) -> bool:
    """Tell whether the folder has a folder named like colour and one named like depth."""
    return first_folder(folder, COLOR_NAMES) is not None and first_folder(folder, DEPTH_NAMES) is not None


def read(folder: Path, options: SourceOptions) -> Recording:
    """List a recording of bare folders; raises SequenceError or ConfigError."""
    color = chosen_folder(folder, options.color, first_folder(folder, COLOR_NAMES), "--color")
    depth = chosen_folder(folder, options.depth, first_folder(folder, DEPTH_NAMES), "--depth")
    pairs = pair_pictures(color, depth)
    cameras = find_cameras(folder, options, pairs[0])
    if cameras is None:
        raise SequenceError(f"{folder}: no camera intrinsics; {REMEDY}")
    fps = options.fps or cameras.fps or DEFAULT_FPS
    frames = tuple(
        FrameFiles(color=color_path, depth=depth_path, timestamp_ns=regular_stamp(index, fps))
        for index, (color_path, depth_path) in enumerate(pairs)
    )
    return assemble(folder, frames, cameras, options, depth_scale=MILLIMETRES, fps=fps)


LAYOUT = Layout(name="bare", recognises=recognises, read=read, takes_folders=True)
