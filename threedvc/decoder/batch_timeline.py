# SPDX-License-Identifier: MIT
"""The frames of one BATCH: which sensor takes each, and which of them the runs of packets speak of."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from threedvc.decoder.decoder_state import DecoderState
from threedvc.errors import CorruptStream
from threedvc.stream.batch import Member
from threedvc.stream.headers import BatchHeader, OrderHeader, RunHeader, SensorRunHeader
from threedvc.stream.sensor_order import Cycle, SensorSlot, unpack_cycle

__all__ = ["BatchTimeline", "FrameRun", "RunFrames", "lay_out"]


class FrameRun:
    """Frames of one BATCH that runs count: those of one sensor, or the first ones of all moments.

    Parameters
    ----------
    before
        How many such frames there were before the BATCH.
    frames
        Those in it.
    """

    def __init__(self, before: int, frames: Sequence[int]) -> None:
        self._before, self._frames = before, frames

    def of(self, header: RunHeader) -> tuple[int, Sequence[int]] | None:
        """Return the number of the first frame of a header, and all its frames; None if they are not there."""
        place = bisect_left(self._frames, header.frame)
        frames = self._frames[place : place + header.count]
        if len(frames) < header.count or frames[0] != header.frame:
            return None
        return self._before + place, frames


class RunFrames(NamedTuple):
    """The frames that a packet speaks of, and whether they follow those of the last packet of its kind directly."""

    frames: Sequence[int]
    follows: bool


class BatchTimeline:
    """The frames of one BATCH.

    Parameters
    ----------
    span
        All of them.
    cycles
        The cycles of sensors that ORDER packets begin, by frame.
    sensor_runs
        Frames of each sensor.
    frame_set_run
        First frames of all moments.
    run_ends
        See `DecoderState`; changed.
    """

    def __init__(
        self,
        span: range,
        cycles: Mapping[int, Cycle],
        sensor_runs: Sequence[FrameRun],
        frame_set_run: FrameRun,
        run_ends: dict[str, int],
    ) -> None:
        self.span, self.cycles = span, cycles
        self._sensor_runs, self._frame_set_run = sensor_runs, frame_set_run
        self._run_ends = run_ends

    def check(self, frame: int) -> None:
        """Raise CorruptStream unless a frame is one of the BATCH."""
        _check_frame(self.span, frame)

    def convey(self, name: str, header: RunHeader) -> RunFrames:
        """Return the frames of a sensor, or of moments, that a packet speaks of, and note that these are conveyed.

        Raises
        ------
        CorruptStream
            If they lie before those of the last packet of the same name, or outside the BATCH.
        """
        sensor = header.sensor if isinstance(header, SensorRunHeader) else None
        run = (self._frame_set_run if sensor is None else self._sensor_runs[sensor]).of(header)
        key = f"{name} of sensor {sensor}" if sensor else name
        due = self._run_ends.get(key, 0)
        number = header.frame if run is None else run[0]
        if number < due:
            raise CorruptStream(f"a {name} from frame {header.frame} on follows one up to frame {due - 1}")
        if run is None:
            raise _elsewhere(self.span, self.span.stop if header.frame in self.span else header.frame)
        self._run_ends[key] = number + header.count
        return RunFrames(frames=run[1], follows=number == due)


def lay_out(header: BatchHeader, members: Sequence[Member], state: DecoderState) -> BatchTimeline:
    """Find out which sensor takes each frame of a BATCH that follows a state.

    Raises
    ------
    CorruptStream
        If an ORDER is malformed or of a frame outside the BATCH.
    """
    span = range(header.frame, header.stop)
    cycles = _cycles(span, members, len(state.sensors))
    if len(state.sensors) == 1 and not cycles:
        run = FrameRun(span.start, span)
        return BatchTimeline(span, cycles, [run], run, state.run_ends)
    own: list[list[int]] = [[] for _ in state.sensors]
    firsts = []
    for frame, slot in zip(span, _slots(span, cycles, state), strict=True):
        own[slot.sensor].append(frame)
        if not slot.synchronized or not frame:
            firsts.append(frame)
    sensor_runs = [FrameRun(sensor.frames, frames) for sensor, frames in zip(state.sensors, own, strict=True)]
    return BatchTimeline(span, cycles, sensor_runs, FrameRun(state.frame_set_count, firsts), state.run_ends)


def _cycles(span: range, members: Sequence[Member], sensors: int) -> dict[int, Cycle]:
    cycles = {}
    for packet, header in members:
        if isinstance(header, OrderHeader):
            _check_frame(span, header.frame)
            cycles[header.frame] = unpack_cycle(packet.payload, sensors)
    return cycles


def _slots(span: range, cycles: Mapping[int, Cycle], state: DecoderState) -> list[SensorSlot]:
    schedule, slots = state.schedule.copy(), []
    for frame in span:
        if frame in cycles:
            schedule.begin(frame, cycles[frame])
        slots.append(schedule.at(frame))
    return slots


def _check_frame(span: range, frame: int) -> None:
    if frame not in span:
        raise _elsewhere(span, frame)


def _elsewhere(span: range, frame: int) -> CorruptStream:
    return CorruptStream(f"a packet of frame {frame} stands in the BATCH of frames {span.start}..{span.stop - 1}")
