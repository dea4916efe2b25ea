# SPDX-License-Identifier: MIT
"""Small streams and sequences made of nothing, for tests that need no encoder."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.color import ColorSettings
from threedvc.coding.gains import apply_gain
from threedvc.coding.poses import PoseCoder
from threedvc.coding.update import encode_update_with_result
from threedvc.decoder.replay import replay
from threedvc.formats.container import StreamReader, StreamWriter
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, make_pose
from threedvc.model.decoded_model import DecodedModel, models_digest
from threedvc.model.model_update import ModelUpdate
from threedvc.stream.batch import pack_batch
from threedvc.stream.headers import BatchHeader, EndHeader, ModelHeader, ObjectHeader, PoseHeader, StreamHeader
from threedvc.stream.notes.frame_report import FrameReport, report_packet
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.pose_status import PoseStatus

__all__ = [
    "FRAMES",
    "INFO",
    "FakeStream",
    "ListSequence",
    "drawn",
    "gradient_frame",
    "packed_stream",
    "roaming_stream",
    "toy_pose",
]

FRAMES = 4
CAMERA = Camera(width=16, height=12, fx=15.0, fy=15.0, cx=7.5, cy=5.5)
INFO = SequenceInfo(
    name="gradient", rig=CameraRig.registered_to(CAMERA), depth_scale=1000.0, fps=20.0, frame_count=FRAMES
)
PERIOD_NS = 50_000_000
STEP = 0.001
REPORTS = [
    FrameReport(index=index, timestamp_ns=index * PERIOD_NS, status=PoseStatus(status), entropy_bits=bits)
    for index, (status, bits) in enumerate([("known", 400.0), ("tracked", 300.0), ("tracked", 250.0), ("lost", 200.0)])
]


def row_of_cells(count: int) -> NDArray[np.int32]:
    """Return cells (n, 3) side by side."""
    cells = np.zeros((count, 3), dtype=np.int32)
    cells[:, 0] = np.arange(count)
    return cells


def packed_stream(*, ended: bool = True, gray: bool = False, drifted: bool = False, reported: bool = True) -> bytes:
    """Return a stream of two batches of two frames: object 0 (300 cells) stands, object 1 (125 cells) moves."""
    sink = io.BytesIO()
    writer = StreamWriter(sink)
    camera = (CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, 0, 0, 0, 0, 0)
    stream = StreamHeader(
        color_camera=camera,
        depth_scale=1000.0,
        period_num=PERIOD_NS,
        translation_step_m=STEP,
        rotation_step_rad=STEP,
        name=INFO.name,
        gray=gray,
    )
    writer.write(stream.packet())
    coder = PoseCoder(STEP, STEP)
    models = {0: DecodedModel(0.02), 1: DecodedModel(0.01)}
    first = [
        ObjectHeader(object_id=0, voxel_size_m=0.02).packet(),
        ObjectHeader(object_id=1, voxel_size_m=0.01).packet(),
        ModelHeader(object_id=0, frame=0).packet(_applied(models[0], row_of_cells(300))),
        ModelHeader(object_id=1, frame=1).packet(_applied(models[1], row_of_cells(125))),
        PoseHeader(object_id=1, frame=0, count=2).packet(coder.encode([toy_pose(0), toy_pose(1)])),
    ]
    writer.write(pack_batch(BatchHeader(frame=0, count=2), first))
    second = [PoseHeader(object_id=1, frame=2, count=2).packet(coder.encode([toy_pose(2), toy_pose(3)]))]
    writer.write(pack_batch(BatchHeader(frame=2, count=2), second))
    if ended:
        if reported:
            writer.write(report_packet(REPORTS))
        digest = bytes(16) if drifted else models_digest(models)
        writer.write(EndHeader(frames=FRAMES, digest=digest).packet())
    return sink.getvalue()


def roaming_stream(places_m: Sequence[float], *, ended: bool = True) -> bytes:
    """Return a stream of a wall 2 m ahead and of a cube of 0.3 m, 1 m ahead, that is this far right in each frame.

    The camera sees half a meter to each side there.
    """
    sink = io.BytesIO()
    writer = StreamWriter(sink)
    camera = (CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, 0, 0, 0, 0, 0)
    stream = StreamHeader(
        color_camera=camera, depth_scale=1000.0, period_num=PERIOD_NS, translation_step_m=STEP, rotation_step_rad=STEP
    )
    writer.write(stream.packet())
    models = {0: DecodedModel(0.1), 1: DecodedModel(0.05)}
    wall = np.array([(x, y, 20) for x in range(-15, 15) for y in range(-15, 15)], dtype=np.int32)
    cube = np.array([(x, y, z) for x in range(-3, 3) for y in range(-3, 3) for z in range(-3, 3)], dtype=np.int32)
    poses = [make_pose(np.eye(3), np.array([x, 0, 1])) for x in places_m]
    members = [
        ObjectHeader(object_id=0, voxel_size_m=0.1).packet(),
        ObjectHeader(object_id=1, voxel_size_m=0.05).packet(),
        ModelHeader(object_id=0, frame=0).packet(_applied(models[0], wall)),
        ModelHeader(object_id=1, frame=0).packet(_applied(models[1], cube)),
        PoseHeader(object_id=1, frame=0, count=len(poses)).packet(PoseCoder(STEP, STEP).encode(poses)),
    ]
    writer.write(pack_batch(BatchHeader(frame=0, count=len(poses)), members))
    if ended:
        writer.write(EndHeader(frames=len(poses), digest=models_digest(models)).packet())
    return sink.getvalue()


def _applied(model: DecodedModel, added: NDArray[np.int32]) -> bytes:
    cells, colors = model.cells()
    update = ModelUpdate.adding(added, np.full((len(added), 3), 90, dtype=np.int16))
    payload, decoded = encode_update_with_result(update, cells, colors, ColorSettings())
    model.apply(decoded)
    return payload


def toy_pose(index: int) -> Pose:
    """Return T_camera_object of object 1."""
    pose = np.eye(4)
    pose[2, 3] = 1 + 0.05 * index
    return pose


def gradient_frame(index: int, *, brighter: int = 0, farther_mm: int = 0) -> Frame:
    """Return a frame with a slanted floor, known poses of the camera and of object 1."""
    rows, columns = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    color = np.stack([rows * 5, columns * 5, rows + columns], axis=-1) + 10 * index + brighter
    depth = (rows * 50 + 1000 + farther_mm) / 1000
    camera = np.eye(4)
    camera[0, 3] = 0.1 * index
    return Frame(
        index=index,
        timestamp_ns=index * PERIOD_NS,
        color=color.astype(np.uint8),
        depth=depth.astype(np.float32),
        T_world_camera=camera,
        T_camera_object={1: toy_pose(index)},
    )


@dataclass
class ListSequence:
    """A sequence of frames in memory."""

    frames: list[Frame] = field(default_factory=lambda: [gradient_frame(index) for index in range(FRAMES)])
    info: SequenceInfo = INFO

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Frame:
        return self.frames[index]

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.frames)


@dataclass(frozen=True)
class FakeDecodedFrame:
    """Stands for a decoded frame."""

    index: int
    number: int
    timestamp_ns: int
    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    labels: NDArray[np.uint8]
    T_world_camera: Pose
    T_camera_object: Mapping[int, Pose]
    sensor: int = 0
    color_timestamp_ns: int | None = None
    saturated: NDArray[np.bool_] | None = None


class FakeStream:
    """Stands for an opened stream: reads the real packets and draws gradients, as object 1, instead of models."""

    changes: Mapping[str, int] = {}

    def __init__(self, source: Any, **choices: Any) -> None:
        self.choices = choices
        self.infos, self.unread_codecs = (INFO,), {}
        data = source if hasattr(source, "read") else io.BytesIO(Path(source).read_bytes())
        self._reader = StreamReader(data, str(source))

    @property
    def info(self) -> SequenceInfo:
        return self.infos[0]

    def close(self) -> None:
        """Do what closing a stream does that is read to its end."""

    def __iter__(self) -> Iterator[FakeDecodedFrame]:
        for packet in self._reader:
            if packet.type == PacketType.BATCH:
                header = BatchHeader.from_map(packet.header)
                yield from (self._drawn(index) for index in range(header.frame, header.frame + header.count))

    def _drawn(self, index: int) -> FakeDecodedFrame:
        frame = gradient_frame(index, **self.changes)
        assert frame.T_world_camera is not None
        return FakeDecodedFrame(
            index=index,
            number=index,
            timestamp_ns=frame.timestamp_ns,
            color=frame.color,
            depth=frame.depth,
            labels=np.ones(frame.depth.shape, dtype=np.uint8),
            T_world_camera=frame.T_world_camera,
            T_camera_object=frame.T_camera_object,
        )


def drawn(packets: Sequence[Packet]) -> list[NDArray[np.uint8]]:
    """Decode and draw color pictures as `threedvc.decode` does."""
    pictures = []
    for state, renderer, models in replay(packets, 2):
        picture = renderer.draw(
            models, state.T_camera_object, gain=apply_gain(state.gain), T_shifted_camera=state.T_shifted_camera,
            backdrop=state.backdrop, lights=state.lights, filters=state.filters,
        )  # fmt: skip
        pictures.append(picture.color)
    return pictures
