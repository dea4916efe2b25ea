# SPDX-License-Identifier: MIT
"""What enters the encoder: frames, and what is known about a whole sequence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from threedvc.camera import CameraRig
from threedvc.errors import ConfigError, SequenceError
from threedvc.pose import Pose, is_rigid

__all__ = ["NANOSECONDS", "Frame", "FrameSequence", "SequenceInfo", "ThinnedSequence", "check_frame"]

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """One RGB-D frame.

    Attributes
    ----------
    index
        Position in the encoded sequence, from 0.
    timestamp_ns
        Time of the depth picture, nanoseconds.
    color
        (height, width, 3) uint8 RGB in the colour camera; grey input has three equal channels.
    depth
        (height, width) float32 metres along z in the depth camera; 0 = no measurement.
    mask
        (height, width) uint8 object labels in the depth camera, 0 = background, or None.
    T_world_camera
        Known pose of the depth camera, or None.
    T_camera_object
        Known poses of labelled objects, by label.
    color_timestamp_ns
        Time of the colour picture where it has a clock of its own, else None.
    """

    index: int
    timestamp_ns: int
    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    mask: NDArray[np.uint8] | None = None
    T_world_camera: Pose | None = None
    T_camera_object: Mapping[int, Pose] = field(default_factory=dict)
    color_timestamp_ns: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class SequenceInfo:
    """What holds for every frame of a sequence.

    Attributes
    ----------
    name
        Name for messages and reports.
    rig
        Cameras.
    depth_scale
        Units per metre of the 16-bit depth pictures; decoded depth is written at this scale.
    fps
        Nominal frame rate.
    frame_count
        Number of frames, or None for a live source.
    grey
        Whether the colour pictures have one channel.
    has_camera_poses, has_object_poses, has_masks
        What the frames carry.
    """

    name: str
    rig: CameraRig
    depth_scale: float
    fps: float
    frame_count: int | None
    grey: bool = False
    has_camera_poses: bool = False
    has_object_poses: bool = False
    has_masks: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.depth_scale) and self.depth_scale > 0):
            raise ConfigError(f"depth scale {self.depth_scale} must be a positive number of units per metre")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise ConfigError(f"frame rate {self.fps} must be a positive number of frames per second")


def check_frame(frame: Frame, info: SequenceInfo) -> None:
    """Check that pictures have the sizes of their cameras, and that poses are rigid.

    Raises
    ------
    SequenceError
        Naming the frame, if one is not so.
    """
    place = f"{info.name}: frame {frame.index}"
    for name, picture, channels, camera in (
        ("colour", frame.color, (3,), info.rig.color),
        ("depth", frame.depth, (), info.rig.depth),
    ):
        if picture.shape != (camera.height, camera.width, *channels):
            raise SequenceError(
                f"{place} has {name} of shape {picture.shape}, its camera asks for"
                f" {(camera.height, camera.width, *channels)}; give frames and intrinsics of one size"
            )
    if frame.T_world_camera is not None and not is_rigid(frame.T_world_camera):
        raise SequenceError(
            f"{place} has a camera pose that is not a rigid transform; correct it or use --motion track"
        )
    for number, pose in frame.T_camera_object.items():
        if not is_rigid(pose):
            raise SequenceError(f"{place} has a pose of object {number} that is not a rigid transform; correct it")


class FrameSequence(Protocol):
    """A source of frames; it can be read more than once."""

    @property
    def info(self) -> SequenceInfo:
        """What holds for every frame."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...

    def __iter__(self) -> Iterator[Frame]: ...


class ThinnedSequence:
    """Every n-th frame of a sequence, numbered through.

    Parameters
    ----------
    frames
        The sequence.
    step
        n.
    """

    def __init__(self, frames: FrameSequence, step: int) -> None:
        self._frames, self._step = frames, step

    @property
    def info(self) -> SequenceInfo:
        """What holds for every frame."""
        return self._frames.info

    def __len__(self) -> int:
        return -(-len(self._frames) // self._step)

    def __getitem__(self, index: int) -> Frame:
        return replace(self._frames[index * self._step], index=index)

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))
