# SPDX-License-Identifier: MIT
"""What a decoder knows between two packets: sensors, objects, and how the next frame will look."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles
from threedvc.coding.poses import PoseCoder
from threedvc.decoder.frame_state import FrameState, camera_poses
from threedvc.decoder.sensor_state import SensorState
from threedvc.decoder.stream_notes import StreamNotes
from threedvc.errors import CorruptStream
from threedvc.geometry.pose import Pose, compose, identity, inverse
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.post_filter import PostFilter
from threedvc.render.picture import BackgroundImage, Light
from threedvc.stream.headers import ObjectHeader, SensorHeader, SensorRunHeader, StreamHeader
from threedvc.stream.notes.color_times import ColorTimes
from threedvc.stream.sensor_order import Cycle, SensorSchedule

__all__ = ["DecoderState", "ObjectState", "WantedVideos"]


class WantedVideos(NamedTuple):
    """Whether depth and color as captured are wanted, and on how many threads they are decoded."""

    depth: bool
    color: bool
    threads: int


@dataclass(kw_only=True, eq=False)
class ObjectState:
    """One object.

    Attributes
    ----------
    model
        Its cells.
    pose_coder
        Decoder of its POSE packets.
    pose
        T_camera_world for the background, T_world_object for every other object.
    light
        (8,) factors of the light on it, None before the first LIGHT.
    """

    model: DecodedModel
    pose_coder: PoseCoder
    pose: Pose = field(default_factory=identity)
    light: Doubles | None = None


class DecoderState:
    """The state of a stream whose STREAM packet has come.

    Parameters
    ----------
    header
        The STREAM header.
    notes
        What META packets tell; more may come.
    wanted
        Which pictures as captured are wanted.

    Attributes
    ----------
    sensors
        Those described so far; the first is that of the STREAM header.
    objects
        Those introduced so far, by number; 0 is the background.
    schedule
        Which sensor takes the next frames.
    frame_count, frame_set_count
        How many frames the stream has conveyed so far, and at how many moments these were taken.
    unread_codecs
        Numbers of the codecs of videos that were wanted and cannot be decoded here, by what these show: color, depth.
    run_ends
        Number of the frame, or moment, after the last one that a run of packets has conveyed, by name of run.
    """

    def __init__(self, header: StreamHeader, notes: StreamNotes, wanted: WantedVideos) -> None:
        self.header, self.notes, self.wanted = header, notes, wanted
        self.sensors = [SensorState(header, self._new_pose_coder())]
        self.objects: dict[int, ObjectState] = {}
        self.schedule = SensorSchedule()
        self.frame_count = self.frame_set_count = 0
        self.run_ends: dict[str, int] = {}
        self.unread_codecs: dict[str, int] = {}
        self._new_background_image: NDArray[np.uint8] | None = None
        self._backdrop: BackgroundImage | None = None
        self._filters: PostFilter | None = None

    def _new_pose_coder(self) -> PoseCoder:
        return PoseCoder(self.header.translation_step_m, self.header.rotation_step_rad)

    @property
    def models(self) -> dict[int, DecodedModel]:
        """The models by number of object."""
        return {number: item.model for number, item in self.objects.items()}

    def add_sensor(self, header: SensorHeader) -> None:
        """Add a further sensor."""
        if len(self.sensors) == self.header.sensors:
            raise CorruptStream(f"a SENSOR comes after those of all {self.header.sensors} sensors")
        self.sensors.append(SensorState(header, self._new_pose_coder()))

    def check_sensors(self) -> None:
        """Raise CorruptStream unless all sensors are described."""
        if len(self.sensors) < self.header.sensors:
            raise CorruptStream(
                f"the stream describes {len(self.sensors)} of its {self.header.sensors} sensors before its first frame"
            )

    def sensor(self, header: SensorRunHeader) -> SensorState:
        """Return the sensor that a packet names."""
        if header.sensor >= len(self.sensors):
            raise CorruptStream(
                f"a {header.packet_type.name} names sensor {header.sensor}, but the stream has {len(self.sensors)}"
            )
        return self.sensors[header.sensor]

    def add_object(self, header: ObjectHeader) -> None:
        """Introduce an object, which has no cells yet."""
        if header.object_id in self.objects:
            raise CorruptStream(f"object {header.object_id} is introduced twice")
        model = DecodedModel(
            header.voxel_size_m,
            1 << header.texture_bits,
            guessed=header.guessed,
            relief_bits=header.relief_bits,
            passing=header.passing,
        )
        self.objects[header.object_id] = ObjectState(model=model, pose_coder=self._new_pose_coder())

    def object(self, number: int) -> ObjectState:
        """Return the object that a packet names."""
        if number not in self.objects:
            raise CorruptStream(f"a packet names object {number}, which was not introduced")
        return self.objects[number]

    def set_pose(self, number: int, pose: Pose) -> None:
        """Place an object, from the next frame on."""
        self.objects[number].pose = pose

    def set_light(self, number: int, factors: Doubles) -> None:
        """Set the light (8,) on an object, from the next frame on."""
        self.objects[number].light = factors

    def set_backdrop(self, picture: NDArray[np.uint8]) -> None:
        """Color the background with a picture (h, w, 3), seen from where the camera of the next frame stands."""
        self._new_background_image = picture

    def set_filters(self, filters: PostFilter) -> None:
        """Set the filter of color pictures, from the next frame on."""
        self._filters = filters

    def set_cycle(self, frame: int, cycle: Cycle) -> None:
        """Let sensors take turns in another cycle, from a frame on."""
        self.schedule.begin(frame, cycle)

    def next_frame(self) -> FrameState:
        """Return where everything is in the next frame, which is then conveyed."""
        frame, T_rig_world = self.frame_count, self._pose_of_rig()
        slot = self.schedule.at(frame)
        sensor, synchronized = self.sensors[slot.sensor], slot.synchronized and frame > 0
        timestamp, number = sensor.take_time_ns(), sensor.frames
        self._count_frame(sensor, synchronized)
        offset = self.notes.of(ColorTimes).take_offset_ns(frame)
        poses = camera_poses({number: item.pose for number, item in self.objects.items()})
        T_world_camera = inverse(sensor.rig.at_sensor(T_rig_world))
        return FrameState(
            index=frame,
            timestamp_ns=timestamp,
            color_timestamp_ns=timestamp + offset if offset else None,
            sensor=slot.sensor,
            number=number,
            synchronized=synchronized,
            T_world_camera=T_world_camera,
            T_camera_object={number: sensor.rig.at_sensor(pose) for number, pose in poses.items()},
            T_shifted_camera=sensor.shift,
            gain=sensor.gain,
            backdrop=self._placed_backdrop(T_rig_world),
            lights=self._lights(),
            filters=self._filters,
            captured_depth=sensor.take_captured_depth(T_world_camera),
            captured_color=sensor.take_captured_color(),
        )

    def _pose_of_rig(self) -> Pose:
        return self.objects[0].pose if 0 in self.objects else identity()

    def _count_frame(self, sensor: SensorState, synchronized: bool) -> None:
        sensor.frames += 1
        self.frame_count += 1
        self.frame_set_count += not synchronized

    def _placed_backdrop(self, T_rig_world: Pose) -> BackgroundImage | None:
        """Return the backdrop; a new one is seen from the color camera of the first sensor."""
        if self._new_background_image is not None:
            first = self.sensors[0]
            T_color_rig = compose(first.rig.T_color_depth, first.shift)
            self._backdrop = BackgroundImage(
                picture=self._new_background_image,
                camera=first.rig.color,
                T_camera_world=compose(T_color_rig, T_rig_world),
            )
            self._new_background_image = None
        return self._backdrop

    def _lights(self) -> dict[int, Light]:
        """Return the lights by number; the background is the world, every other object is turned in it."""
        return {
            number: Light(factors=item.light, R_world_object=item.pose[:3, :3] if number else np.eye(3))
            for number, item in self.objects.items()
            if item.light is not None
        }
