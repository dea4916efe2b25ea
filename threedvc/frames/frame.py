# SPDX-License-Identifier: MIT
"""What enters the encoder: frames, and what is known about a whole sequence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import ConfigError, SequenceError
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, is_rigid
from threedvc.stream.notes.input_options import InputOptions

__all__ = ["Frame", "SensorInfo", "SequenceInfo", "check_frame"]


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
        (height, width, 3) uint8 RGB in the color camera; gray input has three equal channels.
    depth
        (height, width) float32 meters along z in the depth camera; 0 = no measurement.
    saturated
        (height, width) bool, where the depth picture holds the largest value of 16 bits, which is no measurement, in
        place of 0; None: nowhere.
    mask
        (height, width) uint8 object labels in the depth camera, 0 = background, or None.
    T_world_camera
        Known pose of the depth camera, or None.
    T_camera_object
        Known poses of labeled objects, by label.
    color_timestamp_ns
        Time of the color picture where it has a clock of its own, else None.
    color_file
        The JPEG file that the color was decoded from, byte for byte, or None.
    sensor
        Which of several sensors took it, from 0.
    together
        Whether it was taken at the same moment as the frame before, by another sensor: both share all poses.
    """

    index: int
    timestamp_ns: int
    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    mask: NDArray[np.uint8] | None = None
    saturated: NDArray[np.bool_] | None = None
    T_world_camera: Pose | None = None
    T_camera_object: Mapping[int, Pose] = field(default_factory=dict)
    color_timestamp_ns: int | None = None
    color_file: bytes | None = None
    sensor: int = 0
    synchronized: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorInfo:
    """What holds for every frame of one of several sensors.

    Attributes
    ----------
    name
        Name for messages and reports.
    rig
        Its cameras, and how they are mounted.
    depth_scale, fps, gray, read_as
        As in `SequenceInfo`.
    """

    name: str
    rig: CameraRig
    depth_scale: float
    fps: float
    gray: bool = False
    read_as: InputOptions = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class SequenceInfo:
    """What holds for every frame of a sequence.

    Attributes
    ----------
    name
        Name for messages and reports.
    rig
        Cameras; those of the first sensor where there are several.
    depth_scale
        Units per meter of the 16-bit depth pictures; decoded depth is written at this scale.
    fps
        Nominal frame rate, of all sensors together.
    frame_count
        Number of frames, or None for a live source.
    gray
        Whether the color pictures have one channel.
    has_camera_poses, has_object_poses, has_masks
        What the frames carry.
    camera_rests
        Whether the camera is known to stand still.
    read_as
        Options that the recording was read with where its user gave any, see `threedvc.stream.notes.input_options`.
    sensors
        All sensors, the first one included, where there are several; else empty.
    """

    name: str
    rig: CameraRig
    depth_scale: float
    fps: float
    frame_count: int | None
    gray: bool = False
    has_camera_poses: bool = False
    has_object_poses: bool = False
    has_masks: bool = False
    camera_rests: bool = False
    read_as: InputOptions = field(default_factory=dict)
    sensors: tuple[SensorInfo, ...] = ()

    def __post_init__(self) -> None:
        if not (np.isfinite(self.depth_scale) and self.depth_scale > 0):
            raise ConfigError(f"depth scale {self.depth_scale} must be a positive number of units per meter")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise ConfigError(f"frame rate {self.fps} must be a positive number of frames per second")

    @property
    def each_sensor(self) -> tuple[SensorInfo, ...]:
        """All sensors, also if there is but one."""
        if self.sensors:
            return self.sensors
        names = ("name", "rig", "depth_scale", "fps", "gray", "read_as")
        return (SensorInfo(**{name: getattr(self, name) for name in names}),)

    @property
    def rigs(self) -> tuple[CameraRig, ...]:
        """Cameras of every sensor."""
        return tuple(sensor.rig for sensor in self.sensors) or (self.rig,)

    def with_rigs(self, rigs: Sequence[CameraRig]) -> SequenceInfo:
        """Return the same with other cameras of every sensor."""
        sensors = tuple(replace(sensor, rig=rig) for sensor, rig in zip(self.sensors, rigs, strict=bool(self.sensors)))
        return replace(self, rig=rigs[0], sensors=sensors)


def check_frame(frame: Frame, info: SequenceInfo) -> None:
    """Check that pictures have the sizes of their cameras, and that poses are rigid.

    Raises
    ------
    SequenceError
        Naming the frame, if one is not so.
    """
    place = f"{info.name}: frame {frame.index}"
    if not 0 <= frame.sensor < len(info.rigs):
        raise SequenceError(f"{place} is of sensor {frame.sensor}, but there are {len(info.rigs)}; number them from 0")
    rig = info.rigs[frame.sensor]
    for name, picture, channels, camera in (
        ("color", frame.color, (3,), rig.color),
        ("depth", frame.depth, (), rig.depth),
        ("saturated pixels", frame.depth if frame.saturated is None else frame.saturated, (), rig.depth),
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
