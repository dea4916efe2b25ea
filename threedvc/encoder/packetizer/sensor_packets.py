# SPDX-License-Identifier: MIT
"""Packets about sensors: whose turn it is, when frames were taken, and the gains of color cameras."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.packetizer.scene_source import BatchFrames, SceneSource, frames_by_sensor
from threedvc.encoder.packetizer.sent_state import SentState
from threedvc.stream.headers import ClockHeader, GainHeader, OrderHeader
from threedvc.stream.notes.color_times import color_times_packet
from threedvc.stream.packets import Packet
from threedvc.stream.sensor_order import SensorSlot, pack_cycle, shortest_cycle
from threedvc.stream.wire import pack_signed_varint

__all__ = ["clock_packets", "color_time_packets", "gain_packets", "order_packets"]


def order_packets(sent: SentState, scene: SceneSource, batch: BatchFrames) -> Iterator[Packet]:
    """Yield the turns of sensors in a batch, unless they go on as before."""
    turns = [SensorSlot(record.sensor, record.synchronized) for record in scene.records[batch.first : batch.stop]]
    if any(sent.sensor_order.at(frame) != turn for frame, turn in enumerate(turns, batch.first)):
        cycle = shortest_cycle(turns)
        sent.sensor_order.begin(batch.first, cycle)
        yield OrderHeader(frame=batch.first).packet(pack_cycle(cycle))


def clock_packets(sent: SentState, scene: SceneSource, batch: BatchFrames) -> Iterator[Packet]:
    """Yield, for each sensor, how far its frames of a batch are off its clock, unless none is."""
    for sensor, frames in frames_by_sensor(scene, batch):
        taken = sum(record.sensor == sensor for record in scene.records[: batch.first])
        clock = sent.clocks[sensor]
        residuals = [
            scene.records[frame].timestamp_ns - clock.due_ns(number) for number, frame in enumerate(frames, taken)
        ]
        if any(residuals):
            payload = b"".join(map(pack_signed_varint, residuals))
            yield ClockHeader(frame=frames[0], count=len(frames), sensor=sensor).packet(payload)


def color_time_packets(scene: SceneSource, batch: BatchFrames) -> Iterator[Packet]:
    """Yield when the color pictures of a batch were taken, unless each was taken with its depth picture."""
    offsets = [record.color_offset_ns for record in scene.records[batch.first : batch.stop]]
    if any(offsets):
        yield color_times_packet(batch.first, offsets)


def gain_packets(
    sent: SentState, scene: SceneSource, all_gains: NDArray[np.int64], batch: BatchFrames
) -> Iterator[Packet]:
    """Yield the gains from the first frame of a batch in which they change to the last.

    Parameters
    ----------
    sent
        What the decoder has.
    scene
        Tells which sensor took a frame.
    all_gains
        (frames, 3, 2) units of the color camera's gains in all frames so far.
    batch
        The frames.
    """
    for sensor, frames in frames_by_sensor(scene, batch):
        gains, coder = all_gains[frames], sent.gain_coders[sensor]
        before = np.concatenate([coder.last[None], gains[:-1]])
        changes = np.flatnonzero((gains != before).any(axis=(1, 2)))
        if len(changes):
            start, end = int(changes[0]), int(changes[-1]) + 1
            payload = coder.encode(gains[start:end])
            yield GainHeader(frame=frames[start], count=end - start, sensor=sensor).packet(payload)
