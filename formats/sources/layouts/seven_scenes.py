# SPDX-License-Identifier: MIT
"""Microsoft 7-Scenes: ``frame-NNNNNN.{color.png,depth.png,pose.txt}`` in one folder per sequence.

Depth is in millimeters, 0 and 65535 mean no measurement. Color and depth are not registered: two cameras with
their nominal intrinsics, taken to stand in one place because the release gives no extrinsic. A pose is that of
the depth camera, camera-to-world. 30 frames a second.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from threedvc.errors import SequenceError
from threedvc.formats.sources.assembly import assemble
from threedvc.formats.sources.association import PicturePair
from threedvc.formats.sources.files.intrinsics import REMEDY, CameraFile, find_cameras
from threedvc.formats.sources.files.poses import read_known_matrix
from threedvc.formats.sources.files.timestamps import regular_stamp
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import DEFAULT_FPS, FrameFiles, Layout, Recording, SourceOptions
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose
from threedvc.units import MILLIMETERS

__all__ = ["LAYOUT"]

FRAME_FILE = re.compile(r"frame-(\d+)\.(color\.png|color\.jpg|depth\.png|pose\.txt)")
OWN_CAMERAS = ("camera-intrinsics.txt", "intrinsics.json", "camera_intrinsic.json")
"""Files beside pictures of these names that are of another camera: tsdf-fusion, 3DMatch, Open3D."""
RIG = CameraRig(
    color=Camera(width=640, height=480, fx=525.0, fy=525.0, cx=320.0, cy=240.0),
    depth=Camera(width=640, height=480, fx=585.0, fy=585.0, cx=320.0, cy=240.0),
    T_color_depth=np.eye(4),
)
"""As published with the data set: nominal values of a Kinect 1."""


def recognizes(folder: Path) -> bool:
    """Tell whether the folder holds a ``frame-NNNNNN.depth.png``."""
    return any(folder.glob("frame-*.depth.png"))


def read(folder: Path, options: SourceOptions) -> Recording:
    """List a 7-Scenes sequence; raises SequenceError or ConfigError."""
    files = _files_by_number(folder)
    pairs = _pairs(folder, files)
    poses = _poses(folder, files)
    cameras, notices = _cameras(folder, options, pairs[0])
    fps = options.fps or cameras.fps or DEFAULT_FPS
    first = min(files)
    frames = tuple(
        FrameFiles(
            color=color,
            depth=depth,
            timestamp_ns=regular_stamp(number - first, fps),
            T_world_camera=poses.get(number),
        )
        for number, (color, depth) in zip(files, pairs, strict=True)
    )
    return assemble(
        folder,
        frames,
        cameras,
        options,
        depth_scale=MILLIMETERS,
        fps=fps,
        poses_from=folder / "frame-*.pose.txt",
        notices=notices,
    )


def _cameras(folder: Path, options: SourceOptions, pair: PicturePair) -> tuple[CameraFile, list[Notice]]:
    """Return the cameras that the user gives, those of a file beside the pictures, or the nominal ones."""
    beside = next(
        (place / name for place in (folder, folder.parent) for name in OWN_CAMERAS if (place / name).is_file()), None
    )
    cameras = find_cameras(folder, options, pair, beside)
    if cameras is None:
        sizes = f"{RIG.color.fx:g} and {RIG.depth.fx:g} pixels, color and depth not registered"
        told = f"{folder}: no camera file; the nominal cameras of 7-Scenes ({sizes}) are assumed; {REMEDY} for others"
        return CameraFile(rig=RIG), [Notice(told)]
    if options.intrinsics is not None:
        return cameras, []
    return cameras, [Notice(f"{folder}: its cameras are taken from {beside}, color and depth registered")]


def _files_by_number(folder: Path) -> dict[int, dict[str, Path]]:
    files: dict[int, dict[str, Path]] = {}
    for path in sorted(folder.iterdir()):
        if match := FRAME_FILE.fullmatch(path.name):
            kind = match[2].split(".")[0]
            files.setdefault(int(match[1]), {})[kind] = path
    if not files:
        raise SequenceError(f"{folder}: holds no frame-NNNNNN.color.png; give the folder of one sequence (seq-01)")
    return dict(sorted(files.items()))


def _pairs(folder: Path, files: Mapping[int, Mapping[str, Path]]) -> Sequence[PicturePair]:
    for number, kinds in files.items():
        for kind in ("color", "depth"):
            if kind not in kinds:
                raise SequenceError(
                    f"{folder / f'frame-{number:06d}.{kind}.png'}: missing; add it or remove frame {number}"
                )
    return [(kinds["color"], kinds["depth"]) for kinds in files.values()]


def _poses(folder: Path, files: Mapping[int, Mapping[str, Path]]) -> dict[int, Pose | None]:
    paths = {number: kinds["pose"] for number, kinds in files.items() if "pose" in kinds}
    return {number: read_known_matrix(path) for number, path in paths.items()}


LAYOUT = Layout(name="7scenes", recognizes=recognizes, read=read, trial=30)
