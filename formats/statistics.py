# SPDX-License-Identifier: MIT
"""What a stream weighs, where its bytes go, and how well it draws a reference sequence.

The stream is decoded once without drawing anything, for its bytes, models and motion; with a reference
once more, drawing and comparing one frame at a time.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import islice, zip_longest
from typing import Any, BinaryIO, TypeAlias

from threedvc.camera import CameraRig
from threedvc.decoder import Decoder, rig_of
from threedvc.errors import FormatError, TruncatedStream
from threedvc.formats.api import DecodedFrame, DecodedStream, errors_named, open_stream
from threedvc.formats.comparison import Comparison, check_comparable, paired
from threedvc.formats.container import StreamReader
from threedvc.formats.sources import open_sequence
from threedvc.formats.tally import PacketTotal, Tally
from threedvc.frame import NANOSECONDS, FrameSequence
from threedvc.metrics import PaperAccounting, TrajectoryError
from threedvc.packets import StreamHeader
from threedvc.report import StreamReport

__all__ = [
    "FrameStatistics",
    "ObjectStatistics",
    "StreamStatistics",
    "statistics",
]

STANDARD_INPUT = "-"
DEPTH_BYTES = 2
PICTURES = frozenset({"color", "depth"})

StreamSource: TypeAlias = str | os.PathLike[str] | BinaryIO


@dataclass(frozen=True, kw_only=True)
class ObjectStatistics:
    """One object of the stream: its cells at the end, its bytes, and the frames that carry a pose for it."""

    id: int
    cells: int
    voxel_size_m: float
    bytes: int
    poses: int


@dataclass(frozen=True, kw_only=True)
class FrameStatistics:
    """One frame: its share of the stream, and its quality where there is a reference.

    Attributes
    ----------
    frame, timestamp_ns
        Number and time.
    bytes
        Bytes sent for the frame; packets of several frames are divided evenly.
    entropy_bits, status
        Entropy of the encoder's models after the frame, and how its pose was found; None where the
        stream does not say.
    quality
        Measures of this frame alone, empty without a reference.
    """

    frame: int
    timestamp_ns: int
    bytes: int
    entropy_bits: float | None = None
    status: str | None = None
    quality: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class StreamStatistics:
    """The report of `statistics`.

    Attributes
    ----------
    name
        Name of the encoded sequence.
    complete
        False when the stream ends too early; everything else then describes the part that is there.
    file_bytes, duration_s
        Size of the file, and frames divided by the frame rate.
    raw_bytes
        Size of the frames as 8-bit colour (with its channels) and 16-bit depth.
    packets
        Totals by type of packet.
    objects
        In order of number.
    per_frame
        In order of time.
    paper
        Equations (8) to (10); M and F_m sum over the objects that move, which the background does when
        the camera does.
    camera, object_motion
        Error of the camera's trajectory, and of the camera's trajectory in the frame of each object.
    quality
        Measures over all frames; None without a reference.
    """

    name: str
    complete: bool
    file_bytes: int
    duration_s: float
    raw_bytes: int
    packets: Mapping[str, PacketTotal]
    objects: Sequence[ObjectStatistics]
    per_frame: Sequence[FrameStatistics]
    paper: PaperAccounting
    camera: TrajectoryError | None = None
    object_motion: Mapping[int, TrajectoryError] = field(default_factory=dict)
    quality: Mapping[str, float] | None = None

    @property
    def frames(self) -> int:
        """Number of frames that can be decoded."""
        return len(self.per_frame)

    @property
    def kbit_s(self) -> float:
        """Bits of the whole file per second of video, in thousands."""
        return self.file_bytes * 8 / self.duration_s / 1000 if self.duration_s else math.nan

    @property
    def ratio(self) -> float:
        """N of the compression 1:N against the raw frames."""
        return self.raw_bytes / self.file_bytes

    @property
    def status(self) -> dict[str, int]:
        """Number of frames by the status of their pose."""
        return dict(Counter(item.status for item in self.per_frame if item.status is not None))

    def to_map(self) -> dict[str, Any]:
        """Return the report as plain values; a number that is not finite becomes None."""
        report: dict[str, Any] = {
            "name": self.name,
            "complete": self.complete,
            "file_bytes": self.file_bytes,
            "frames": self.frames,
            "duration_s": self.duration_s,
            "kbit_s": self.kbit_s,
            "raw_bytes": self.raw_bytes,
            "ratio": self.ratio,
            "packets": {name: asdict(total) for name, total in self.packets.items()},
            "objects": [asdict(item) for item in self.objects],
            "bytes_per_frame": [item.bytes for item in self.per_frame],
            "entropy_bits": [item.entropy_bits for item in self.per_frame if item.entropy_bits is not None],
            "trajectory": self._trajectory_map(),
            "paper": {
                "M": self.paper.cells,
                "F_m": self.paper.pose_frames,
                "S_3dvc": self.paper.coded_bytes,
                "S_raw": self.paper.raw_bytes,
                "ratio": self.paper.ratio,
            },
        }
        if self.quality is not None:
            report["quality"] = dict(self.quality)
        return {name: _finite(value) for name, value in report.items()}

    def to_json(self) -> str:
        """Return the report as JSON text."""
        return json.dumps(self.to_map(), indent=1)

    def _trajectory_map(self) -> dict[str, Any]:
        report: dict[str, Any] = {"status": self.status}
        if self.camera is not None:
            report |= asdict(self.camera)
        if self.object_motion:
            report["objects"] = {str(number): asdict(error) for number, error in self.object_motion.items()}
        return report


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def statistics(
    source: StreamSource,
    reference: str | os.PathLike[str] | FrameSequence | None = None,
    *,
    on_frame: Callable[[int], None] | None = None,
) -> StreamStatistics:
    """Report what a stream weighs and, with a reference, how well it draws.

    Parameters
    ----------
    source
        A .3dvc file, ``-`` for standard input, or a binary stream; what is not a file is copied to
        a temporary one.
    reference
        The frames that were encoded: a folder in any layout, or a sequence. Frames are paired in
        order where both have the same number of them, else by their times.
    on_frame
        Called with the number of each frame that has been compared.

    Raises
    ------
    FormatError
        If the stream cannot be read. One that merely ends too early is reported as not complete.
    SequenceError
        If the reference cannot be read or does not have the frames of the stream.
    """
    sequence = open_sequence(reference) if isinstance(reference, str | os.PathLike) else reference
    with _file(source) as (file, name):
        report = _report(file, name)
        if sequence is None or not report.frames:
            return report
        file.seek(0)
        return _compared(report, open_stream(file, what=PICTURES), sequence, on_frame)


@contextmanager
def _file(source: StreamSource) -> Iterator[tuple[BinaryIO, str]]:
    """Open the source as a file that can be read several times, and name it."""
    if isinstance(source, str | os.PathLike) and os.fspath(source) != STANDARD_INPUT:
        with _opened(source) as file:
            yield file, os.fspath(source)
        return
    stream = sys.stdin.buffer if isinstance(source, str | os.PathLike) else source
    with tempfile.TemporaryFile() as copy:
        shutil.copyfileobj(stream, copy)
        copy.seek(0)
        yield copy, "standard input" if stream is not source else "stream"


def _opened(path: str | os.PathLike[str]) -> BinaryIO:
    try:
        return open(path, "rb")
    except OSError as error:
        raise FormatError(f"{os.fspath(path)}: cannot be opened: {error.strerror}; check the name") from None


def _report(file: BinaryIO, name: str) -> StreamStatistics:
    tally, decoder, times = Tally(), Decoder(), []
    packets = tally.counted(StreamReader(file, name).records())
    with suppress(TruncatedStream), errors_named(name):
        for state in decoder.frames(packets):
            times.append(state.timestamp_ns)
    if decoder.header is None:
        raise TruncatedStream(f"{name}: ends before its STREAM packet; nothing can be reported")
    file_bytes = file.seek(0, os.SEEK_END)
    objects = _objects(tally, decoder)
    return StreamStatistics(
        name=decoder.header.name,
        complete=decoder.complete,
        file_bytes=file_bytes,
        duration_s=len(times) * decoder.header.period_num / decoder.header.period_den / NANOSECONDS,
        raw_bytes=len(times) * _raw_frame_bytes(decoder.header),
        packets=tally.packets,
        objects=objects,
        per_frame=_per_frame(times, tally.frame_bytes(len(times), file_bytes), decoder.report),
        paper=_paper(objects, len(times), rig_of(decoder.header)),
    )


def _objects(tally: Tally, decoder: Decoder) -> list[ObjectStatistics]:
    return [
        ObjectStatistics(
            id=number,
            cells=model.cell_count,
            voxel_size_m=model.voxel_size_m,
            bytes=tally.object_bytes[number],
            poses=tally.poses[number],
        )
        for number, model in sorted(decoder.models.items())
    ]


def _raw_frame_bytes(header: StreamHeader) -> int:
    rig = rig_of(header)
    channels = 1 if header.grey else 3
    return rig.color.width * rig.color.height * channels + rig.depth.width * rig.depth.height * DEPTH_BYTES


def _paper(objects: Sequence[ObjectStatistics], frames: int, rig: CameraRig) -> PaperAccounting:
    # A single pose only says where an object stands.
    moving = [item for item in objects if item.poses > 1]
    return PaperAccounting(
        cells=sum(item.cells for item in moving),
        pose_frames=sum(item.poses for item in moving),
        frames=frames,
        pixels=rig.color.width * rig.color.height,
    )


def _per_frame(times: Sequence[int], sizes: Sequence[int], report: StreamReport | None) -> list[FrameStatistics]:
    entropies, status = (report.entropy_bits, report.status) if report is not None else ((), ())
    return [
        FrameStatistics(frame=frame, timestamp_ns=time, bytes=size, entropy_bits=bits, status=outcome)
        for frame, (time, size, bits, outcome) in enumerate(
            islice(zip_longest(times, sizes, entropies, status), len(times))
        )
    ]


def _until_cut(stream: Iterable[DecodedFrame]) -> Iterator[DecodedFrame]:
    """Yield the frames that are there; that a stream is cut short is reported otherwise."""
    with suppress(TruncatedStream):
        yield from stream


def _compared(
    report: StreamStatistics,
    stream: DecodedStream,
    reference: FrameSequence,
    on_frame: Callable[[int], None] | None,
) -> StreamStatistics:
    check_comparable(stream.info, reference.info)
    comparison = Comparison(depth_scale=reference.info.depth_scale)
    for drawn, given in paired(_until_cut(stream), reference, report.frames):
        comparison.add(drawn, given)
        if on_frame is not None:
            on_frame(drawn.index)
    frames = zip(report.per_frame, comparison.per_frame, strict=True)
    return replace(
        report,
        per_frame=[replace(frame, quality=quality) for frame, quality in frames],
        camera=comparison.camera(),
        object_motion=comparison.object_motion(),
        quality=comparison.quality(),
    )
