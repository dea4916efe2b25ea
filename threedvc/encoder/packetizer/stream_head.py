# SPDX-License-Identifier: MIT
"""The head of a stream: its sensors, their cameras and clocks, and how the recordings were read."""

from __future__ import annotations

from typing import TypedDict

from threedvc.encoder.packetizer.sent_state import SensorClock, SentState
from threedvc.frames.frame import SensorInfo, SequenceInfo
from threedvc.stream.headers import SensorHeader, StreamHeader
from threedvc.stream.notes.input_options import input_options_packet
from threedvc.stream.packets import Packet
from threedvc.stream.sensor_description import camera_record, transform_record

__all__ = ["stream_head"]


class _SensorFields(TypedDict):
    """What STREAM and SENSOR tell of a sensor."""

    color_camera: tuple[float, ...]
    depth_camera: tuple[float, ...]
    T_color_depth: tuple[float, ...]
    depth_scale: float
    start_ns: int
    period_num: int
    period_den: int
    gray: bool
    name: str


def stream_head(info: SequenceInfo, sent: SentState) -> list[Packet]:
    """Return the STREAM packet, SENSOR packets of further sensors, and how the recordings were read if told."""
    count = len(info.each_sensor)
    stream = StreamHeader(
        **_sensor_fields(info.each_sensor[0], sent.clocks[0]),
        translation_step_m=sent.steps.translation_m,
        rotation_step_rad=sent.steps.rotation_rad,
        given_world=info.has_camera_poses,
        sensors=count,
    )
    sensors = [_sensor_header(info, sent, number).packet() for number in range(1, count)]
    options = [
        input_options_packet(number, sensor.read_as) for number, sensor in enumerate(info.each_sensor) if sensor.read_as
    ]
    return [stream.packet(), *sensors, *options]


def _sensor_header(info: SequenceInfo, sent: SentState, number: int) -> SensorHeader:
    T_depth_rig = transform_record(info.rigs[number].T_depth_rig)
    return SensorHeader(**_sensor_fields(info.each_sensor[number], sent.clocks[number]), T_depth_rig=T_depth_rig)


def _sensor_fields(sensor: SensorInfo, clock: SensorClock) -> _SensorFields:
    rig = sensor.rig
    return {
        "color_camera": camera_record(rig.color),
        "depth_camera": () if rig.depth == rig.color else camera_record(rig.depth),
        "T_color_depth": transform_record(rig.T_color_depth),
        "depth_scale": sensor.depth_scale,
        "start_ns": clock.start_ns,
        "period_num": clock.period_num,
        "period_den": clock.period_den,
        "gray": sensor.gray,
        "name": sensor.name,
    }
