# SPDX-License-Identifier: MIT
"""Redwood and Open3D recordings: ``{color,rgb,image}/`` and ``depth/`` paired in order, depth in millimeters.

The intrinsics are Open3D's JSON where there is one, else the 525-pixel camera that the Redwood data sets use. A
trajectory in Open3D's ``.log`` form gives one camera-to-world matrix per frame. Names such as
``0000001-000000033369.png`` carry microseconds; frames are then paired by time and keep those stamps.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from threedvc.errors import SequenceError
from threedvc.formats.sources.assembly import assemble
from threedvc.formats.sources.association import Pairing, associate, left_out, list_pictures, pair_pictures
from threedvc.formats.sources.files.intrinsics import find_cameras, published_camera
from threedvc.formats.sources.files.poses import read_trajectory_log
from threedvc.formats.sources.files.timestamps import clock_of
from threedvc.formats.sources.recording import FrameFiles, Layout, Recording, SourceOptions, chosen_folder, first_folder
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose
from threedvc.units import MILLIMETERS, NANOSECONDS

__all__ = ["LAYOUT"]

COLOR_NAMES = ("color", "rgb", "image")
INTRINSICS_NAMES = ("camera_intrinsic.json", "intrinsic.json", "camera_primesense.json", "intrinsics.json")
CAMERA = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
"""The PrimeSense default that the data sets of Redwood, and Open3D, take where none is given."""
STAMPED_NAME = re.compile(r"\d+-(\d+)")
MICROSECOND_NS = NANOSECONDS // 1_000_000
"""Names carry microseconds, stamps are nanoseconds."""


def recognizes(folder: Path) -> bool:
    """Tell whether the folder has color, depth, and an Open3D trajectory, Open3D intrinsics or stamped names."""
    if not (folder / "depth").is_dir() or first_folder(folder, COLOR_NAMES) is None:
        return False
    stamped = any(STAMPED_NAME.fullmatch(path.stem) for path in (folder / "depth").glob("*-*.png"))
    return stamped or bool(_trajectories(folder)) or _intrinsics(folder) is not None


def read(folder: Path, options: SourceOptions) -> Recording:
    """List a Redwood recording; raises SequenceError or ConfigError."""
    pairing = _pairs(*_folders(folder, options))
    pairs = pairing.pairs
    cameras = find_cameras(folder, options, pairs[0], _intrinsics(folder)) or published_camera(
        CAMERA, pairs[0], nominal="Redwood's sensor"
    )
    clock = clock_of(pairing.stamps, len(pairs), options.fps or cameras.fps, str(folder))
    poses = _poses(folder, len(pairs))
    frames = tuple(
        FrameFiles(color=color, depth=depth, timestamp_ns=stamp, color_timestamp_ns=color_stamp, T_world_camera=pose)
        for (color, depth), (stamp, color_stamp), pose in zip(pairs, clock.stamps, poses, strict=True)
    )
    return assemble(
        folder,
        frames,
        cameras,
        options,
        depth_scale=MILLIMETERS,
        fps=clock.fps,
        poses_from=next(iter(_trajectories(folder)), None),
        notices=(*pairing.notices, *clock.notices),
    )


def _folders(folder: Path, options: SourceOptions) -> tuple[Path, Path]:
    color = chosen_folder(folder, options.color, first_folder(folder, COLOR_NAMES), "--color")
    return color, chosen_folder(folder, options.depth, folder / "depth", "--depth")


def _pairs(color_folder: Path, depth_folder: Path) -> Pairing:
    colors, depths = list_pictures(color_folder), list_pictures(depth_folder)
    color_stamps, depth_stamps = _name_stamps(colors), _name_stamps(depths)
    if not color_stamps or not depth_stamps:
        return pair_pictures(color_folder, depth_folder)
    matches = associate(color_stamps, depth_stamps)
    if not matches:
        raise SequenceError(f"{color_folder}: no picture within 20 ms of one in {depth_folder}; check the file names")
    pairs = [(colors[i], depths[j]) for i, j in matches]
    stamps = [(depth_stamps[j], None if color_stamps[i] == depth_stamps[j] else color_stamps[i]) for i, j in matches]
    notices = left_out(len(colors), len(depths), len(matches), str(depth_folder.parent))
    return Pairing(pairs, list(range(len(pairs))), stamps, tuple(notices))


def _name_stamps(paths: Sequence[Path]) -> list[int]:
    """Return the stamps in the file names in nanoseconds, or nothing unless all names carry increasing ones."""
    matches = [STAMPED_NAME.fullmatch(path.stem) for path in paths]
    stamps = [int(match[1]) * MICROSECOND_NS for match in matches if match]
    return stamps if len(stamps) == len(paths) and stamps == sorted(stamps) else []


def _intrinsics(folder: Path) -> Path | None:
    return next((folder / name for name in INTRINSICS_NAMES if (folder / name).is_file()), None)


def _trajectories(folder: Path) -> list[Path]:
    main = folder / "trajectory.log"
    return [main] if main.is_file() else sorted(folder.glob("*.log"))


def _poses(folder: Path, count: int) -> Sequence[Pose | None]:
    paths = _trajectories(folder)
    if not paths:
        return [None] * count
    if len(paths) > 1:
        raise SequenceError(
            f"{folder}: several trajectories ({paths[0].name}, {paths[1].name}); name the right one trajectory.log"
        )
    poses = read_trajectory_log(paths[0])
    if len(poses) != count:
        raise SequenceError(f"{paths[0]}: {len(poses)} poses for {count} frames; remove it to track the camera instead")
    return poses


LAYOUT = Layout(name="redwood", recognizes=recognizes, read=read, takes_folders=True, trial=50)
