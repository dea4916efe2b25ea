# SPDX-License-Identifier: MIT
"""The text files beside the pictures of the plain layout: poses, times, cameras."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from threedvc.formats.sinks.poses import pose_lines
from threedvc.formats.sources.files.timestamps import regular_stamp
from threedvc.frames.frame import SequenceInfo
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse

__all__ = ["INTRINSICS", "SIDECARS", "WrittenFrame", "intrinsics_text", "sidecar_texts"]

INTRINSICS = "intrinsics.json"
POSES, OBJECT_POSES, TIMESTAMPS = SIDECARS = ("poses.txt", "object_poses.json", "timestamps.txt")


@dataclass(frozen=True, eq=False)
class WrittenFrame:
    """What the text files say of one written frame."""

    index: int
    timestamp_ns: int
    color_timestamp_ns: int | None
    T_world_camera: Pose | None
    T_camera_object: Mapping[int, Pose]


def sidecar_texts(frames: Sequence[WrittenFrame], fps: float) -> dict[str, str]:
    """Return the text of each file, by name, that frames need: poses and times where there is anything to tell."""
    texts = {}
    if any(frame.T_world_camera is not None for frame in frames):
        texts[POSES] = _text(pose_lines((frame.index, frame.T_world_camera) for frame in frames))
    labels = sorted({label for frame in frames for label in frame.T_camera_object})
    if labels:
        entries = {str(label): [_matrix(frame.T_camera_object.get(label)) for frame in frames] for label in labels}
        texts[OBJECT_POSES] = _text([json.dumps(entries)])
    if not all(_is_regular(frame, frames[0], fps) for frame in frames):
        texts[TIMESTAMPS] = _text(["# frame timestamp_ns [color_timestamp_ns]", *map(_stamp_line, frames)])
    return texts


def intrinsics_text(info: SequenceInfo, *, mounted: bool, writer: str, complete: bool) -> str:
    """Return the text of ``intrinsics.json``.

    Parameters
    ----------
    info
        Cameras, depth scale and frame rate.
    mounted
        Whether the sensor's pose on its mount stands there.
    writer
        The command that writes.
    complete
        Whether all frames that were to be written have been.
    """
    rig = info.rig
    cameras: dict[str, object] = _camera_entries(rig.color)
    if not rig.registered:
        cameras = {
            "color": _camera_entries(rig.color),
            "depth": _camera_entries(rig.depth),
            "T_color_depth": rig.T_color_depth.tolist(),
        }
    if mounted:
        cameras["T_rig_depth"] = inverse(rig.T_depth_rig).tolist()
    content = {
        **cameras,
        "depth_scale": info.depth_scale,
        "fps": info.fps,
        "written_by": writer,
        "complete": complete,
    }
    return _text([json.dumps(content, indent=1)])


def _text(lines: Sequence[str]) -> str:
    return "".join(f"{line}\n" for line in lines)


def _matrix(pose: Pose | None) -> object:
    return None if pose is None else pose.tolist()


def _stamp_line(frame: WrittenFrame) -> str:
    stamps = [frame.timestamp_ns] + ([] if frame.color_timestamp_ns is None else [frame.color_timestamp_ns])
    return " ".join(str(value) for value in (frame.index, *stamps))


def _is_regular(frame: WrittenFrame, first: WrittenFrame, fps: float) -> bool:
    regular = regular_stamp(frame.index - first.index, fps)
    return frame.timestamp_ns == regular and frame.color_timestamp_ns is None


def _camera_entries(camera: Camera) -> dict[str, object]:
    entries: dict[str, object] = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    return {**entries, "distortion": list(camera.distortion)} if camera.distorted else entries
