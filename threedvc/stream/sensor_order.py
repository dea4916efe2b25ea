# SPDX-License-Identifier: MIT
"""Which of several sensors takes each frame: slots that repeat in a cycle until another begins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.limits import MAX_COUNT
from threedvc.stream.wire import ByteReader, pack_varint

__all__ = ["Cycle", "SensorSchedule", "SensorSlot", "pack_cycle", "shortest_cycle", "unpack_cycle"]


class SensorSlot(NamedTuple):
    """One frame's sensor, and whether it was taken at the moment of the frame before, by another sensor."""

    sensor: int
    synchronized: bool


Cycle: TypeAlias = tuple[SensorSlot, ...]
"""The slots of consecutive frames, over and over."""


class SensorSchedule:
    """The slots of a stream; at first all frames are the first sensor's."""

    def __init__(self) -> None:
        self._first = 0
        self._cycle: Cycle = (SensorSlot(0, synchronized=False),)

    def copy(self) -> SensorSchedule:
        """Return the same schedule, to begin other cycles in."""
        result = SensorSchedule()
        result.begin(self._first, self._cycle)
        return result

    def begin(self, frame: int, cycle: Cycle) -> None:
        """Let a cycle begin with a frame."""
        self._first, self._cycle = frame, cycle

    def at(self, frame: int) -> SensorSlot:
        """Return the slot of a frame from the beginning of the cycle on."""
        return self._cycle[(frame - self._first) % len(self._cycle)]


def shortest_cycle(slots: Sequence[SensorSlot]) -> Cycle:
    """Return the shortest cycle whose repetition begins with the given slots, at least one."""
    length = next(n for n in range(1, len(slots) + 1) if all(slots[k] == slots[k - n] for k in range(n, len(slots))))
    return tuple(slots[:length])


def pack_cycle(cycle: Cycle) -> bytes:
    """Return the payload of an ORDER packet."""
    return b"".join(pack_varint(2 * slot.sensor + slot.synchronized) for slot in cycle)


def unpack_cycle(payload: bytes, sensors: int) -> Cycle:
    """Read the payload of an ORDER packet of a stream with some number of sensors.

    Raises
    ------
    CorruptStream
        If it is empty or names a sensor that is not there.
    LimitExceeded
        If it has more than `MAX_COUNT` slots.
    """
    reader, cycle = ByteReader(payload), list[SensorSlot]()
    while reader.remaining:
        sensor, synchronized = divmod(reader.varint(), 2)
        if sensor >= sensors:
            raise CorruptStream(f"an ORDER names sensor {sensor}, but the stream has {sensors}")
        if len(cycle) == MAX_COUNT:
            raise LimitExceeded(f"an ORDER has more than {MAX_COUNT} turns")
        cycle.append(SensorSlot(sensor, bool(synchronized)))
    if not cycle:
        raise CorruptStream("an ORDER has no turns")
    return tuple(cycle)
