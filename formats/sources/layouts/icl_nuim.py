# SPDX-License-Identifier: MIT
"""ICL-NUIM in its TUM-compatible form: ``rgb/N.png``, ``depth/N.png``, ``associations.txt``, ``*.gt.freiburg``.

Depth has 5000 units per meter and is registered to color. The keys of the associations and the first column of
the ground truth are frame numbers, not times: frames are matched to poses by number, on a 30 Hz clock. The ground
truth is that of a mirrored room: with M = diag(1, -1, 1) the pose is (M R M, M t).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from threedvc.errors import SequenceError
from threedvc.formats.sources.assembly import assemble
from threedvc.formats.sources.association import pair_pictures
from threedvc.formats.sources.files.intrinsics import find_cameras, published_camera
from threedvc.formats.sources.files.poses import pose_from_row
from threedvc.formats.sources.files.text import read_rows
from threedvc.formats.sources.files.timestamps import regular_stamp
from threedvc.formats.sources.layouts.tum import DEPTH_SCALE
from threedvc.formats.sources.recording import (
    DEFAULT_FPS,
    FrameFiles,
    Layout,
    Recording,
    SourceOptions,
)
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose

__all__ = ["LAYOUT"]

GROUND_TRUTH = "*.gt.freiburg"
CAMERA = Camera(width=640, height=480, fx=481.20, fy=480.00, cx=319.50, cy=239.50)
"""As published with the data set, which has no file with it; fy is negative there, for its mirrored room."""
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
"""Between that room and a right-handed one: y turned round."""


def recognizes(folder: Path) -> bool:
    """Tell whether the folder has a ``*.gt.freiburg``."""
    return any(folder.glob(GROUND_TRUTH))


def read(folder: Path, options: SourceOptions) -> Recording:
    """List an ICL-NUIM sequence; raises SequenceError or ConfigError."""
    pairing = pair_pictures(folder / "rgb", folder / "depth")
    pairs, numbers = pairing.pairs, pairing.numbers
    cameras = find_cameras(folder, options, pairs[0]) or published_camera(CAMERA, pairs[0])
    fps = options.fps or cameras.fps or DEFAULT_FPS
    poses = _ground_truth(folder)
    frames = tuple(
        FrameFiles(
            color=color,
            depth=depth,
            timestamp_ns=regular_stamp(number - numbers[0], fps),
            T_world_camera=poses.get(number),
        )
        for number, (color, depth) in zip(numbers, pairs, strict=True)
    )
    return assemble(
        folder,
        frames,
        cameras,
        options,
        depth_scale=DEPTH_SCALE,
        fps=fps,
        poses_from=next(folder.glob(GROUND_TRUTH), None),
    )


def _ground_truth(folder: Path) -> dict[int, Pose]:
    paths = sorted(folder.glob(GROUND_TRUTH))
    if len(paths) > 1:
        raise SequenceError(f"{folder}: several trajectories ({paths[0].name}, {paths[1].name}); keep the right one")
    rows = [row for path in paths for row in read_rows(path)]
    return {row.integer(0): MIRROR @ pose_from_row(row) @ MIRROR for row in rows}


LAYOUT = Layout(name="icl-nuim", recognizes=recognizes, read=read, trial=10)
