# SPDX-License-Identifier: MIT
"""What the decoder has been sent: models as decoded, poses as quantized, gains, and whose turn it is.

Whatever a packet means depends on what the decoder has when it comes. So every writer of packets works on this state,
and changes the part that its packets change in the decoder.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from threedvc.coding.gains import GainCoder
from threedvc.coding.poses import PoseCoder
from threedvc.config import PoseConfig
from threedvc.encoder.packetizer.scene_source import SceneSource
from threedvc.geometry.pose import Pose, identity
from threedvc.model.decoded_model import DecodedModel, models_digest
from threedvc.stream.sensor_description import clock_record, nearest_multiple
from threedvc.stream.sensor_order import SensorSchedule

__all__ = ["PoseSteps", "SensorClock", "SentObject", "SentState", "pose_steps"]

STEP_PIXELS = 0.35
"""A pose is rounded by half of this at most, about what registration leaves open; chosen by bytes and pictures."""
MIN_STEP_M, MAX_STEP_M = 5e-5, 5e-3
"""Steps of a translation: a twentieth of a millimeter, which no sensor measures, to half a centimeter, which shows."""


class PoseSteps(NamedTuple):
    """Quantization steps of poses: meters and radians."""

    translation_m: float
    rotation_rad: float


def pose_steps(scene: SceneSource, config: PoseConfig) -> PoseSteps:
    """Return the steps asked for, or about a third of a pixel: rounding moves what is seen by half of that."""
    rotation = STEP_PIXELS / max(max(rig.color.fx, rig.depth.fx) for rig in scene.info.rigs)
    return PoseSteps(
        config.translation_step_m or min(max(rotation * scene.distance_m, MIN_STEP_M), MAX_STEP_M),
        config.rotation_step_rad or rotation,
    )


@dataclass(kw_only=True, eq=False)
class SentObject:
    """What the decoder has of one object.

    Attributes
    ----------
    number
        Its number; 0 is the background.
    model
        Its model as decoded.
    unquantized
        The model that it would be if colors were not quantized.
    pose_coder
        The coder of its poses.
    last_pose
        The pose last given to the coder; None before the first.
    next_moment
        The moment after that pose; None before the first.
    """

    number: int
    model: DecodedModel
    unquantized: DecodedModel
    pose_coder: PoseCoder
    last_pose: Pose | None = None
    next_moment: int | None = None

    @property
    def run_start(self) -> Pose:
        """First pose, as decoded, of the run that was coded last; the identity before any."""
        poses = self.pose_coder.decoded
        return poses[0] if len(poses) else identity()


class SensorClock(NamedTuple):
    """When a sensor takes its frames, if it never is late.

    Attributes
    ----------
    start_ns
        Time of its first frame.
    period_num, period_den
        Nanoseconds from one frame to the next, as a fraction.
    """

    start_ns: int
    period_num: int
    period_den: int

    @classmethod
    def of(cls, scene: SceneSource, number: int) -> SensorClock:
        """Return the clock of a sensor as far as frames tell; without any of its own it starts with those of others."""
        times = (record.timestamp_ns for record in scene.records if record.sensor == number)
        return cls(next(times, scene.records[0].timestamp_ns), *clock_record(scene.info.each_sensor[number].fps))

    def due_ns(self, number: int) -> int:
        """Return the time of a frame, counted from 0."""
        return self.start_ns + nearest_multiple(number, self.period_num, self.period_den)


class SentState:
    """All that the decoder has been sent.

    Parameters
    ----------
    scene
        The scene, as far as it is known when the head of the stream is sent.
    steps
        Quantization steps of poses, as the head of the stream tells them.

    Attributes
    ----------
    objects
        Objects by number.
    clocks
        Every sensor's clock, as the head of the stream tells it: one whose frames come later keeps it.
    gain_coders, shift_coders
        Coders of every sensor's gains and shifts.
    sensor_order
        The turns of sensors.
    """

    def __init__(self, scene: SceneSource, steps: PoseSteps) -> None:
        sensors = scene.info.each_sensor
        self.steps = steps
        self.clocks = [SensorClock.of(scene, number) for number in range(len(sensors))]
        self.objects: dict[int, SentObject] = {}
        self.gain_coders = [GainCoder(sensor.gray) for sensor in sensors]
        self.shift_coders = [PoseCoder(*steps) for _ in sensors]
        self.sensor_order = SensorSchedule()

    def introduce(self, number: int, model: DecodedModel) -> SentObject:
        """Begin with an object of which nothing has been sent but that its cells are those of a model."""
        sent = SentObject(
            number=number,
            model=model,
            unquantized=DecodedModel(model.voxel_size_m),
            pose_coder=PoseCoder(*self.steps),
        )
        self.objects[number] = sent
        return sent

    @property
    def digest(self) -> bytes:
        """Digest of the decoded models so far."""
        return models_digest({number: sent.model for number, sent in self.objects.items()})
