# SPDX-License-Identifier: MIT
"""What is found out of a frame by itself, before it is known where the objects in it are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Mask
from threedvc.coding.gains import NEUTRAL
from threedvc.config import EncoderConfig, Sensor
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.exposure import estimate_gain, with_gain
from threedvc.encoder.fusion.integration import Observation, observe
from threedvc.encoder.fusion.noise_meter import NoiseMeter
from threedvc.encoder.registration.frame_resolutions import Downsampled, FrameResolutions
from threedvc.encoder.registration.model_view import predicted_and_measured_depth
from threedvc.frames.depth_limit import limited_depth
from threedvc.frames.frame import Frame, SequenceInfo, check_frame
from threedvc.frames.sensor_model import SENSORS, SensorModel, chosen_sensor
from threedvc.geometry.pose import Pose

__all__ = ["SETTLED_SHARE", "FrameIntake", "FrameRecord", "PreparedFrame"]

SETTLED_SHARE = 0.01
"""Share of a frame's pixels with depth from which on it tells the sensor and the size of cells: cameras begin with
frames of none, or of specks, until their exposure has settled."""
METERED_FRAMES = 12
"""Frames after which a live encoder settles what sensor it has."""


@dataclass(kw_only=True, eq=False)
class FrameRecord:
    """What is kept of a frame that was taken in.

    Attributes
    ----------
    timestamp_ns
        When its depth picture was taken.
    color_offset_ns
        How many nanoseconds later than that its color picture was.
    sensor, synchronized
        The sensor that took it, and whether it did so at the moment of the frame before.
    repeated
        Whether it is a copy of the sensor's one before: it tells nothing new, and is not fused.
    blind
        Whether it has no depth at all.
    gain
        Units (3, 2) of the gain of the color camera that its colors were freed of; neutral unless the encoder is
        causal, for others fit gains later.
    """

    timestamp_ns: int
    color_offset_ns: int
    sensor: int
    synchronized: bool
    repeated: bool
    blind: bool
    gain: NDArray[np.int64]


@dataclass(kw_only=True, eq=False)
class PreparedFrame:
    """A frame to be taken in: its resolutions, the objects' numbers (h, w), and what is fused."""

    views: FrameResolutions
    labels: NDArray[np.uint8]
    seen: Observation


class FrameIntake:
    """Checks frames, cuts their depth, and keeps what they tell of the sensors that took them.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.

    Attributes
    ----------
    records
        One for every frame so far.
    distance_m
        Median depth of the first frame that has enough of it, or any.
    """

    def __init__(self, info: SequenceInfo, config: EncoderConfig) -> None:
        self._info, self._config = info, config
        self.records: list[FrameRecord] = []
        self.distance_m = 0.0
        self._settling = True
        self._last: dict[int, Frame] = {}
        self._noise: dict[int, SensorModel] = {}
        self._meters: dict[int, NoiseMeter] = {}
        self.full = [Downsampled(rig, 1) for rig in info.rigs]
        self._thinned = [Downsampled(rig) for rig in info.rigs]
        self._rays = [rig.depth.rays() for rig in info.rigs]

    @property
    def settled(self) -> bool:
        """Whether a frame so far had enough depth to tell of the scene."""
        return not self._settling

    def take(self, frame: Frame) -> Frame:
        """Check a frame, record it, and return it with its depth cut.

        Raises
        ------
        SequenceError
            If it does not fit the sequence.
        """
        check_frame(frame, self._info)
        frame = self.with_depth_limit(frame)
        much = _shows_much(frame)
        if frame.sensor not in self._noise and much:
            self._noise[frame.sensor] = chosen_sensor(self._config.sensor_of(frame.sensor), frame.depth)
            frame = self.with_depth_limit(frame)
        self._measure_distance(frame, settled=much)
        before = self._last.get(frame.sensor)
        self._last[frame.sensor] = frame
        color_ns = frame.timestamp_ns if frame.color_timestamp_ns is None else frame.color_timestamp_ns
        self.records.append(
            FrameRecord(
                timestamp_ns=frame.timestamp_ns,
                color_offset_ns=color_ns - frame.timestamp_ns,
                sensor=frame.sensor,
                synchronized=frame.synchronized,
                repeated=before is not None and _same_pictures(frame, before),
                blind=not frame.depth.any(),
                gain=NEUTRAL,
            )
        )
        last = self.frame_before(len(self.records) - 1)
        if last is not None:
            self.records[-1].gain = self.records[last].gain
        return frame

    def prepared(self, frame: Frame, labels: NDArray[np.uint8]) -> PreparedFrame:
        """Return a frame that was taken, with its labels, ready to be located and fused."""
        seen = observe(frame, self._info.rigs[frame.sensor], self._rays[frame.sensor])
        return PreparedFrame(views=self.views(frame), labels=labels, seen=seen)

    def with_depth_limit(self, frame: Frame) -> Frame:
        """Return a frame with the depth that is used of it."""
        depth = limited_depth(frame.depth, self._config.max_depth_m, self._noise.get(frame.sensor))
        return replace(frame, depth=depth)

    def views(self, frame: Frame) -> FrameResolutions:
        """Return the resolutions of a frame for registration."""
        return FrameResolutions(frame, self.full[frame.sensor], self._thinned[frame.sensor])

    def sensor_of(self, number: int) -> SensorModel:
        """Return the noise of a sensor's depth: the one asked for, or guessed from its first frame."""
        return self._noise.get(number) or SENSORS[Sensor.KINECT1]

    def frame_before(self, frame: int) -> int | None:
        """Return the frame before one of the frames so far that the same sensor took; None for its first."""
        sensor = self.records[frame].sensor
        return next((k for k in range(frame - 1, -1, -1) if self.records[k].sensor == sensor), None)

    def meter_noise(self, frame: PreparedFrame, background: EvidenceModel, mask: Mask, T_camera_object: Pose) -> None:
        """Find out in its first frames if a sensor scatters more than the very first of them made believe."""
        number = frame.views.frame.sensor
        meter = self._meters.setdefault(number, NoiseMeter())
        named = self._config.sensor_of(number) is not Sensor.AUTO
        if named or meter.frames == METERED_FRAMES or not background.index.count:
            return
        pictures = predicted_and_measured_depth(background, frame.views, mask, T_camera_object, self._config.threads)
        meter.add(*pictures, background.voxel_size_m)
        better = meter.likelier_sensor(self._noise[number]) if meter.frames == METERED_FRAMES else None
        if better is not None:
            self._noise[number] = SENSORS[better]

    def take_out_gain(self, frame: PreparedFrame, background: EvidenceModel, mask: Mask, T_camera_object: Pose) -> None:
        """Find the gain of a frame's color camera against the background, record it, and free the frame of it."""
        record = self.records[frame.seen.frame]
        record.gain = estimate_gain(frame.seen, mask, T_camera_object, background, record.gain, self._info.gray)
        frame.seen = with_gain(frame.seen, record.gain)

    def _measure_distance(self, frame: Frame, *, settled: bool) -> None:
        if frame.depth.any() and (not self.distance_m or (self._settling and settled)):
            self.distance_m = float(np.median(frame.depth[frame.depth > 0]))
        self._settling = self._settling and not settled


def _shows_much(frame: Frame) -> bool:
    """Tell whether a frame has depth on enough of its pixels to tell what sensor and scene there are."""
    return bool(np.count_nonzero(frame.depth) >= SETTLED_SHARE * frame.depth.size)


def _same_pictures(one: Frame, other: Frame) -> bool:
    """Tell whether two frames show the same, pixel by pixel."""
    if (one.mask is None) != (other.mask is None):
        return False
    if one.mask is not None and other.mask is not None and not np.array_equal(one.mask, other.mask):
        return False
    return np.array_equal(one.color, other.color) and np.array_equal(one.depth, other.depth)
