# SPDX-License-Identifier: MIT
"""What META packets tell beside the frames: the encoder's report, how the input was read, times of colour pictures."""

from __future__ import annotations

from threedvc.limits import MAX_COUNT
from threedvc.stream.color_times import unpack_color_times
from threedvc.stream.frame_report import StreamReport, unpack_report
from threedvc.stream.input_options import InputOptions, unpack_input_options
from threedvc.stream.packets import Packet
from threedvc.stream.pose_status import PoseStatus

__all__ = ["StreamNotes"]


class StreamNotes:
    """The notes of a stream, gathered wherever they stand.

    Attributes
    ----------
    input_options
        Options that the recordings were read with, by sensor.
    """

    def __init__(self) -> None:
        self.input_options: dict[int, InputOptions] = {}
        self._entropy_bits: list[float] = []
        self._status: list[PoseStatus] = []
        self._color_offsets_ns: dict[int, int] = {}

    @property
    def report(self) -> StreamReport:
        """What the encoder told about its work, of at most `MAX_COUNT` frames; empty if the stream does not say."""
        return StreamReport(entropy_bits=tuple(self._entropy_bits), status=tuple(self._status))

    def add(self, packet: Packet) -> None:
        """Note what a META packet tells, if it is of a kind that this reader knows."""
        self._color_offsets_ns.update(unpack_color_times(packet) or {})
        if (options := unpack_input_options(packet)) is not None:
            self.input_options[options[0]] = options[1]
        if (report := unpack_report(packet)) is not None:
            self._add_report(report)

    def _add_report(self, report: StreamReport) -> None:
        free = MAX_COUNT - len(self._status)
        self._entropy_bits += report.entropy_bits[:free]
        self._status += report.status[:free]

    def take_color_offset_ns(self, frame: int) -> int:
        """Return how much later than its depth picture the colour picture of a frame was taken, and forget it."""
        return self._color_offsets_ns.pop(frame, 0)
