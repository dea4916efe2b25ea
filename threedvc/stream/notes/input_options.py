# SPDX-License-Identifier: MIT
"""How a recording was read where its user said so, in META packets, so that it can be read in the same way again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, TypeAlias

from threedvc.limits import MAX_SENSORS
from threedvc.stream.packets import Packet, PacketType

__all__ = ["NOTE", "InputNotes", "InputOptions", "input_options_packet", "unpack_input_options"]

InputOptions: TypeAlias = Mapping[str, str | float]
"""Options of the reader by name: ``layout``, ``color``, ``depth``, ``poses`` (texts), ``depth_scale`` (per meter)."""

SENSOR = "s"
TEXTS = ("layout", "color", "depth", "poses")
NUMBERS = ("depth_scale",)
MAX_TEXT = 255
"""Characters of an option that is a text: as long as names may be in STREAM and SENSOR."""


def input_options_packet(sensor: int, options: InputOptions) -> Packet:
    """Pack the options that the recording of a sensor was read with."""
    header = {"k": InputNotes.kind, **({SENSOR: sensor} if sensor else {}), **options}
    return Packet(type=PacketType.META, header=header, payload=b"", critical=False)


def unpack_input_options(packet: Packet) -> tuple[int, InputOptions] | None:
    """Return the sensor and the options of a packet made by `input_options_packet`; None if no sensor has its number.

    What is no such option is passed over: a stream may be newer, or damaged on purpose.
    """
    sensor = packet.header.get(SENSOR, 0)
    if not isinstance(sensor, int) or not 0 <= sensor < MAX_SENSORS:
        return None
    options: dict[str, str | float] = {}
    for name, value in packet.header.items():
        if name in TEXTS and isinstance(value, str) and len(value) <= MAX_TEXT:
            options[name] = value
        elif name in NUMBERS and isinstance(value, int | float) and math.isfinite(value) and value > 0:
            options[name] = float(value)
    return sensor, options


class InputNotes:
    """The options that a stream's recordings were read with.

    Attributes
    ----------
    by_sensor
        Options by number of the sensor.
    """

    kind: ClassVar[str] = "input"

    def __init__(self) -> None:
        self.by_sensor: dict[int, InputOptions] = {}

    def add(self, packet: Packet) -> None:
        """Note the options of a packet."""
        if (options := unpack_input_options(packet)) is not None:
            self.by_sensor[options[0]] = options[1]


NOTE = InputNotes
