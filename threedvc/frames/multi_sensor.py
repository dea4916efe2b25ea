# SPDX-License-Identifier: MIT
"""One sequence out of those that several sensors recorded, in order of time.

The sensors are mounted together: where one is known to be, all are. Poses that some recording gives therefore serve the
frames of all, between the times of its own frames by interpolation.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

from threedvc.errors import ConfigError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sequence import FrameSequence, facts_of
from threedvc.geometry.pose import Pose, compose, interpolated, inverse
from threedvc.limits import MAX_SENSORS
from threedvc.units import NANOSECONDS

__all__ = ["MergedSequence"]

TOGETHER_NS = NANOSECONDS // 1000
"""Frames of several sensors are of one moment if their times are not further apart: too little moves meanwhile."""


@dataclass(frozen=True)
class _Place:
    """A frame: its sensor, its number there, its time, and whether it shares the moment of the one before."""

    sensor: int
    number: int
    time_ns: int
    synchronized: bool


class PoseTimeline:
    """Poses of something at some times."""

    def __init__(self) -> None:
        self._times: list[int] = []
        self._poses: list[Pose] = []

    def add(self, time_ns: int, pose: Pose) -> None:
        """Take in the pose at a time, unless it is no later than those before."""
        if not self._times or time_ns > self._times[-1]:
            self._times.append(time_ns)
            self._poses.append(pose)

    def at(self, time_ns: int) -> Pose:
        """Return the pose at a time, the nearest one before the first and after the last."""
        after = bisect_right(self._times, time_ns)
        if not after or after == len(self._times):
            return self._poses[min(after, len(self._poses) - 1)]
        start, end = self._times[after - 1], self._times[after]
        return interpolated(self._poses[after - 1], self._poses[after], (time_ns - start) / (end - start))


class MergedSequence:
    """The frames of several sensors, numbered through in order of time.

    Parameters
    ----------
    sequences
        What each sensor recorded, at least two; each has at least one frame.
    T_first_sensor
        Pose of the depth camera of each sensor after the first, ``p_first = T_first_sensor @ p_sensor``.
    delays_ns
        What to add to the times of each sensor after the first, to bring them to the first one's clock; None: nothing.

    Raises
    ------
    ConfigError
        If the numbers of sequences and poses do not fit.
    """

    def __init__(
        self,
        sequences: Sequence[FrameSequence],
        T_first_sensor: Sequence[Pose],
        delays_ns: Sequence[int] | None = None,
    ) -> None:
        others = len(sequences) - 1
        delays_ns = [0] * others if delays_ns is None else delays_ns
        if not 1 <= others < MAX_SENSORS:
            raise ConfigError(f"{len(sequences)} recordings cannot be merged; give 2 to {MAX_SENSORS}")
        if len(T_first_sensor) != others or len(delays_ns) != others:
            raise ConfigError(
                f"{len(sequences)} sensors need {others} extrinsics and delays, not {len(T_first_sensor)} and "
                f"{len(delays_ns)}; give one for each sensor after the first"
            )
        self._sequences, self._delays = list(sequences), [0, *delays_ns]
        rigs = [sequences[0].info.rig]
        for sequence, T in zip(sequences[1:], T_first_sensor, strict=True):
            rigs.append(replace(sequence.info.rig, T_depth_rig=inverse(T)))
        infos = [sequence.info for sequence in sequences]
        self._facts = [facts_of(sequence) for sequence in sequences]
        times = (
            [one.timestamp_ns + delay for one in facts] for facts, delay in zip(self._facts, self._delays, strict=True)
        )
        self._places = _ordered(list(times))
        self._info = SequenceInfo(
            name=infos[0].name,
            rig=rigs[0],
            depth_scale=infos[0].depth_scale,
            fps=len(self._places) / max(len(sequence) / sequence.info.fps for sequence in sequences),
            frame_count=len(self._places),
            gray=all(info.gray for info in infos),
            has_camera_poses=any(info.has_camera_poses for info in infos),
            has_object_poses=any(info.has_object_poses for info in infos),
            has_masks=any(info.has_masks for info in infos),
            sensors=tuple(replace(info.each_sensor[0], rig=rig) for info, rig in zip(infos, rigs, strict=True)),
        )
        self._camera, self._objects = self._courses()

    @property
    def info(self) -> SequenceInfo:
        """What holds for every frame of every sensor."""
        return self._info

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, index: int) -> Frame:
        position = index + len(self) if index < 0 else index
        if not 0 <= position < len(self):
            raise IndexError(f"frame {index} is not one of {len(self)}")
        place = self._places[position]
        return self._placed(position, self._sequences[place.sensor][place.number])

    def __iter__(self) -> Iterator[Frame]:
        running = [iter(sequence) for sequence in self._sequences]
        for position, place in enumerate(self._places):
            yield self._placed(position, next(running[place.sensor]))

    def _placed(self, position: int, frame: Frame) -> Frame:
        """Return a frame of one sensor as one of all."""
        place = self._places[position]
        rig, delay = self._info.rigs[place.sensor], self._delays[place.sensor]
        T_world_camera, poses = frame.T_world_camera, dict[int, Pose]()
        if self._camera is not None:
            T_world_camera = compose(self._camera.at(place.time_ns), inverse(rig.T_depth_rig))
        for number, timeline in self._objects.items():
            poses[number] = rig.at_sensor(timeline.at(place.time_ns))
        color_time = frame.color_timestamp_ns
        return replace(
            frame,
            index=position,
            timestamp_ns=place.time_ns,
            color_timestamp_ns=None if color_time is None else color_time + delay,
            T_world_camera=T_world_camera,
            T_camera_object=poses,
            sensor=place.sensor,
            synchronized=place.synchronized,
        )

    def _courses(self) -> tuple[PoseTimeline | None, Mapping[int, PoseTimeline]]:
        """Return the poses T_world_base and, by number, T_rig_object; each of the first sensor that gives them."""
        camera: PoseTimeline | None = None
        objects: dict[int, PoseTimeline] = {}
        for sensor, sequence in enumerate(self._sequences):
            info, rig = sequence.info, self._info.rigs[sensor]
            gives = info.has_camera_poses and camera is None
            if not gives and not info.has_object_poses:
                continue
            camera = PoseTimeline() if gives else camera
            own: dict[int, PoseTimeline] = {}
            for one in self._facts[sensor]:
                time = one.timestamp_ns + self._delays[sensor]
                if gives and camera is not None and one.T_world_camera is not None:
                    camera.add(time, compose(one.T_world_camera, rig.T_depth_rig))
                for label, pose in one.T_camera_object.items():
                    own.setdefault(label, PoseTimeline()).add(time, rig.at_rig(pose))
            objects = own | objects
        return camera, objects


def _ordered(times_ns: Sequence[Sequence[int]]) -> list[_Place]:
    """Return the frames of sensors with these times in order of time; each sensor's keep their own order."""
    frames = [
        (time, sensor, number)
        for sensor, own in enumerate(times_ns)
        for number, time in enumerate(accumulate(own, max))
    ]
    places: list[_Place] = []
    frame_set, there = 0, set[int]()
    for time, sensor, number in sorted(frames):
        synchronized = bool(places) and time - frame_set <= TOGETHER_NS and sensor not in there
        if not synchronized:
            frame_set, there = time, set()
        there.add(sensor)
        places.append(_Place(sensor, number, times_ns[sensor][number], synchronized))
    return places
