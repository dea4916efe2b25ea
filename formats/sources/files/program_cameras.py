# SPDX-License-Identifier: MIT
"""Cameras that other programs leave beside pictures: BOP's ``scene_camera.json``, nerfstudio's ``transforms.json``.

BOP has an entry for each frame, whose ``depth_scale`` turns depth into millimeters; one camera must hold for all of
them. Of nerfstudio's file only the one camera of all frames is read. The poses in both are not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from threedvc.errors import ConfigError, SequenceError
from threedvc.formats.sources.association import PicturePair
from threedvc.formats.sources.camera_checks import check_camera, doubts_of
from threedvc.formats.sources.files.images import read_header
from threedvc.formats.sources.files.intrinsics import REMEDY, CameraFile, PictureSize, find_cameras
from threedvc.formats.sources.files.text import read_json
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import SourceOptions
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.units import MILLIMETERS

__all__ = ["cameras_beside"]

BOP, NERFSTUDIO = "scene_camera.json", "transforms.json"
NERF_CAMERA = ("fl_x", "fl_y", "cx", "cy")
NERF_DISTORTION = ("k1", "k2", "p1", "p2", "k3")
NERF_MODELS = ("OPENCV", "PINHOLE", "PERSPECTIVE", "SIMPLE_PINHOLE")


def cameras_beside(folder: Path, options: SourceOptions, pair: PicturePair) -> CameraFile | None:
    """Return the cameras that the user gives, else those of another program's file, else None.

    Parameters
    ----------
    folder, options
        The recording and what the user said. The depth scale of BOP's file holds for the user's cameras, too.
    pair
        The first color and depth picture.

    Raises
    ------
    SequenceError
        If the file cannot be read, has several cameras, or one that cannot be.
    """
    given = find_cameras(folder, options, pair)
    size = read_header(pair[1]).size
    if (folder / BOP).is_file():
        own = _bop(folder / BOP, size)
        return own if given is None else replace(given, depth_scale=given.depth_scale or own.depth_scale)
    if given is None and (folder / NERFSTUDIO).is_file():
        if read_header(pair[0]).size != size:
            raise SequenceError(
                f"{folder / NERFSTUDIO}: has one camera, but color is {_pixels(read_header(pair[0]).size)} and depth "
                f"{_pixels(size)}; give --intrinsics FILE with color, depth and T_color_depth"
            )
        return _nerfstudio(folder / NERFSTUDIO, size)
    return given


def _bop(path: Path, size: PictureSize) -> CameraFile:
    entries = {key: entry for key, entry in read_json(path).items() if isinstance(entry, dict)}
    if not entries:
        raise SequenceError(f"{path}: has no camera of any frame; restore the file, or {REMEDY}")
    first = next(iter(entries))
    matrix, millimeters = _bop_entry(path, first, entries[first])
    for frame, entry in entries.items():
        if _bop_entry(path, frame, entry) != (matrix, millimeters):
            raise SequenceError(
                f"{path}: frame {frame} has another cam_K or depth_scale than frame {first}; one camera and one scale "
                "must hold for all frames of a recording"
            )
    values = [matrix[0], matrix[4], matrix[2], matrix[5]]
    posed = any("cam_R_w2c" in entry for entry in entries.values())
    return _camera_file(path, values, size, posed, depth_scale=MILLIMETERS / millimeters)


def _bop_entry(path: Path, frame: str, entry: Mapping[str, object]) -> tuple[list[float], float]:
    matrix, scale = entry.get("cam_K"), entry.get("depth_scale", 1.0)
    if not isinstance(matrix, list) or len(matrix) != 9 or not all(isinstance(item, int | float) for item in matrix):
        raise SequenceError(f"{path}: cam_K of frame {frame} is not a list of 9 numbers; correct the file, or {REMEDY}")
    if not isinstance(scale, int | float) or not 0 < scale < float("inf"):
        raise SequenceError(
            f"{path}: depth_scale of frame {frame} is {scale!r}, expected a positive number; correct it"
        )
    return [float(item) for item in matrix], float(scale)


def _nerfstudio(path: Path, size: PictureSize) -> CameraFile:
    content = read_json(path)
    model, told = content.get("camera_model", NERF_MODELS[0]), (content.get("w", size[0]), content.get("h", size[1]))
    if model not in NERF_MODELS:
        raise SequenceError(f"{path}: camera_model {model} is not read; undistort the pictures, and {REMEDY}")
    if told != size:
        raise SequenceError(
            f"{path}: its camera is of {told[0]}x{told[1]} pictures, but these are {_pixels(size)}; {REMEDY} of this "
            "size"
        )
    values = [_number(path, content, name) for name in NERF_CAMERA]
    distortion = [_number(path, content, name) if name in content else 0.0 for name in NERF_DISTORTION]
    frames = content.get("frames")
    return _camera_file(path, values, size, bool(frames), distortion=distortion)


def _number(path: Path, content: Mapping[str, object], name: str) -> float:
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SequenceError(f"{path}: {name} of all frames is missing or no number; {REMEDY}")
    return float(value)


def _camera_file(
    path: Path,
    values: list[float],
    size: PictureSize,
    posed: bool,
    *,
    distortion: list[float] | None = None,
    depth_scale: float | None = None,
) -> CameraFile:
    """Return one camera (fx, fy, cx, cy) for color and depth, with what is to be told about its file."""
    fx, fy, cx, cy = values
    k1, k2, p1, p2, k3 = distortion or [0.0] * 5
    try:
        camera = Camera(width=size[0], height=size[1], fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3))
    except ConfigError as error:
        raise SequenceError(f"{path}: {error}; {REMEDY}") from None
    check_camera(camera, str(path), REMEDY)
    scale = "" if depth_scale is None else f" and the depth scale ({depth_scale:g} units per meter)"
    poses = "; its poses are not read, and the camera is tracked" if posed else ""
    told = Notice(f"{path}: the camera (fx {fx:g}){scale} is taken from this file{poses}")
    return CameraFile(
        rig=CameraRig.registered_to(camera), depth_scale=depth_scale, notices=(told, *doubts_of(camera, str(path)))
    )


def _pixels(size: PictureSize) -> str:
    return f"{size[0]}x{size[1]}"
