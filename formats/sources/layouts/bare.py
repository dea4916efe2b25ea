# SPDX-License-Identifier: MIT
"""Bare folders of color and depth pictures, paired by the numbers or the times in their names.

The intrinsics must be given, unless BOP or nerfstudio left a file with them; depth is in millimeters unless the scale
is given. Names that are times give the clock, else it is regular. Masks are read from ``masks/`` or ``mask_visib/``,
poses (4x4 camera-to-world) from ``pose/N.txt``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from threedvc.errors import SequenceError
from threedvc.formats.sources.assembly import assemble
from threedvc.formats.sources.association import pair_pictures
from threedvc.formats.sources.files.intrinsics import REMEDY
from threedvc.formats.sources.files.masks import find_masks
from threedvc.formats.sources.files.pose_folder import find_pose_folder, read_pose_folder
from threedvc.formats.sources.files.program_cameras import cameras_beside
from threedvc.formats.sources.files.timestamps import clock_of
from threedvc.formats.sources.recording import FrameFiles, Layout, Recording, SourceOptions, chosen_folder, first_folder
from threedvc.geometry.pose import Pose
from threedvc.units import MILLIMETERS

__all__ = ["LAYOUT"]

COLOR_NAMES = ("color", "rgb", "image", "images", "colour")
DEPTH_NAMES = ("depth", "depths")


def recognizes(folder: Path) -> bool:
    """Tell whether the folder has a folder named like color and one named like depth."""
    return first_folder(folder, COLOR_NAMES) is not None and first_folder(folder, DEPTH_NAMES) is not None


def read(folder: Path, options: SourceOptions) -> Recording:
    """List a recording of bare folders; raises SequenceError or ConfigError."""
    color = chosen_folder(folder, options.color, first_folder(folder, COLOR_NAMES), "--color")
    depth = chosen_folder(folder, options.depth, first_folder(folder, DEPTH_NAMES), "--depth")
    pairing = pair_pictures(color, depth)
    cameras = cameras_beside(folder, options, pairing.pairs[0])
    if cameras is None:
        raise SequenceError(f"{folder}: no camera intrinsics; {REMEDY}")
    clock = clock_of(pairing.stamps, len(pairing.pairs), options.fps or cameras.fps, str(folder))
    masks = find_masks(folder, pairing)
    poses, poses_from = _poses(folder, pairing.numbers)
    frames = [
        FrameFiles(
            color=color_path,
            depth=depth_path,
            mask=masks.of_frames.get(number),
            object_masks=masks.of_objects.get(number, {}),
            timestamp_ns=stamp,
            color_timestamp_ns=color_stamp,
            T_world_camera=poses.get(number),
        )
        for (color_path, depth_path), number, (stamp, color_stamp) in zip(
            pairing.pairs, pairing.numbers, clock.stamps, strict=True
        )
    ]
    return assemble(
        folder,
        frames,
        cameras,
        options,
        depth_scale=MILLIMETERS,
        fps=clock.fps,
        poses_from=poses_from,
        notices=(*pairing.notices, *clock.notices, *masks.notices),
    )


def _poses(folder: Path, numbers: Sequence[int]) -> tuple[dict[int, Pose | None], Path | None]:
    """Return the poses in a folder beside the pictures, where there is one."""
    place = find_pose_folder(folder)
    return ({}, None) if place is None else (read_pose_folder(place, numbers), place)


LAYOUT = Layout(name="bare", recognizes=recognizes, read=read, takes_folders=True, trial=80)
