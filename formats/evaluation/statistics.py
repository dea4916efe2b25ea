# SPDX-License-Identifier: MIT
"""What a stream weighs, where its bytes go, what moves in it, and how well it draws a reference sequence.

The stream is decoded once, for its bytes, models and motion, with a few rays for what each frame shows; with a
reference once more, drawing and comparing one frame at a time.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias, cast

from threedvc.decoder.decoder import Decoder
from threedvc.errors import ConfigError, FormatError, TruncatedStream
from threedvc.formats.container import StreamReader
from threedvc.formats.decoding import DecodedFrame, DecodedStream, errors_named, open_stream
from threedvc.formats.evaluation.byte_counts import ByteCounts
from threedvc.formats.evaluation.comparison import Comparison, check_comparable, paired
from threedvc.formats.evaluation.report import (
    FrameStatistics,
    ObjectStatistics,
    SensorStatistics,
    StreamStatistics,
)
from threedvc.formats.evaluation.timeline import StreamTimeline
from threedvc.formats.evaluation.visibility import VisibilityDetector
from threedvc.formats.sources import FolderSequence, open_sequence
from threedvc.formats.sources.notices import Notice, notices_of
from threedvc.formats.sources.opening import require_folder
from threedvc.formats.sources.recording import KnownCameras
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.camera import CameraRig
from threedvc.metrics.paper_accounting import PaperAccounting
from threedvc.stream.headers import SensorHeader, StreamHeader
from threedvc.stream.sensor_description import rig_of
from threedvc.units import NANOSECONDS

__all__ = ["ReferenceOptions", "statistics"]

STANDARD_INPUT = "-"
DEPTH_BYTES = 2
"""Of a pixel of a 16-bit depth picture, uncompressed."""
PICTURES = frozenset({"color", "depth"})

StreamSource: TypeAlias = str | os.PathLike[str] | BinaryIO
ReferenceOptions: TypeAlias = Mapping[str, Any]
"""Options of `open_sequence` by name: layout, color, depth, intrinsics, depth_scale, fps, poses."""
Reference: TypeAlias = str | os.PathLike[str] | FrameSequence


def statistics(
    source: StreamSource,
    reference: Reference | Sequence[Reference] | None = None,
    *,
    options: Sequence[ReferenceOptions] = (),
    on_frame: Callable[[int], None] | None = None,
    on_notice: Callable[[Notice], None] | None = None,
) -> StreamStatistics:
    """Report what a stream weighs and, with a reference, how well it draws.

    Parameters
    ----------
    source
        A .3dvc file, ``-`` for standard input, or a binary stream; what is not a file is copied to
        a temporary one.
    reference
        The frames that were encoded: a folder in any layout, or a sequence; for a stream of several sensors a list of
        these, one for each. Frames are paired in order where both have the same number of them, else by their times.
    options
        How the references are read, for folders: as of `open_sequence`, for each of them or one for all. What is not
        given is taken from what the stream says of its input, then from the recording, then from the stream's cameras.
    on_frame
        Called with the number of each frame that has been compared.
    on_notice
        Called with each decision about a reference and each doubt.

    Raises
    ------
    FormatError
        If the stream cannot be read. One that merely ends too early is reported as not complete.
    SequenceError
        If the reference cannot be read or does not have the frames of the stream.
    ConfigError
        If there are not as many references as sensors.
    """
    references = _listed(reference)
    for each in references:
        if isinstance(each, str | os.PathLike):
            require_folder(Path(each))
    with _file(source) as (file, name):
        report, decoder = _report(file, name)
        if not references or not report.frames:
            return report
        if len(references) != len(report.sensors):
            raise ConfigError(
                f"{name}: has {len(report.sensors)} sensors and {len(references)} references; give --reference for "
                "each sensor, in their order"
            )
        sequences = [
            _opened_reference(each, decoder, number, options) if isinstance(each, str | os.PathLike) else each
            for number, each in enumerate(references)
        ]
        if on_notice is not None:
            for notice in (notice for sequence in sequences for notice in notices_of(sequence)):
                on_notice(notice)
        file.seek(0)
        return _compared(report, open_stream(file, what=PICTURES), sequences, on_frame)


def _opened_reference(
    folder: str | os.PathLike[str], decoder: Decoder, number: int, options: Sequence[ReferenceOptions]
) -> FolderSequence:
    """Open a reference as the user says, else as the recording of the sensor was read, with the stream's cameras."""
    header = [decoder.header, *decoder.sensors][number]
    assert header is not None
    known = KnownCameras(
        rig=rig_of(header),
        depth_scale=header.depth_scale,
        fps=NANOSECONDS * header.period_den / header.period_num,
    )
    asked = options[number if len(options) > 1 else 0] if options else {}
    chosen: dict[str, Any] = {**decoder.input_options.get(number, {}), **asked}
    return open_sequence(folder, known=known, **chosen)


def _listed(reference: Reference | Sequence[Reference] | None) -> Sequence[Reference]:
    if isinstance(reference, list | tuple):
        return reference
    return [] if reference is None else [cast(Reference, reference)]


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


def _report(file: BinaryIO, name: str) -> tuple[StreamStatistics, Decoder]:
    byte_counts, decoder, timeline = ByteCounts(), Decoder(captured_depth=False, captured_color=False), StreamTimeline()
    detectors: dict[int, VisibilityDetector] = {}
    packets = byte_counts.counted(StreamReader(file, name).records())
    with suppress(TruncatedStream), errors_named(name):
        for state in decoder.frames(packets):
            if state.sensor not in detectors:
                detectors[state.sensor] = VisibilityDetector(decoder.rigs[state.sensor])
            timeline.add(state, detectors[state.sensor].visible(decoder.models, state.T_camera_object))
    if decoder.header is None:
        raise TruncatedStream(f"{name}: ends before its STREAM packet; nothing can be reported")
    file_bytes = file.seek(0, os.SEEK_END)
    objects, frames = _objects(byte_counts, decoder, timeline), len(timeline.times_ns)
    headers: list[StreamHeader | SensorHeader] = [decoder.header, *decoder.sensors]
    sensors = [_sensor(number, header, timeline) for number, header in enumerate(headers)]
    report = StreamStatistics(
        name=decoder.header.name,
        complete=decoder.complete,
        file_bytes=file_bytes,
        duration_s=max(sensor.duration_s for sensor in sensors),
        raw_bytes=sum(sensor.raw_bytes for sensor in sensors),
        packets=byte_counts.packets,
        objects=objects,
        per_frame=_per_frame(timeline, decoder, byte_counts.frame_bytes(frames, file_bytes)),
        paper=_paper(objects, timeline, decoder.rigs),
        sensors=sensors,
        travel=timeline.camera_travel(),
    )
    return report, decoder


def _objects(byte_counts: ByteCounts, decoder: Decoder, timeline: StreamTimeline) -> list[ObjectStatistics]:
    objects = []
    for number, model in sorted(decoder.models.items()):
        spans = timeline.spans(number)
        ended = bool(spans) and spans[-1].last < len(timeline.times_ns) - 1
        objects.append(
            ObjectStatistics(
                id=number,
                cells=model.cell_count,
                voxel_size_m=model.voxel_size_m,
                bytes=byte_counts.object_bytes[number],
                poses=byte_counts.poses[number],
                guessed=model.guessed,
                passing=model.passing,
                spans=spans,
                birth=spans[0].first if spans else None,
                death=spans[-1].last if ended else None,
                travel=timeline.object_travel(number, model),
            )
        )
    return objects


def _sensor(number: int, header: StreamHeader | SensorHeader, timeline: StreamTimeline) -> SensorStatistics:
    rig, channels, frames = rig_of(header), 1 if header.gray else 3, timeline.sensors.count(number)
    raw_bytes = rig.color.width * rig.color.height * channels + rig.depth.width * rig.depth.height * DEPTH_BYTES
    return SensorStatistics(
        number=number,
        name=header.name,
        frames=frames,
        duration_s=frames * header.period_num / header.period_den / NANOSECONDS,
        raw_bytes=frames * raw_bytes,
    )


def _paper(objects: Sequence[ObjectStatistics], timeline: StreamTimeline, rigs: Sequence[CameraRig]) -> PaperAccounting:
    # A single pose only says where an object stands.
    moving = [item for item in objects if item.poses > 1]
    return PaperAccounting(
        cells=sum(item.cells for item in moving),
        pose_frames=sum(item.poses for item in moving),
        frames=len(timeline.sensors),
        pixels=max(rig.color.width * rig.color.height for rig in rigs),
    )


def _per_frame(timeline: StreamTimeline, decoder: Decoder, sizes: Sequence[int]) -> list[FrameStatistics]:
    told, counts = decoder.report, timeline.counts(decoder.models)
    frames = range(len(timeline.times_ns))
    entropies = dict(zip(frames, told.entropy_bits, strict=False))
    status = dict(zip(frames, told.status, strict=False))
    return [
        FrameStatistics(
            frame=frame,
            timestamp_ns=timeline.times_ns[frame],
            bytes=sizes[frame],
            T_world_camera=timeline.T_world_camera[frame],
            visible_objects=counts[frame],
            entropy_bits=entropies.get(frame),
            status=status.get(frame),
            sensor=timeline.sensors[frame],
        )
        for frame in frames
    ]


def _until_cut(stream: Iterable[DecodedFrame]) -> Iterator[DecodedFrame]:
    """Yield the frames that are there; that a stream is cut short is reported otherwise."""
    with suppress(TruncatedStream):
        yield from stream


def _compared(
    report: StreamStatistics,
    stream: DecodedStream,
    references: Sequence[FrameSequence],
    on_frame: Callable[[int], None] | None,
) -> StreamStatistics:
    for info, reference in zip(stream.infos, references, strict=True):
        check_comparable(info, reference.info)
    # In the coarsest units, in which every sensor's depth fits into 16 bits.
    comparison = Comparison(depth_scale=min(reference.info.depth_scale for reference in references))
    counts = [sensor.frames for sensor in report.sensors]
    for drawn, given in paired(_until_cut(stream), references, counts):
        comparison.add(drawn, given)
        if on_frame is not None:
            on_frame(drawn.index)
    frames = zip(report.per_frame, comparison.per_frame, strict=True)
    return replace(
        report,
        per_frame=[replace(frame, quality=quality) for frame, quality in frames],
        camera=comparison.camera(),
        object_motion=comparison.objects.motion(),
        reference_objects=comparison.objects.reference(),
        spurious_objects=comparison.objects.spurious(),
        quality=comparison.quality(),
        lossless=comparison.lossless(),
    )
