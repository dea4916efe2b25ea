# SPDX-License-Identifier: MIT
"""What is told of a stream: statistics of frames, objects and sensors."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from threedvc.formats.evaluation.byte_counts import PacketTotal
from threedvc.formats.evaluation.frame_ranges import FrameSpan, ranges_of
from threedvc.formats.evaluation.object_comparison import ObjectQuality, SpuriousObject
from threedvc.geometry.pose import Pose, quaternion
from threedvc.metrics.paper_accounting import PaperAccounting
from threedvc.metrics.trajectory import TrajectoryError, Travel
from threedvc.stream.pose_status import PoseStatus

__all__ = ["BACKGROUND", "FrameStatistics", "ObjectStatistics", "SensorStatistics", "StreamStatistics"]

NAMED = (PoseStatus.RELOCALIZED, PoseStatus.WEAK, PoseStatus.LOST)
"""Statuses whose frames are named one by one."""

BACKGROUND = 0
"""Its number in every stream."""


@dataclass(frozen=True, kw_only=True)
class ObjectStatistics:
    """One object of the stream.

    Attributes
    ----------
    id
        Its number; 0 is the background.
    cells, voxel_size_m, bytes
        Cells at the end, their edge, and what packets of the object alone take.
    poses
        Number of frames that carry a pose for it.
    guessed
        Whether it only fills holes of the background, in color.
    passing
        Whether it stands for things that are there for a moment, such as hands.
    spans
        Frames in which it is visible, see `threedvc.formats.evaluation.visibility`.
    birth, death
        First and last of these; None if there are none, and `death` also if it is visible in the last frame.
    travel
        How far the middle of its cells went in the world from its birth on; None for the background and for what is
        never visible.
    """

    id: int
    cells: int
    voxel_size_m: float
    bytes: int
    poses: int
    guessed: bool = False
    passing: bool = False
    spans: tuple[FrameSpan, ...] = ()
    birth: int | None = None
    death: int | None = None
    travel: Travel | None = None

    @property
    def background(self) -> bool:
        """Whether it is the background, whose frame is the world."""
        return self.id == BACKGROUND

    @property
    def visible_frames(self) -> int:
        """Number of frames in which it is visible."""
        return sum(span.last - span.first + 1 for span in self.spans)

    def to_map(self) -> dict[str, Any]:
        """Return the report as plain values."""
        return asdict(self) | {"background": self.background, "visible_frames": self.visible_frames}


@dataclass(frozen=True, kw_only=True)
class SensorStatistics:
    """One sensor of the stream.

    Attributes
    ----------
    number, name
        Which one, and the name of what it recorded.
    frames, duration_s
        Number of its frames, and that divided by its frame rate.
    raw_bytes
        Size of its frames as 8-bit color (with its channels) and 16-bit depth.
    """

    number: int
    name: str
    frames: int
    duration_s: float
    raw_bytes: int


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameStatistics:
    """One frame: its share of the stream, what it shows, and its quality where there is a reference.

    Attributes
    ----------
    frame, timestamp_ns
        Number and time.
    sensor
        The sensor that took it.
    bytes
        Bytes sent for the frame; packets of several frames are divided evenly.
    T_world_camera
        Pose of the depth camera.
    visible_objects
        Number of objects that it shows, without the background and what is guessed.
    entropy_bits, status
        Entropy of the encoder's models after the frame, and how its pose was found; None where the
        stream does not say.
    quality
        Measures of this frame alone, empty without a reference.
    """

    frame: int
    timestamp_ns: int
    bytes: int
    T_world_camera: Pose
    visible_objects: int
    entropy_bits: float | None = None
    status: PoseStatus | None = None
    sensor: int = 0
    quality: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class StreamStatistics:
    """The report of `statistics`.

    Attributes
    ----------
    name
        Name of the encoded sequence.
    complete
        False when the stream ends too early; everything else then describes the part that is there.
    file_bytes, duration_s
        Size of the file, and frames divided by the frame rate; of several sensors that of the longest.
    raw_bytes
        Size of the frames as 8-bit color (with its channels) and 16-bit depth.
    packets
        Totals by type of packet.
    objects
        In order of number.
    per_frame
        In order of time.
    paper
        Equations (8) to (10); M and F_m sum over the objects that move, which the background does when
        the camera does.
    travel
        How far the camera went; None without frames.
    camera, object_motion
        Error of the camera's trajectory, and of the camera's trajectory in the frame of each object. All frames
        count whose true pose is known, those also in which the encoder had lost an object.
    reference_objects, spurious_objects
        How well the objects of the reference were found, and objects that are none of these, see
        `threedvc.formats.evaluation.object_comparison`; None where the reference has nothing to tell by.
    quality
        Measures over all frames; None without a reference.
    lossless
        Which of ``color`` and ``depth`` equal the reference in every pixel of every frame.
    sensors
        All sensors, usually one.
    """

    name: str
    complete: bool
    file_bytes: int
    duration_s: float
    raw_bytes: int
    packets: Mapping[str, PacketTotal]
    objects: Sequence[ObjectStatistics]
    per_frame: Sequence[FrameStatistics]
    paper: PaperAccounting
    travel: Travel | None = None
    camera: TrajectoryError | None = None
    object_motion: Mapping[int, TrajectoryError] = field(default_factory=dict)
    reference_objects: Sequence[ObjectQuality] | None = None
    spurious_objects: Sequence[SpuriousObject] | None = None
    quality: Mapping[str, float] | None = None
    lossless: Sequence[str] = ()
    sensors: Sequence[SensorStatistics] = ()

    @property
    def frames(self) -> int:
        """Number of frames that can be decoded."""
        return len(self.per_frame)

    @property
    def kbit_s(self) -> float:
        """Bits of the whole file per second of video, in thousands."""
        return self.file_bytes * 8 / self.duration_s / 1000 if self.duration_s else math.nan

    @property
    def ratio(self) -> float:
        """N of the compression 1:N against the raw frames."""
        return self.raw_bytes / self.file_bytes

    @property
    def status(self) -> dict[str, int]:
        """Number of frames by the status of their pose."""
        return dict(Counter(item.status.value for item in self.per_frame if item.status is not None))

    @property
    def status_spans(self) -> dict[str, tuple[FrameSpan, ...]]:
        """Frames whose pose was weak, lost, or found again after it was lost, by status; only those that occur."""
        spans = {
            status.value: ranges_of(item.frame for item in self.per_frame if item.status is status) for status in NAMED
        }
        return {name: frames for name, frames in spans.items() if frames}

    @property
    def object_count(self) -> int:
        """Number of objects, without the background, what is guessed and what only passes."""
        return sum(not (item.background or item.guessed or item.passing) for item in self.objects)

    def to_map(self) -> dict[str, Any]:
        """Return the report as plain values; a number that is not finite becomes None."""
        report: dict[str, Any] = {
            "name": self.name,
            "complete": self.complete,
            "file_bytes": self.file_bytes,
            "frames": self.frames,
            "duration_s": self.duration_s,
            "kbit_s": self.kbit_s,
            "raw_bytes": self.raw_bytes,
            "ratio": self.ratio,
            "packets": {name: asdict(total) for name, total in self.packets.items()},
            "sensors": [asdict(sensor) for sensor in self.sensors],
            "object_count": self.object_count,
            "objects": [item.to_map() for item in self.objects],
            "bytes_per_frame": [item.bytes for item in self.per_frame],
            "entropy_bits": [item.entropy_bits for item in self.per_frame if item.entropy_bits is not None],
            "trajectory": self._trajectory_map(),
            "paper": {
                "M": self.paper.cells,
                "F_m": self.paper.pose_frames,
                "S_3dvc": self.paper.coded_bytes,
                "S_raw": self.paper.raw_bytes,
                "ratio": self.paper.ratio,
            },
        }
        for name in ("reference_objects", "spurious_objects"):
            if (items := getattr(self, name)) is not None:
                report[name] = [asdict(item) for item in items]
        if self.quality is not None:
            report["quality"] = dict(self.quality)
            report["lossless"] = list(self.lossless)
        return {name: _finite(value) for name, value in report.items()}

    def to_json(self) -> str:
        """Return the report as JSON text."""
        return json.dumps(self.to_map(), indent=1)

    def _trajectory_map(self) -> dict[str, Any]:
        report: dict[str, Any] = {
            "status": self.status,
            "spans": self.status_spans,
            "lost_frames": self.status.get(PoseStatus.LOST, 0) if self.status else None,
            "travel": None if self.travel is None else asdict(self.travel),
            "poses": [_position_and_turn(item.T_world_camera) for item in self.per_frame],
        }
        if self.camera is not None:
            report |= asdict(self.camera)
        if self.object_motion:
            report["objects"] = {str(number): asdict(error) for number, error in self.object_motion.items()}
        return report


def _position_and_turn(pose: Pose) -> list[float]:
    """Return tx, ty, tz in meters and qx, qy, qz, qw."""
    return [float(value) for value in (*pose[:3, 3], *quaternion(pose[:3, :3]))]


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
