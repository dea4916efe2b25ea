# SPDX-License-Identifier: MIT
"""RESIDUAL packets: the measured depth of all frames, within a bound."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.measured_depth.bounded_depth import encode_depth_frames
from threedvc.coding.measured_depth.depth_bound import BoundKind, DepthBound, distinct_depths
from threedvc.coding.measured_depth.saturated import pack_saturated
from threedvc.config import DepthErrorConfig, DepthErrorKind
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import Pose, inverse
from threedvc.limits import MAX_SEQUENCE_SAMPLES
from threedvc.render.moved_depth import MovedDepth
from threedvc.stream.captured_headers import ResidualHeader
from threedvc.stream.packets import Packet

__all__ = ["residual_packets"]

MAX_RUN_FRAMES = 60
"""Frames of a packet: as many as a batch of two seconds has. What its first one costs more is 2 % of that."""
KINDS = {
    DepthErrorKind.ABSOLUTE: (0, BoundKind.ABSOLUTE),
    DepthErrorKind.RELATIVE: (1, BoundKind.RELATIVE),
    DepthErrorKind.LEVEL: (2, BoundKind.LEVEL),
    DepthErrorKind.LOSSLESS: (3, BoundKind.LOSSLESS),
}
"""The number in the header of each kind, and its name for the coder."""


def residual_packets(packets: Sequence[Packet], scene: Scene, frames: FrameSequence, batch_frames: int) -> list[Packet]:
    """Return the packets of all frames, in their order for each sensor; none if the models' depth is what is wanted.

    Parameters
    ----------
    packets
        A stream of the scene: its poses predict the depth.
    scene
        The finished scene, of which sensors and choices count.
    frames
        Its frames.
    batch_frames
        Frames of a BATCH; no packet crosses its end.

    Raises
    ------
    ConfigError
        If a frame is too large.
    """
    wanted = scene.config.depth_error
    if wanted.kind is DepthErrorKind.MODEL:
        return []
    states = list(Decoder(captured_depth=False, captured_color=False).frames(packets))
    poses = [inverse(state.T_world_camera) for state in states]
    made: list[Packet] = []
    for sensor in range(len(scene.info.rigs)):
        own = _SensorDepth(scene, frames, sensor)
        for numbers in own.runs(batch_frames):
            made.append(own.packet(numbers, [poses[number] for number in numbers]))
    return made


class _SensorDepth:
    """What one sensor measured."""

    def __init__(self, scene: Scene, frames: FrameSequence, sensor: int) -> None:
        self._frames, self._sensor = frames, sensor
        self._threads, self._camera = scene.config.threads, scene.info.rigs[sensor].depth
        self._scale = scene.info.each_sensor[sensor].depth_scale
        self._wanted = scene.config.depth_error
        self._numbers = [number for number, record in enumerate(scene.records) if record.sensor == sensor]
        self._levels: NDArray[np.int64] | None = None
        if self._wanted.kind is DepthErrorKind.LEVEL:
            self._levels = distinct_depths(map(self._raw, self._numbers))

    def runs(self, batch_frames: int) -> Iterator[list[int]]:
        """Yield the numbers of the frames of each packet."""
        most = max(1, min(MAX_RUN_FRAMES, MAX_SEQUENCE_SAMPLES // (self._camera.width * self._camera.height)))
        batches: dict[int, list[int]] = {}
        for number in self._numbers:
            batches.setdefault(number // batch_frames, []).append(number)
        for batch in batches.values():
            rest = iter(batch)
            while run := list(islice(rest, most)):
                yield run

    def packet(self, numbers: Sequence[int], T_camera_scene: Sequence[Pose]) -> Packet:
        """Return the packet of some frames, with the poses of the scene before the camera as decoded."""
        raw, marks = zip(*map(self._measured, numbers), strict=True)
        exact = self._wanted.kind is DepthErrorKind.LOSSLESS
        saturated = pack_saturated(raw, marks) if exact else b""
        predict = MovedDepth(self._camera, T_camera_scene, self._scale, self._threads)
        payload = encode_depth_frames(raw, _bound(self._wanted, self._scale), predict, self._threads, self._levels)
        header = ResidualHeader(
            frame=numbers[0],
            count=len(numbers),
            sensor=self._sensor,
            kind=KINDS[self._wanted.kind][0],
            bound=self._wanted.size,
            saturated=len(saturated) > 0,
        )
        return header.packet(saturated + payload, critical=False)

    def _raw(self, number: int) -> NDArray[np.uint16]:
        return self._measured(number)[0]

    def _measured(self, number: int) -> tuple[NDArray[np.uint16], NDArray[np.bool_] | None]:
        """Return the depth of a frame in the units of its pictures, and where it is saturated."""
        frame = self._frames[number]
        return np.rint(frame.depth.astype(np.float64) * self._scale).astype(np.uint16), frame.saturated


def _bound(wanted: DepthErrorConfig, depth_scale: float) -> DepthBound:
    kind = KINDS[wanted.kind][1]
    return DepthBound(kind=kind, size=wanted.size * depth_scale if kind is BoundKind.ABSOLUTE else wanted.size)
