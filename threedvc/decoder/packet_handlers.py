# SPDX-License-Identifier: MIT
"""What each type of packet in a BATCH changes, and before which frame.

A handler checks and decodes what depends on packets alone at once; what depends on the models as of its frame is
decoded when the change is made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Final, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.depth_cells import spread
from threedvc.coding.depth_picture import decode_depths
from threedvc.coding.filters import decode_filter
from threedvc.coding.light import unpack_light
from threedvc.coding.poses import PoseCoder
from threedvc.coding.relief import decode_relief
from threedvc.coding.texture import decode_texture
from threedvc.coding.update import decode_update
from threedvc.coding.video.av1 import can_decode_av1, decode_av1
from threedvc.coding.video.color_runs import decode_color, video_format
from threedvc.coding.video.earlier import EARLIER_BITS, decode_earlier_run, decode_earlier_still
from threedvc.coding.video.ffv1 import EXACT_BITS, can_decode_ffv1, decode_ffv1
from threedvc.coding.video.jpeg import decode_jpeg_files
from threedvc.coding.video.planes import CapturedColor, ExactColor, Samples, ShownColor, VideoFormat
from threedvc.coding.video.still import decode_still
from threedvc.decoder.batch_timeline import BatchTimeline, RunFrames, lay_out
from threedvc.decoder.decoder_state import DecoderState
from threedvc.decoder.measured_depth import MeasuredRun
from threedvc.decoder.sensor_state import SensorState
from threedvc.errors import CorruptStream, LimitExceeded, UnsupportedVersion
from threedvc.geometry.pose import Pose
from threedvc.limits import MAX_COLOR_VIDEO_SAMPLES, MAX_COUNT, MAX_SEQUENCE_SAMPLES
from threedvc.render.captured_depth import CapturedDepth, depth_levels, unpack_tiles
from threedvc.stream.batch import Member
from threedvc.stream.captured_headers import ColorVideoHeader, DepthVideoHeader, ResidualHeader, VideoHeader
from threedvc.stream.headers import (
    BackdropHeader,
    BackgroundHeader,
    BatchHeader,
    ClockHeader,
    DepthHeader,
    FilterHeader,
    GainHeader,
    Header,
    LightHeader,
    ModelHeader,
    ObjectHeader,
    OrderHeader,
    PoseHeader,
    ReliefHeader,
    ShiftHeader,
    TextureHeader,
)
from threedvc.stream.packets import PacketType, VideoCodec
from threedvc.stream.wire import ByteReader

__all__ = ["Change", "changes_by_frame"]

Change: TypeAlias = Callable[[], None]
"""What is done to the state before a frame is drawn."""
FrameChange: TypeAlias = tuple[int, Change]
Handler: TypeAlias = Callable[[DecoderState, BatchTimeline, Header, bytes], Iterable[FrameChange]]
H = TypeVar("H", bound=Header)
LOSSY_CODECS: Final = (VideoCodec.AV1, VideoCodec.AV1_FULL_CHROMA)
"""Whose pictures are planes of luma and chroma."""
EXACT_CODECS: Final = (VideoCodec.FFV1, VideoCodec.JPEG)
"""Whose pictures are shown as they are."""


def changes_by_frame(header: BatchHeader, members: Sequence[Member], state: DecoderState) -> dict[int, list[Change]]:
    """Return the changes of a BATCH that follows a state, by the frame before which they are made.

    Raises
    ------
    CorruptStream
        If packets contradict each other, or are malformed.
    LimitExceeded
        If they speak of more than a reader accepts.
    """
    _check_pose_count(members)
    _check_videos(members)
    timeline = lay_out(header, members, state)
    changes: dict[int, list[Change]] = {}
    for member in members:
        for frame, change in _changes_of(member, state, timeline):
            timeline.check(frame)
            changes.setdefault(frame, []).append(change)
    return changes


def _check_pose_count(members: Iterable[Member]) -> None:
    poses = sum(header.count for _, header in members if isinstance(header, PoseHeader | ShiftHeader | GainHeader))
    if poses > MAX_COUNT:
        raise LimitExceeded(f"a BATCH holds {poses} poses, shifts and gains, at most {MAX_COUNT} are accepted")


def _check_videos(members: Iterable[Member]) -> None:
    depth, color = (VideoHeader, DepthVideoHeader), (ColorVideoHeader,)
    for kinds, most in ((depth, MAX_SEQUENCE_SAMPLES), (color, MAX_COLOR_VIDEO_SAMPLES)):
        videos = (header for _, header in members if isinstance(header, kinds))
        samples = sum(video.count * video.columns * video.rows for video in videos)
        if samples > most:
            raise LimitExceeded(f"a BATCH holds videos of {samples} samples, at most {most} are accepted")


def _changes_of(member: Member, state: DecoderState, timeline: BatchTimeline) -> Iterable[FrameChange]:
    if member.header is not None:
        return HANDLERS[type(member.header)](state, timeline, member.header, member.packet.payload)
    if member.packet.type == PacketType.META:
        state.notes.add(member.packet)
    return ()


def _add_object(
    state: DecoderState, timeline: BatchTimeline, header: ObjectHeader, payload: bytes
) -> Iterable[FrameChange]:
    state.add_object(header)
    return ()


def _update(state: DecoderState, timeline: BatchTimeline, header: ModelHeader, payload: bytes) -> Iterator[FrameChange]:
    yield header.frame, partial(_apply_update, state, header.object_id, payload)


def _apply_update(state: DecoderState, number: int, payload: bytes) -> None:
    model = state.object(number).model
    model.apply(decode_update(payload, *model.cells()))


def _relief(
    state: DecoderState, timeline: BatchTimeline, header: ReliefHeader, payload: bytes
) -> Iterator[FrameChange]:
    yield header.frame, partial(_apply_relief, state, header.object_id, payload)


def _apply_relief(state: DecoderState, number: int, payload: bytes) -> None:
    model = state.object(number).model
    if not model.relief_bits:
        raise CorruptStream(f"a RELIEF names object {number}, which has none")
    if not len(model.cells_without_offset()[0]):
        raise CorruptStream(f"a RELIEF of object {number} comes when all its cells have one")
    decode_relief(payload, model)


def _texture(
    state: DecoderState, timeline: BatchTimeline, header: TextureHeader, payload: bytes
) -> Iterator[FrameChange]:
    yield header.frame, partial(_apply_texture, state, header.object_id, payload)


def _apply_texture(state: DecoderState, number: int, payload: bytes) -> None:
    model = state.object(number).model
    if model.texture is None:
        raise CorruptStream(f"a TEXTURE names object {number}, which has none")
    texels = model.uncolored_texels()
    if not len(texels):
        raise CorruptStream(f"a TEXTURE of object {number} comes when all its cells have one")
    model.texture.paint(texels, decode_texture(payload, model, texels))


def _depth(state: DecoderState, timeline: BatchTimeline, header: DepthHeader, payload: bytes) -> Iterator[FrameChange]:
    state.object(0)
    yield header.frame, partial(_add_depth_layer, state, payload)


def _add_depth_layer(state: DecoderState, payload: bytes) -> None:
    """Make cells of a depth picture, as seen from where the packets before it have placed the camera."""
    camera, background = state.sensors[0].rig.depth, state.object(0)
    spread(decode_depths(payload, camera.width, camera.height), background.model, camera, background.pose)


def _poses(state: DecoderState, timeline: BatchTimeline, header: PoseHeader, payload: bytes) -> Iterator[FrameChange]:
    coder = state.object(header.object_id).pose_coder
    run = timeline.convey(f"POSE of object {header.object_id}", header)
    for frame, pose in _decoded_poses(coder, run, payload):
        yield frame, partial(state.set_pose, header.object_id, pose)


def _shifts(state: DecoderState, timeline: BatchTimeline, header: ShiftHeader, payload: bytes) -> Iterator[FrameChange]:
    sensor = state.sensor(header)
    run = timeline.convey("SHIFT", header)
    for frame, shift in _decoded_poses(sensor.shift_coder, run, payload):
        yield frame, partial(sensor.set_shift, shift)


def _decoded_poses(coder: PoseCoder, run: RunFrames, payload: bytes) -> Iterator[tuple[int, Pose]]:
    """Decode the poses of a run, with their frames; between runs what they place stands still."""
    if not run.follows:
        coder.reset_velocity()
    return zip(run.frames, coder.decode(payload, len(run.frames)), strict=True)


def _gains(state: DecoderState, timeline: BatchTimeline, header: GainHeader, payload: bytes) -> Iterator[FrameChange]:
    sensor = state.sensor(header)
    run = timeline.convey("GAIN", header)
    for frame, gain in zip(run.frames, sensor.gain_coder.decode(payload, header.count), strict=True):
        yield frame, partial(sensor.set_gain, gain)


def _clock(state: DecoderState, timeline: BatchTimeline, header: ClockHeader, payload: bytes) -> Iterator[FrameChange]:
    sensor = state.sensor(header)
    run = timeline.convey("CLOCK", header)
    reader = ByteReader(payload)
    for frame in run.frames:
        yield frame, partial(sensor.set_clock_correction, reader.signed_varint())
    if reader.remaining:
        raise CorruptStream(f"{reader.remaining} bytes follow the corrections of CLOCK")


def _captured_depth(
    state: DecoderState, timeline: BatchTimeline, header: DepthVideoHeader, payload: bytes
) -> Iterator[FrameChange]:
    sensor = state.sensor(header)
    run = timeline.convey("DEPTH_VIDEO", header)
    if not _shows_depth(state, header.codec):
        return
    video = VideoFormat(width=header.columns, height=header.rows, bits=header.bits, gray=True)
    pictures = (planes.luma for planes in decode_av1(payload, header.count, video))
    tiles = unpack_tiles(header.tiles, header.rows, header.columns)
    levels = depth_levels(header.nearest_m, header.ratio, header.bits, header.law)
    for frame in run.frames:
        yield frame, partial(_show_next_depth, sensor, pictures, levels, header.complete, tiles)


def _earlier_captured_depth(
    state: DecoderState, timeline: BatchTimeline, header: VideoHeader, payload: bytes
) -> Iterator[FrameChange]:
    sensor = state.sensor(header)
    run = timeline.convey("VIDEO", header)
    if not _shows_depth(state, VideoCodec.AV1):
        return
    pictures = decode_earlier_run(payload, header.count, header.columns, header.rows)
    levels = depth_levels(header.nearest_m, header.ratio, EARLIER_BITS)
    for frame in run.frames:
        yield frame, partial(_show_next_depth, sensor, pictures, levels, header.complete)


def _shows_depth(state: DecoderState, codec: int) -> bool:
    """Tell whether depth of a codec is wanted and can be read; if it only cannot be read, note the codec."""
    readable = codec == VideoCodec.AV1 and can_decode_av1()
    if state.wanted.depth and not readable:
        state.unread_codecs["depth"] = codec
    return state.wanted.depth and readable


def _show_next_depth(
    sensor: SensorState,
    pictures: Iterator[Samples],
    levels: NDArray[np.float64],
    complete: bool,
    tiles: NDArray[np.bool_] | None = None,
) -> None:
    """Decode the next picture of a run; all of them at once might not fit into memory."""
    depth = CapturedDepth(samples=next(pictures), levels=levels, complete=complete, tiles=tiles)
    sensor.set_captured_depth(depth)


def _captured_color(
    state: DecoderState, timeline: BatchTimeline, header: ColorVideoHeader, payload: bytes
) -> Iterator[FrameChange]:
    sensor = state.sensor(header)
    run = timeline.convey("COLOR_VIDEO", header)
    if not state.wanted.color:
        return
    pictures = _color_pictures(sensor, header, payload)
    if pictures is None:
        state.unread_codecs["color"] = header.codec
        return
    for frame in run.frames:
        yield frame, partial(_show_next, sensor, pictures)


def _color_pictures(sensor: SensorState, header: ColorVideoHeader, payload: bytes) -> Iterator[ShownColor] | None:
    """Check a video, and return an iterator that decodes its pictures, or None if that cannot be done here."""
    video = video_format(header, gray=sensor.header.gray)
    if header.codec in LOSSY_CODECS and can_decode_av1():
        return (CapturedColor(planes=planes, video=video) for planes in decode_color(payload, header.count, video))
    if header.codec not in EXACT_CODECS or (header.codec == VideoCodec.FFV1 and not can_decode_ffv1()):
        return None
    camera = sensor.rig.color
    if video != VideoFormat(width=camera.width, height=camera.height, bits=EXACT_BITS, gray=video.gray):
        raise CorruptStream(
            f"a video without loss of {video.width}x{video.height} samples of {video.bits} bits must have "
            f"{camera.width}x{camera.height} of {EXACT_BITS} bits, which are not magnified; the stream is damaged"
        )
    decode = decode_ffv1 if header.codec == VideoCodec.FFV1 else decode_jpeg_files
    return (ExactColor(picture=picture) for picture in decode(payload, header.count, video))


def _show_next(sensor: SensorState, pictures: Iterator[ShownColor]) -> None:
    """Decode the next picture of a run; all of them at once might not fit into memory."""
    sensor.set_captured_color(next(pictures))


def _measured_depth(
    state: DecoderState, timeline: BatchTimeline, header: ResidualHeader, payload: bytes
) -> Iterator[FrameChange]:
    sensor = state.sensor(header)
    run = timeline.convey("RESIDUAL", header)
    camera = sensor.rig.depth
    samples = header.count * camera.width * camera.height
    if samples > MAX_SEQUENCE_SAMPLES:
        raise LimitExceeded(f"a RESIDUAL of {samples} samples is larger than the {MAX_SEQUENCE_SAMPLES} accepted")
    if state.wanted.depth:
        measured = MeasuredRun(header, payload, camera, sensor.header.depth_scale, state.wanted.threads)
        yield run.frames[0], partial(sensor.begin_measured_run, measured)


def _backdrop(
    state: DecoderState, timeline: BatchTimeline, header: BackdropHeader, payload: bytes
) -> Iterator[FrameChange]:
    yield header.frame, partial(_apply_backdrop, state, payload)


def _apply_backdrop(state: DecoderState, payload: bytes) -> None:
    camera = state.sensors[0].rig.color
    state.set_backdrop(decode_earlier_still(payload, camera.width, camera.height, state.header.gray))


def _background(
    state: DecoderState, timeline: BatchTimeline, header: BackgroundHeader, payload: bytes
) -> Iterator[FrameChange]:
    if header.codec != VideoCodec.AV1:
        raise UnsupportedVersion(
            f"the picture of the background is coded by codec {header.codec}, unknown to this version; use a newer 3dvc"
        )
    yield header.frame, partial(_apply_background, state, header, payload)


def _apply_background(state: DecoderState, header: BackgroundHeader, payload: bytes) -> None:
    camera = state.sensors[0].rig.color
    video = VideoFormat(
        width=camera.width,
        height=camera.height,
        bits=header.bits,
        magnified=header.magnified,
        gray=state.header.gray,
    )
    state.set_backdrop(decode_still(payload, video))


def _filters(
    state: DecoderState, timeline: BatchTimeline, header: FilterHeader, payload: bytes
) -> Iterator[FrameChange]:
    yield header.frame, partial(state.set_filters, decode_filter(payload, state.header.gray))


def _light(state: DecoderState, timeline: BatchTimeline, header: LightHeader, payload: bytes) -> Iterator[FrameChange]:
    state.object(header.object_id)
    yield header.frame, partial(state.set_light, header.object_id, unpack_light(payload))


def _order(state: DecoderState, timeline: BatchTimeline, header: OrderHeader, payload: bytes) -> Iterator[FrameChange]:
    yield header.frame, partial(state.set_cycle, header.frame, timeline.cycles[header.frame])


def _entry(
    header_type: type[H], handler: Callable[[DecoderState, BatchTimeline, H, bytes], Iterable[FrameChange]]
) -> tuple[type[Header], Handler]:
    """Return a row of the table of handlers, which a header of any type may be handed to."""

    def handle(state: DecoderState, timeline: BatchTimeline, header: Header, payload: bytes) -> Iterable[FrameChange]:
        if not isinstance(header, header_type):
            raise TypeError(f"a {type(header).__name__} was handed to the handler of {header_type.__name__}")
        return handler(state, timeline, header, payload)

    return header_type, handle


HANDLERS: Final[dict[type[Header], Handler]] = dict(
    (
        _entry(ObjectHeader, _add_object),
        _entry(ModelHeader, _update),
        _entry(ReliefHeader, _relief),
        _entry(TextureHeader, _texture),
        _entry(DepthHeader, _depth),
        _entry(PoseHeader, _poses),
        _entry(ShiftHeader, _shifts),
        _entry(GainHeader, _gains),
        _entry(ClockHeader, _clock),
        _entry(VideoHeader, _earlier_captured_depth),
        _entry(DepthVideoHeader, _captured_depth),
        _entry(ColorVideoHeader, _captured_color),
        _entry(ResidualHeader, _measured_depth),
        _entry(BackdropHeader, _backdrop),
        _entry(BackgroundHeader, _background),
        _entry(FilterHeader, _filters),
        _entry(LightHeader, _light),
        _entry(OrderHeader, _order),
    )
)
"""By type of header: all that may stand in a BATCH."""
