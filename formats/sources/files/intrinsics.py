# SPDX-License-Identifier: MIT
"""Camera intrinsics as users have them: our own JSON, Open3D's JSON, a 3x3 matrix, or four numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from threedvc.errors import ConfigError, SequenceError
from threedvc.formats.sources.association import PicturePair
from threedvc.formats.sources.camera_checks import check_camera, check_rig, doubts_of, matrix_parameters
from threedvc.formats.sources.files.images import read_header
from threedvc.formats.sources.files.poses import rigid_poses
from threedvc.formats.sources.files.text import read_json, read_rows
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import KnownCameras, SourceOptions, resolved
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose

__all__ = [
    "MAX_FPS",
    "MIN_FPS",
    "CameraFile",
    "PictureSize",
    "find_cameras",
    "numbers_option",
    "published_camera",
    "read_intrinsics",
]

PictureSize = tuple[int, int]

MIN_FPS, MAX_FPS = 1e-3, 1e5
"""From a frame in a quarter of an hour to more than any camera takes."""
MIN_DEPTH_SCALE, MAX_DEPTH_SCALE = 1e-3, 1e9
"""Units from a kilometer to a nanometer."""
INTRINSIC_NAMES = ("fx", "fy", "cx", "cy")
REMEDY = "give --intrinsics FILE or fx,fy,cx,cy"


@dataclass(frozen=True, kw_only=True)
class CameraFile:
    """What an intrinsics file or option says: cameras, and where it says so, depth scale, frame rate, and mounting.

    The notices tell what is odd about the cameras.
    """

    rig: CameraRig
    depth_scale: float | None = None
    fps: float | None = None
    T_rig_depth: Pose | None = None
    notices: tuple[Notice, ...] = ()


def find_cameras(
    folder: Path, options: SourceOptions, pair: PicturePair, own_file: Path | None = None
) -> CameraFile | None:
    """Return the cameras that the user gives, else those of the recording's own file, else None.

    Parameters
    ----------
    folder, options
        The recording and what the user said.
    pair
        The first color and depth picture: their sizes complete what names no size.
    own_file
        The intrinsics file of the recording, if it has one. It also completes the user's depth scale, frame rate and
        mounting.
    """
    color, depth = (read_header(path).size for path in pair)
    own = read_intrinsics(own_file, color, depth) if own_file else None
    if options.intrinsics is None:
        return own if own is not None or options.known is None else _of_stream(options.known)
    path = resolved(folder, options.intrinsics)
    given = read_intrinsics(path, color, depth) if path.is_file() else numbers_option(options.intrinsics, color, depth)
    if own is None:
        return given
    mount = own.T_rig_depth if given.T_rig_depth is None else given.T_rig_depth
    return replace(given, depth_scale=given.depth_scale or own.depth_scale, fps=given.fps or own.fps, T_rig_depth=mount)


def _of_stream(known: KnownCameras) -> CameraFile:
    return CameraFile(rig=known.rig, depth_scale=known.depth_scale, fps=known.fps)


def published_camera(camera: Camera | None, pair: PicturePair, *, nominal: str | None = None) -> CameraFile:
    """Return the published camera of a data set as a registered rig; that it is only the `nominal` one of this is told.

    Raises
    ------
    SequenceError
        If there is none or the pictures differ from it in size.
    """
    if camera is None or any(read_header(path).size != (camera.width, camera.height) for path in pair):
        raise SequenceError(f"{pair[0].parent.parent}: no camera intrinsics; {REMEDY}")
    told = f"{pair[0].parent.parent}: no camera file; the nominal camera of {nominal} (fx {camera.fx:g}) is assumed; "
    notices = () if nominal is None else (Notice(f"{told}{REMEDY} for another"),)
    return CameraFile(rig=CameraRig.registered_to(camera), notices=notices)


def numbers_option(text: str, color: PictureSize, depth: PictureSize) -> CameraFile:
    """Read ``fx,fy,cx,cy`` (pixels) as the one camera of registered pictures.

    Raises
    ------
    ConfigError
        If the text is not four sensible numbers, or color and depth differ in size.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 4:
        raise ConfigError(f"--intrinsics {text}: neither a file nor four numbers fx,fy,cx,cy; {REMEDY}")
    if color != depth:
        raise ConfigError(
            f"--intrinsics {text}: one camera cannot have pictures of {_size(color)} (color) and {_size(depth)} "
            "(depth); give a file with color, depth and T_color_depth"
        )
    return _checked(CameraFile(rig=CameraRig.registered_to(_camera(values, color, f"--intrinsics {text}"))), text)


def read_intrinsics(path: Path, color: PictureSize, depth: PictureSize) -> CameraFile:
    """Read an intrinsics file.

    Parameters
    ----------
    path
        A ``.json`` file, in our form (`width, height, fx, fy, cx, cy`, optional `distortion`, `depth_scale`, `fps`,
        `T_rig_depth`; or the cameras under `color` and `depth`, with `T_color_depth`) or in Open3D's
        (`width, height`, column-major `intrinsic_matrix`); or a text file with a 3x3 or 4x4 matrix.
    color, depth
        Width and height of the first pictures, for files that do not say.

    Raises
    ------
    SequenceError
        If the file cannot be read or a value is missing or impossible.
    """
    if path.suffix.lower() != ".json":
        return _checked(CameraFile(rig=_registered(_matrix_file(path), color, depth, str(path))), str(path))
    content = read_json(path)
    if isinstance(content.get("intrinsic"), dict):
        content = {**content, **_mapping(content, "intrinsic", path)}
    file = CameraFile(
        rig=_two_cameras(content, path) if "color" in content else _one_camera(content, path, color, depth),
        depth_scale=_optional_positive(content, "depth_scale", path, MIN_DEPTH_SCALE, MAX_DEPTH_SCALE),
        fps=_optional_positive(content, "fps", path, MIN_FPS, MAX_FPS),
        T_rig_depth=_transform(content, "T_rig_depth", path),
    )
    return _checked(file, str(path))


def _checked(file: CameraFile, source: str) -> CameraFile:
    """Return a camera file with its doubts told; raises SequenceError if there can be no such cameras."""
    check_rig(file.rig, source)
    cameras = {file.rig.color, file.rig.depth}
    for camera in cameras:
        check_camera(camera, source, REMEDY)
    return replace(file, notices=tuple(doubt for camera in cameras for doubt in doubts_of(camera, source)))


def _one_camera(content: Mapping[str, object], path: Path, color: PictureSize, depth: PictureSize) -> CameraRig:
    if "intrinsic_matrix" in content:
        matrix = _numbers(content, "intrinsic_matrix", path)
        values = matrix_parameters(matrix, f"{path}: intrinsic_matrix")
        size = _picture_size(content, path) if "width" in content else color
        return _registered(values, size, size if "width" in content else depth, str(path))
    return CameraRig.registered_to(_camera_entry(content, path, ""))


def _two_cameras(content: Mapping[str, object], path: Path) -> CameraRig:
    extrinsic = _transform(content, "T_color_depth", path)
    return CameraRig(
        color=_camera_entry(_mapping(content, "color", path), path, "color."),
        depth=_camera_entry(_mapping(content, "depth", path), path, "depth."),
        T_color_depth=np.eye(4) if extrinsic is None else extrinsic,
    )


def _transform(content: Mapping[str, object], name: str, path: Path) -> Pose | None:
    if name not in content:
        return None
    try:
        matrix = np.array(content[name], dtype=np.float64).reshape(4, 4)
    except (TypeError, ValueError):
        raise SequenceError(f"{path}: {name} is not a 4x4 matrix of numbers; correct the file") from None
    pose: Pose = rigid_poses(matrix[None], [f"{path}: {name}"])[0]
    return pose


def _camera_entry(content: Mapping[str, object], path: Path, prefix: str) -> Camera:
    missing = [name for name in ("width", "height", *INTRINSIC_NAMES) if name not in content]
    if missing:
        raise SequenceError(f"{path}: {prefix}{missing[0]} is missing; add it, or {REMEDY}")
    values = [_number(content, name, path) for name in INTRINSIC_NAMES]
    distortion = _numbers(content, "distortion", path) if "distortion" in content else []
    if len(distortion) not in (0, 4, 5):
        raise SequenceError(
            f"{path}: {prefix}distortion has {len(distortion)} coefficients, expected k1 k2 p1 p2 k3; "
            "undistort the pictures or fit that model"
        )
    return _camera(values, _picture_size(content, path), str(path), distortion)


def _registered(values: list[float], color: PictureSize, depth: PictureSize, source: str) -> CameraRig:
    if color != depth:
        raise SequenceError(
            f"{source}: holds one camera, but color is {_size(color)} and depth {_size(depth)}; "
            "give a JSON file with color, depth and T_color_depth"
        )
    return CameraRig.registered_to(_camera(values, color, source))


def _camera(values: list[float], size: PictureSize, source: str, distortion: list[float] | None = None) -> Camera:
    fx, fy, cx, cy = values
    k1, k2, p1, p2, k3 = [*(distortion or []), 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    width, height = size
    try:
        return Camera(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3))
    except ConfigError as error:
        raise SequenceError(f"{source}: {error}; {REMEDY}") from None


def _matrix_file(path: Path) -> list[float]:
    rows = [row.floats() for row in read_rows(path)]
    if [len(row) for row in rows] == [9]:
        return matrix_parameters(rows[0], str(path))
    if len(rows) not in (3, 4) or any(len(row) != len(rows) for row in rows):
        raise SequenceError(f"{path}: is neither JSON nor a 3x3 matrix; {REMEDY}")
    return matrix_parameters([number for row in rows[:3] for number in row[:3]], str(path))


def _picture_size(content: Mapping[str, object], path: Path) -> PictureSize:
    return int(_number(content, "width", path)), int(_number(content, "height", path))


def _mapping(content: Mapping[str, object], name: str, path: Path) -> Mapping[str, object]:
    value = content.get(name)
    if not isinstance(value, dict):
        raise SequenceError(f"{path}: {name} is not an object with fx, fy, cx, cy; correct the file")
    return value


def _optional_positive(content: Mapping[str, object], name: str, path: Path, least: float, most: float) -> float | None:
    if content.get(name) is None:
        return None
    value = _number(content, name, path)
    if value <= 0:
        raise SequenceError(f"{path}: {name} is {value:g}, expected a positive number; correct the file")
    if not least <= value <= most:
        raise SequenceError(f"{path}: {name} is {value:g}, expected {least:g} to {most:g}; correct the file")
    return value


def _number(content: Mapping[str, object], name: str, path: Path) -> float:
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise SequenceError(f"{path}: {name} is {value!r}, expected a number; correct the file")
    return float(value)


def _numbers(content: Mapping[str, object], name: str, path: Path) -> list[float]:
    value = content[name]
    if isinstance(value, list) and value and all(isinstance(item, list) for item in value):
        value = [number for row in value for number in row]
    if not isinstance(value, list) or not all(isinstance(item, int | float) for item in value):
        raise SequenceError(f"{path}: {name} is not a list of numbers; correct the file")
    return [float(item) for item in value]


def _size(size: PictureSize) -> str:
    return f"{size[0]}x{size[1]}"
