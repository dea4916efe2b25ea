# SPDX-License-Identifier: MIT
"""A recorded sequence as frames: pictures are decoded when asked for, one step ahead of whoever iterates."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import SequenceError
from threedvc.formats.sources.depth_checks import NO_MEASUREMENT, check_depth
from threedvc.formats.sources.files.images import PictureHeader, read_color, read_depth, read_header, read_mask
from threedvc.formats.sources.files.intrinsics import REMEDY
from threedvc.formats.sources.files.masks import check_masks, merged_labels
from threedvc.formats.sources.files.timestamps import check_intervals
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import FrameFiles, Recording
from threedvc.frames.depth_limit import limited_depth
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose

__all__ = ["FolderSequence"]

Item = TypeVar("Item", bound=np.generic)

READ_AHEAD = 3
"""Frames that are decoded before they are asked for: enough to even out slow ones, and some megabytes each."""


class FolderSequence:
    """Frames of a recording, by index and by iteration, as often as wanted.

    Parameters
    ----------
    recording
        What a layout reader found.
    max_depth_m
        Depth beyond this is no measurement; None keeps all.
    read_ahead
        Number of frames that a thread decodes ahead of an iteration; 0 decodes in the caller's thread.

    Raises
    ------
    SequenceError
        If a picture is missing, of another kind or size than the cameras say, or depth is empty or implausible.
        Damage inside a picture raises when its frame is read.
    ConfigError
        If `max_depth_m` leaves no depth.
    """

    def __init__(self, recording: Recording, *, max_depth_m: float | None = None, read_ahead: int = READ_AHEAD) -> None:
        self._recording = recording
        self._max_depth_m = max_depth_m
        self._read_ahead = read_ahead
        self._notices = list(recording.notices)
        frames = recording.frames
        channels = _check_headers(recording)
        self._notices += check_depth(
            [frame.depth for frame in frames],
            self._raw_depth,
            recording.depth_scale,
            told=recording.depth_scale_told,
            max_depth_m=max_depth_m,
        )
        self._notices += check_intervals([frame.timestamp_ns for frame in frames], str(recording.folder))
        self._notices += check_masks(frames, read_mask)
        self._info = SequenceInfo(
            name=_text(recording.folder.resolve().name),
            rig=recording.rig,
            depth_scale=recording.depth_scale,
            fps=recording.fps,
            frame_count=len(frames),
            gray=channels == {1},
            read_as=recording.read_as,
            has_camera_poses=all(frame.T_world_camera is not None for frame in frames),
            has_object_poses=any(frame.T_camera_object for frame in frames),
            has_masks=frames[0].mask is not None or bool(frames[0].object_masks),
        )

    @property
    def info(self) -> SequenceInfo:
        """What holds for every frame; camera poses count only where every frame has one, masks where the first has."""
        return self._info

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What was decided while the recording was opened, in that order."""
        return tuple(self._notices)

    @property
    def poses_from(self) -> Path | None:
        """File or folder that the camera poses were read from."""
        return self._recording.poses_from

    @property
    def T_rig_depth(self) -> Pose | None:
        """Pose of the depth camera on the mount that it shares with other sensors, or None where that is not told."""
        return self._recording.T_rig_depth

    def facts(self) -> Sequence[FrameFiles]:
        """Return what is known of each frame without a look at its pictures."""
        return self._recording.frames

    def __len__(self) -> int:
        return len(self._recording.frames)

    def __getitem__(self, index: int) -> Frame:
        position = index + len(self) if index < 0 else index
        if not 0 <= position < len(self):
            raise IndexError(f"frame {index} is not one of {len(self)}")
        files, rig = self._recording.frames[position], self._recording.rig
        color, (depth, saturated) = read_color(files.color), self._depth_m(files.depth)
        return Frame(
            index=position,
            timestamp_ns=files.timestamp_ns,
            color=_of_size(rig.color, color.pixels, files.color),
            color_file=color.jpeg,
            depth=_of_size(rig.depth, depth, files.depth),
            saturated=saturated if saturated.any() else None,
            mask=self._mask(files),
            T_world_camera=files.T_world_camera,
            T_camera_object=files.T_camera_object,
            color_timestamp_ns=files.color_timestamp_ns,
        )

    def __iter__(self) -> Iterator[Frame]:
        if self._read_ahead == 0:
            yield from map(self.__getitem__, range(len(self)))
            return
        pending: deque[Future[Frame]] = deque()
        reader = ThreadPoolExecutor(max_workers=1, thread_name_prefix="threedvc-reader")
        try:
            for index in range(len(self)):
                pending.append(reader.submit(self.__getitem__, index))
                if len(pending) > self._read_ahead:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            reader.shutdown(cancel_futures=True)

    def _depth_m(self, path: Path) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return depth (h, w) in meters, 0 where it was not measured, and where that is since it is saturated."""
        raw = read_depth(path)
        saturated = raw == NO_MEASUREMENT
        raw[saturated] = 0
        depth = np.divide(raw, np.float32(self._recording.depth_scale), dtype=np.float32)
        if self._max_depth_m is not None:
            depth = limited_depth(depth, self._max_depth_m)
        return depth, saturated

    def _mask(self, files: FrameFiles) -> NDArray[np.uint8] | None:
        """Return the labels (h, w) of a frame, None where it has none."""
        if files.object_masks:
            path = next(iter(files.object_masks.values()))
            return _of_size(self._recording.rig.depth, merged_labels(files.object_masks, read_mask), path)
        return _of_size(self._recording.rig.depth, read_mask(files.mask), files.mask) if files.mask else None

    def _raw_depth(self, path: Path) -> NDArray[np.uint16]:
        """Return depth in units, 0 where it was not measured."""
        raw = read_depth(path)
        raw[raw == NO_MEASUREMENT] = 0
        return raw


def _text(name: str) -> str:
    """Return a file's name as text; what is no UTF-8 in it is replaced."""
    return os.fsencode(name).decode("utf-8", "replace")


def _of_size(camera: Camera, picture: NDArray[Item], path: Path) -> NDArray[Item]:
    """Return the picture unless its file was exchanged for one of another size since its header was checked."""
    height, width = picture.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise SequenceError(
            f"{path}: is {_pixels((width, height))}, but was {_pixels((camera.width, camera.height))} when the "
            "recording was opened; open it again"
        )
    return picture


def _check_headers(recording: Recording) -> set[int]:
    """Check kind and size of every picture without decoding it; return the channel counts of the color pictures."""
    frames, rig = recording.frames, recording.rig
    colors = _headers([frame.color for frame in frames], (rig.color.width, rig.color.height))
    depth_size = (rig.depth.width, rig.depth.height)
    depths = _headers([frame.depth for frame in frames], depth_size)
    mask_paths = [path for frame in frames for path in _mask_paths(frame)]
    masks = _headers(mask_paths, depth_size)
    for frame, color, depth in zip(frames, colors, depths, strict=True):
        _check_kinds(frame, color, depth)
        if color.orientation != colors[0].orientation:
            raise SequenceError(
                f"{frame.color}: EXIF turns it by orientation {color.orientation}, but {frames[0].color.name} by "
                f"{colors[0].orientation}; turn all pictures alike, as the camera saw them"
            )
    for path, mask in zip(mask_paths, masks, strict=True):
        if (mask.channels, mask.bits, mask.palette) != (1, 8, False):
            raise SequenceError(f"{path}: mask is {_kind(mask)}, expected 8-bit labels of 1 channel; convert the masks")
    return {header.channels for header in colors}


def _mask_paths(frame: FrameFiles) -> list[Path]:
    return [*([frame.mask] if frame.mask else []), *frame.object_masks.values()]


def _headers(paths: Sequence[Path], size: tuple[int, int]) -> list[PictureHeader]:
    headers = [read_header(path) for path in paths]
    for path, header in zip(paths, headers, strict=True):
        if header.size != headers[0].size:
            raise SequenceError(
                f"{path}: is {_pixels(header.size)}, but {paths[0].name} is {_pixels(headers[0].size)}; "
                "bring all pictures to one size"
            )
    if headers and headers[0].size != size:
        raise SequenceError(
            f"{paths[0]}: is {_pixels(headers[0].size)}, but the intrinsics are for {_pixels(size)}; "
            f"{REMEDY} of this size"
        )
    return headers


def _check_kinds(frame: FrameFiles, color: PictureHeader, depth: PictureHeader) -> None:
    if color.bits > 8 or color.channels not in (1, 3):
        raise SequenceError(
            f"{frame.color}: color is {_kind(color)}, expected 8-bit gray or RGB; convert the pictures to 8 bits"
        )
    if (depth.channels, depth.bits) != (1, 16):
        raise SequenceError(
            f"{frame.depth}: depth is {_kind(depth)}, expected 16-bit of 1 channel; convert it to 16-bit PNG"
        )


def _kind(header: PictureHeader) -> str:
    palette = " with a palette" if header.palette else ""
    return f"{header.bits}-bit of {header.channels} channel{'s' if header.channels > 1 else ''}{palette}"


def _pixels(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"
