# SPDX-License-Identifier: MIT
"""What the encoder tells about its work, frame by frame, and its compact form in a META packet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, groupby, pairwise
from typing import ClassVar, TypeAlias

import numpy as np

from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.limits import MAX_COUNT
from threedvc.stream.compressed_payload import compress, decompress
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.pose_status import PoseStatus
from threedvc.stream.wire import ByteReader, pack_signed_varint, pack_varint

__all__ = ["NOTE", "FrameReport", "FrameReports", "OnFrame", "StreamReport", "report_packet", "unpack_report"]

STEPS_PER_OCTAVE = 32
"""Levels of entropy up to its double: 2.2 % apart, so that a level is within 1.1 %."""
MAX_LEVEL = 64 * STEPS_PER_OCTAVE
"""That of 2^64 bits: no model that fits into memory has so many."""
STATUSES = (PoseStatus.KNOWN, PoseStatus.TRACKED, PoseStatus.WEAK, PoseStatus.LOST, PoseStatus.RELOCALIZED)
"""In the order of their numbers in the stream."""
MAX_REPORT_BYTES = 8 * MAX_COUNT
"""More than frames can take: two bytes each for a step of entropy, and two to four for a run of one status."""


@dataclass(frozen=True, kw_only=True)
class FrameReport:
    """One frame as the encoder saw it.

    Attributes
    ----------
    index, timestamp_ns
        Which frame.
    status
        Worst outcome of finding the objects.
    entropy_bits
        Entropy of all models after the frame.
    bytes_so_far
        Bytes of the stream written up to now; 0 while a two-pass encoder is still fusing.
    seconds
        Time since encoding began.
    """

    index: int
    timestamp_ns: int
    status: PoseStatus
    entropy_bits: float
    bytes_so_far: int = 0
    seconds: float = 0.0


OnFrame: TypeAlias = Callable[[FrameReport], None]


@dataclass(frozen=True, kw_only=True)
class StreamReport:
    """Entropy in bits and status of consecutive frames, as the stream keeps them."""

    entropy_bits: tuple[float, ...]
    status: tuple[PoseStatus, ...]


def report_packet(frames: Sequence[FrameReport]) -> Packet:
    """Pack consecutive frames into an ancillary packet: statuses as runs, entropies to 2 %.

    Raises
    ------
    LimitExceeded
        If there are more than `MAX_COUNT` frames.
    """
    if len(frames) > MAX_COUNT:
        raise LimitExceeded(f"a report of {len(frames)} frames is longer than {MAX_COUNT}; divide it")
    levels = [round(STEPS_PER_OCTAVE * float(np.log2(max(frame.entropy_bits, 1.0)))) for frame in frames]
    steps = [later - earlier for earlier, later in pairwise([0, *levels])]
    runs = [(STATUSES.index(status), len(list(group))) for status, group in groupby(frame.status for frame in frames)]
    parts = [pack_varint(len(frames)), pack_varint(len(runs))]
    parts += [pack_varint(code) + pack_varint(count) for code, count in runs]
    parts += [pack_signed_varint(step) for step in steps]
    header = {"k": FrameReports.kind}
    return Packet(type=PacketType.META, header=header, payload=compress(b"".join(parts)), critical=False)


def unpack_report(packet: Packet) -> StreamReport:
    """Read a packet made by `report_packet`.

    Raises
    ------
    CorruptStream
        If the payload is malformed.
    """
    reader = ByteReader(decompress(packet.payload, MAX_REPORT_BYTES, "the encoder's report"))
    count, runs = reader.varint(), reader.varint()
    if count > MAX_COUNT or runs > count:
        raise CorruptStream(f"the encoder's report of {count} frames in {runs} runs is impossible")
    status: list[PoseStatus] = []
    for _ in range(runs):
        code, length = reader.varint(), reader.varint()
        if code >= len(STATUSES) or not 0 < length <= count - len(status):
            raise CorruptStream(f"the encoder's report has a run of {length} frames of status {code}")
        status += [STATUSES[code]] * length
    levels = list(accumulate(reader.signed_varint() for _ in range(len(status))))
    if len(status) != count or reader.remaining or not all(0 <= level < MAX_LEVEL for level in levels):
        raise CorruptStream(f"the encoder's report of {count} frames is not complete")
    bits = tuple(float(2 ** (level / STEPS_PER_OCTAVE)) for level in levels)
    return StreamReport(entropy_bits=bits, status=tuple(status))


class FrameReports:
    """The reports of a stream, gathered wherever they stand."""

    kind: ClassVar[str] = "report"

    def __init__(self) -> None:
        self._entropy_bits: list[float] = []
        self._status: list[PoseStatus] = []

    def add(self, packet: Packet) -> None:
        """Note what a packet reports, of at most `MAX_COUNT` frames in all."""
        report = unpack_report(packet)
        free = MAX_COUNT - len(self._status)
        self._entropy_bits += report.entropy_bits[:free]
        self._status += report.status[:free]

    def all(self) -> StreamReport:
        """Return what was reported; empty if the stream does not say."""
        return StreamReport(entropy_bits=tuple(self._entropy_bits), status=tuple(self._status))


NOTE = FrameReports
