# SPDX-License-Identifier: MIT
"""The encoder: frames in, packets out.

A file is encoded in two passes over the model, not over the frames: every frame is fused first, then
each group of frames gets the cells that it sees for the first time, as they turned out in the end. A
live encoder sends each group as soon as it is fused.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator

from threedvc.config import EncoderConfig
from threedvc.emitter import Emitter
from threedvc.errors import CorruptStream, SequenceError
from threedvc.decoder import Decoder
from threedvc.frame import Frame, SequenceInfo
from threedvc.packets import Packet, PacketType
from threedvc.report import FrameReport
from threedvc.scene import Scene

__all__ = ["Encoder", "verified"]


class Encoder:
    """Encodes one sequence.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.

    Attributes
    ----------
    scene
        Objects, evidence and poses, as of the frames taken in so far.
    reports
        One for every frame taken in.
    """

    def __init__(self, info: SequenceInfo, config: EncoderConfig | None = None) -> None:
        self.info = info
        self.config = config or EncoderConfig()
        self.scene = Scene(info, self.config)
        self.reports: list[FrameReport] = []
        self._emitter = Emitter(self.scene, self.config)
        self._group = self.config.group_frames or max(1, round(info.fps))

    def packets(
        self, frames: Iterable[Frame], on_frame: Callable[[FrameReport], None] | None = None
    ) -> Iterator[Packet]:
        """Take in all frames and yield the packets of the stream.

        Parameters
        ----------
        frames
            Frames in order, numbered from 0.
        on_frame
            Called after each frame is fused.

        Raises
        ------
        SequenceError
            If there is no frame, or none of them has depth.
        """
        began = time.perf_counter()
        sent = 0
        for frame in frames:
            status = self.scene.add(frame)
            self.reports.append(self._report(frame, status, time.perf_counter() - began))
            if on_frame:
                on_frame(self.reports[-1])
            if self.config.causal and len(self.reports) - sent == self._group:
                yield from self._groups(sent, len(self.reports), last=False)
                sent = len(self.reports)
        if not self.reports:
            raise SequenceError(f"{self.info.name} has no frames")
        if not any(item.evidence.index.count for item in self.scene.objects.values()):
            raise SequenceError(f"{self.info.name}: no frame has a depth measurement that could be used")
        yield from self._groups(sent, len(self.reports), last=True)
        yield self._emitter.end()

    def _report(self, frame: Frame, status: str, seconds: float) -> FrameReport:
        return FrameReport(
            index=frame.index,
            timestamp_ns=frame.timestamp_ns,
            status=status,
            entropy_bits=self.scene.entropy_bits,
            seconds=seconds,
        )

    def _groups(self, first: int, stop: int, *, last: bool) -> Iterator[Packet]:
        """Yield the batches of frames that were taken in; the first is preceded by STREAM."""
        if first == 0:
            yield self._emitter.stream()
        for start in range(first, stop, self._group):
            end = min(start + self._group, stop)
            final = last and end == stop
            told = self.reports[start:end] if self.config.causal else self.reports if final else []
            batch = self._emitter.group(start, end, told, last=final)
            if batch is not None:
                yield batch


def verified(packets: Iterable[Packet]) -> Iterator[Packet]:
    """Pass packets on while a decoder follows them.

    Raises
    ------
    CorruptStream
        If the decoder cannot follow, or arrives at another model than the encoder's.
    """
    decoder = Decoder()
    kept: list[Packet] = []

    def passing() -> Iterator[Packet]:
        for packet in packets:
            kept.append(packet)
            yield packet

    for _ in decoder.frames(passing()):
        while kept:
            yield kept.pop(0)
    while kept:
        packet = kept.pop(0)
        yield packet
        if packet.type == PacketType.END and not decoder.complete:
            raise CorruptStream("verification failed: the decoder did not reach the encoder's model")
