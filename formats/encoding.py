# SPDX-License-Identifier: MIT
"""Encode a sequence into a file or a pipe."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import BinaryIO, overload

from threedvc.config import EncoderConfig
from threedvc.decoder.verification import verified
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.formats.container import open_output
from threedvc.formats.pose_check import settle_poses
from threedvc.formats.sources import open_sequence
from threedvc.formats.sources.notices import Notice, notices_of
from threedvc.frames.frame import Frame
from threedvc.frames.sequence import FrameSequence
from threedvc.stream.notes.frame_report import FrameReport
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.pose_status import PoseStatus

__all__ = ["EncodeReport", "encode"]


@dataclass(frozen=True, kw_only=True, eq=False)
class EncodeReport(Sequence[FrameReport]):
    """What encoding came to; as a sequence, one report for each frame.

    Attributes
    ----------
    file_bytes, duration_s
        Size of the stream and length of the sequence.
    seconds
        Time it took.
    voxel_size_m
        Cell of the first object.
    digest
        Digest of the decoded models.
    notices
        What was decided about the recording, and doubts.
    latency_s
        Longest time from a frame coming in to its packet going out, see `Encoder`; None of a file.
    """

    reports: tuple[FrameReport, ...]
    file_bytes: int
    duration_s: float
    seconds: float
    voxel_size_m: float
    digest: bytes
    notices: tuple[Notice, ...] = ()
    latency_s: float | None = None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.reports)

    @property
    def lost_frames(self) -> tuple[int, ...]:
        """Frames in which an object could not be found."""
        return tuple(report.index for report in self.reports if report.status is PoseStatus.LOST)

    def __len__(self) -> int:
        return len(self.reports)

    @overload
    def __getitem__(self, index: int) -> FrameReport: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[FrameReport]: ...
    def __getitem__(self, index: int | slice) -> FrameReport | Sequence[FrameReport]:
        return self.reports[index]


def encode(
    source: str | os.PathLike[str] | FrameSequence,
    output: str | os.PathLike[str] | BinaryIO,
    config: EncoderConfig | None = None,
    *,
    verify: bool = False,
    force: bool = False,
    on_frame: Callable[[FrameReport], None] | None = None,
    on_notice: Callable[[Notice], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> EncodeReport:
    """Encode a sequence of RGB-D frames.

    Parameters
    ----------
    source
        A folder in a layout that `open_sequence` knows, or a sequence.
    output
        A file name, ``-`` for standard output, or a binary stream.
    config
        Choices; None: defaults.
    verify
        Decode what is written, and fail if the decoder arrives at another model.
    force
        Whether a file that is no stream may be replaced.
    on_frame
        Called after each frame is fused.
    on_notice
        Called with each decision about the recording and each doubt, before the first frame is fused.
    stop
        Asked before each frame of a live encode: whether the stream is to end with those before it.

    Returns
    -------
    EncodeReport
        A sequence of the frames' reports, with totals.

    Raises
    ------
    SequenceError
        If the input is missing or implausible, or its poses are asked for and contradict its depth.
    OutputError
        If the output cannot be written.
    """
    sequence = open_sequence(source) if isinstance(source, str | os.PathLike) else source
    began = time.perf_counter()
    settled = settle_poses(sequence, config or EncoderConfig())
    notices = (*notices_of(sequence), *settled.notices)
    if on_notice is not None:
        for notice in notices:
            on_notice(notice)
    sequence, info = settled.frames, settled.frames.info
    encoder = Encoder(info, settled.config)
    written = 0

    def report(frame: FrameReport) -> None:
        if on_frame is not None:
            on_frame(replace(frame, bytes_so_far=written))

    frames: Iterable[Frame] = sequence
    if stop is not None and settled.config.causal:
        frames = takewhile(lambda _: not stop(), sequence)
    packets: Iterable[Packet] = encoder.packets(frames, report)
    if verify:
        packets = verified(packets)
    digest = b""
    with open_output(output, force=force) as writer:
        for packet in packets:
            writer.write(packet)
            written = writer.offset
            if packet.type == PacketType.END:
                digest = packet.header["d"]
    return EncodeReport(
        reports=tuple(encoder.reports),
        file_bytes=writer.offset,
        duration_s=len(encoder.reports) / info.fps,
        seconds=time.perf_counter() - began,
        voxel_size_m=encoder.scene.objects[0].evidence.voxel_size_m,
        digest=digest,
        notices=notices,
        latency_s=encoder.latency_s,
    )
