# SPDX-License-Identifier: MIT
"""Encoding and decoding whole sequences: pictures, choices, and streams that end too early."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import threedvc
from helpers.streams import ListSequence, packed_stream
from threedvc.config import EncoderConfig, Motion, RenderConfig, SegmentationConfig, SegmentationMode, Sensor
from threedvc.errors import ConfigError, CorruptStream, FormatError, OutputError, SequenceError, TruncatedStream
from threedvc.formats.container import StreamReader
from threedvc.formats.decoding import DecodedFrame, decode, open_stream
from threedvc.formats.encoding import encode
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import compose, identity, make_pose, rotation_from_vector
from threedvc.metrics.picture_quality import psnr
from threedvc.stream.headers import BatchHeader
from threedvc.stream.notes.frame_report import FrameReport
from threedvc.stream.packets import PacketType
from threedvc.synthesis import SyntheticSequence, make_scene

FRAMES = 8
LIVE = EncoderConfig(
    causal=True, batch_frames=2, motion=Motion.KNOWN, sensor=Sensor.IDEAL, threads=1,
    segmentation=SegmentationConfig(mode=SegmentationMode.MASKS),
)  # fmt: skip
FILE = replace(LIVE, causal=False, refine=False)
ONE_THREAD = RenderConfig(threads=1)
pytestmark = pytest.mark.usefixtures("quick_av1")


@pytest.fixture(scope="module")
def sequence() -> ListSequence:
    source = SyntheticSequence(make_scene("objects", frames=FRAMES, size=(96, 72)), threads=1)
    return ListSequence(list(source), source.info)


@pytest.fixture(scope="module")
def stream(sequence: ListSequence, quick_av1: None) -> bytes:
    sink = io.BytesIO()
    encode(sequence, sink, FILE)
    return sink.getvalue()


@pytest.fixture(scope="module")
def frames(stream: bytes) -> list[DecodedFrame]:
    return list(decode(io.BytesIO(stream), render=ONE_THREAD))


def batch_ends(stream: bytes) -> dict[int, int]:
    """Return the number of frames that are complete at the byte where each batch ends."""
    records = StreamReader(io.BytesIO(stream), "s").records()
    return {
        record.offset + record.size: BatchHeader.from_map(record.packet.header).stop
        for record in records
        if record.packet.type == PacketType.BATCH
    }


def all_until_error(source: Path | io.BytesIO) -> tuple[list[DecodedFrame], FormatError]:
    """Return the frames that come before the error, and the error."""
    found: list[DecodedFrame] = []
    with pytest.raises(FormatError) as caught:
        found.extend(decode(source, what=frozenset({"depth"}), render=ONE_THREAD))
    return found, caught.value


# --- Pictures --------------------------------------------------------------------------------------------------------


def test_decoded_frames_look_like_the_input(sequence: ListSequence, frames: list[DecodedFrame]) -> None:
    assert [frame.index for frame in frames] == list(range(FRAMES))
    for given, drawn in zip(sequence, frames, strict=True):
        assert drawn.timestamp_ns == given.timestamp_ns
        assert (drawn.color.dtype, drawn.depth.dtype, drawn.labels.dtype) == (np.uint8, np.float32, np.uint8)
        assert drawn.color.shape == given.color.shape
        assert psnr(drawn.color, given.color) > 15
        valid = given.depth > 0
        assert np.mean(drawn.depth[valid] > 0) > 0.95
        assert np.mean(np.abs(drawn.depth - given.depth)[valid] < 0.01 * given.depth[valid]) > 0.7
        for number, pose in given.T_camera_object.items():
            np.testing.assert_allclose(drawn.T_camera_object[number], pose, atol=0.004)


def test_labels_are_those_of_the_masks(sequence: ListSequence, frames: list[DecodedFrame]) -> None:
    for given, drawn in zip(sequence, frames, strict=True):
        assert given.mask is not None
        for number in (1, 2, 3):
            there, here = given.mask == number, drawn.labels == number
            assert np.count_nonzero(there & here) > 0.6 * np.count_nonzero(there | here)


def test_pictures_do_not_depend_on_threads(stream: bytes, frames: list[DecodedFrame]) -> None:
    for one, two in zip(frames, decode(io.BytesIO(stream), render=RenderConfig(threads=2)), strict=True):
        for name in ("color", "depth", "labels"):
            assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


def test_a_range_of_frames(stream: bytes, frames: list[DecodedFrame]) -> None:
    part = list(decode(io.BytesIO(stream), frames=(3, 6), render=ONE_THREAD))
    assert [frame.index for frame in part] == [3, 4, 5]
    for one, two in zip(part, frames[3:6], strict=True):
        np.testing.assert_array_equal(one.color, two.color)
    assert [frame.index for frame in decode(io.BytesIO(stream), frames=(6, None), render=ONE_THREAD)] == [6, 7]


def test_a_range_beyond_the_stream(stream: bytes) -> None:
    with pytest.raises(ConfigError, match=f"frame {FRAMES} is beyond the stream, which has {FRAMES} frames"):
        list(decode(io.BytesIO(stream), frames=(FRAMES, None)))


def test_other_sizes_show_the_same(stream: bytes, frames: list[DecodedFrame]) -> None:
    opened = open_stream(io.BytesIO(stream), size=(48, 36), render=ONE_THREAD)
    assert (opened.info.rig.color.width, opened.info.rig.depth.height) == (48, 36)
    small = next(iter(opened))
    assert small.color.shape == (36, 48, 3)
    assert small.depth.shape == small.labels.shape == (36, 48)
    halved = frames[0].color.reshape(36, 2, 48, 2, 3).mean(axis=(1, 3))
    assert psnr(small.color, np.rint(halved).astype(np.uint8)) > 20


def test_without_color_depth_is_the_same(stream: bytes, frames: list[DecodedFrame]) -> None:
    first = next(iter(decode(io.BytesIO(stream), what=frozenset({"depth"}), render=ONE_THREAD)))
    np.testing.assert_array_equal(first.depth, frames[0].depth)
    assert not first.color.any()


def test_chosen_objects_are_drawn_alone(stream: bytes, frames: list[DecodedFrame]) -> None:
    first = next(iter(decode(io.BytesIO(stream), objects=[2], render=ONE_THREAD)))
    assert set(np.unique(first.labels)) <= {0, 2}
    seen = frames[0].labels == 2
    np.testing.assert_array_equal(first.depth[seen], frames[0].depth[seen])
    assert np.mean(first.depth == 0) > 0.8
    nothing = next(iter(decode(io.BytesIO(stream), objects=[], render=ONE_THREAD)))
    assert not nothing.depth.any()


def test_a_camera_path_shows_the_world_from_elsewhere(stream: bytes, frames: list[DecodedFrame]) -> None:
    still = list(decode(io.BytesIO(stream), camera_path=[frames[0].T_world_camera], render=ONE_THREAD))
    np.testing.assert_array_equal(still[0].depth, frames[0].depth)
    nearer = compose(frames[0].T_world_camera, make_pose(np.eye(3), np.array([0, 0, 0.3])))
    turned = compose(frames[0].T_world_camera, make_pose(rotation_from_vector(np.array([0, 0, np.pi])), np.zeros(3)))
    path = list(decode(io.BytesIO(stream), camera_path=[nearer, turned], render=ONE_THREAD))
    assert len(path) == FRAMES
    middle = (slice(30, 42), slice(40, 56))
    assert np.median(frames[0].depth[middle] - path[0].depth[middle]) == pytest.approx(0.3, abs=0.05)
    np.testing.assert_allclose(path[0].T_world_camera, nearer)
    # The last pose holds for the rest; upside down, the picture is too.
    np.testing.assert_allclose(path[5].T_world_camera, turned)
    flipped = path[1].depth[::-1, ::-1]
    assert np.median(np.abs(flipped - frames[1].depth)) < 0.01


def test_a_camera_path_needs_poses(stream: bytes) -> None:
    with pytest.raises(ConfigError, match="the camera path has no poses"):
        open_stream(io.BytesIO(stream), camera_path=[])


def test_the_stream_describes_itself(stream: bytes, sequence: ListSequence) -> None:
    info = open_stream(io.BytesIO(stream)).info
    assert (info.name, info.depth_scale, info.frame_count, info.gray) == ("objects", 1000.0, None, False)
    assert info.fps == pytest.approx(sequence.info.fps)
    assert info.rig.color == sequence.info.rig.color
    assert info.rig.registered
    assert not open_stream(io.BytesIO(stream), what=frozenset({"color"})).info.has_masks


def test_two_cameras_are_drawn_apart(sequence: ListSequence) -> None:
    shifted = make_pose(np.eye(3), np.array([0.05, 0.0, 0.0]))
    rig = replace(sequence.info.rig, color=sequence.info.rig.color.resized(120, 90), T_color_depth=shifted)
    wide = [replace(frame, color=np.repeat(np.repeat(frame.color, 2, 0), 2, 1)[:90, :120]) for frame in sequence]
    sink = io.BytesIO()
    encode(ListSequence(wide[:2], replace(sequence.info, rig=rig)), sink, LIVE)
    drawn = next(iter(decode(io.BytesIO(sink.getvalue()), render=ONE_THREAD)))
    assert (drawn.color.shape, drawn.depth.shape) == ((90, 120, 3), (72, 96))


# --- Reports and files -----------------------------------------------------------------------------------------------


def test_the_report_of_encoding(sequence: ListSequence, tmp_path: Path) -> None:
    seen: list[FrameReport] = []
    path = tmp_path / "o.3dvc"
    report = encode(sequence, path, LIVE, verify=True, on_frame=seen.append)
    assert report.file_bytes == path.stat().st_size
    assert (report.frames, len(report), len(seen)) == (FRAMES, FRAMES, FRAMES)
    assert report[0].index == 0
    assert [frame.status for frame in report[2:4]] == ["known", "known"]
    assert report.lost_frames == ()
    assert report.duration_s == pytest.approx(FRAMES / sequence.info.fps)
    assert report.voxel_size_m > 0
    opened = open_stream(path)
    assert len(list(opened)) == FRAMES
    assert opened.decoder.complete
    # Live, bytes go out while frames come in.
    sizes = [frame.bytes_so_far for frame in seen]
    assert sizes == sorted(sizes)
    assert sizes[-1] > sizes[0]


def test_names_of_the_package_are_these(stream: bytes) -> None:
    assert (threedvc.encode, threedvc.decode, threedvc.open_stream) == (encode, decode, open_stream)
    assert next(iter(threedvc.decode(io.BytesIO(stream)))).index == 0


def test_missing_input_and_impossible_output(sequence: ListSequence, tmp_path: Path) -> None:
    with pytest.raises(SequenceError, match="nowhere"):
        encode(tmp_path / "nowhere", tmp_path / "o.3dvc")
    with pytest.raises(OutputError, match="cannot be written"):
        encode(sequence, tmp_path / "no" / "o.3dvc", LIVE)
    with pytest.raises(FormatError, match=r"missing\.3dvc: cannot be opened"):
        open_stream(tmp_path / "missing.3dvc")
    assert list(tmp_path.iterdir()) == []


# --- Streams that end too early --------------------------------------------------------------------------------------


def test_a_stream_cut_after_a_batch_decodes_up_to_it(stream: bytes, frames: list[DecodedFrame]) -> None:
    for end, count in batch_ends(stream).items():
        for cut in (end, end + 5):
            found, error = all_until_error(io.BytesIO(stream[:cut]))
            assert isinstance(error, TruncatedStream)
            assert len(found) == count
            assert f"with {count} frames could be read" in str(error)
            np.testing.assert_array_equal(found[-1].depth, frames[count - 1].depth)


def test_a_stream_cut_before_its_first_batch(stream: bytes) -> None:
    for cut in (0, 5, 12, 40):
        with pytest.raises(FormatError):
            list(decode(io.BytesIO(stream[:cut])))


class Unplugged(BaseException):
    """Stands for what ends a program from outside."""


def test_a_live_encoder_that_dies_leaves_what_it_had_sent(sequence: ListSequence, tmp_path: Path) -> None:
    path, part = tmp_path / "o.3dvc", tmp_path / "o.3dvc.part"

    def dying() -> Iterator[Frame]:
        yield from sequence.frames[:6]
        raise Unplugged

    class Dying(ListSequence):
        def __iter__(self) -> Iterator[Frame]:
            return dying()

    with pytest.raises(Unplugged) as caught:
        encode(Dying(sequence.frames, sequence.info), path, LIVE)
    assert caught.value.__notes__ == [f"kept {part}: 4 frames can be decoded"]
    assert not path.exists()
    found, error = all_until_error(part)
    assert len(found) == 4
    assert str(error).startswith(f"{part}: ends at byte")


def test_a_live_stream_can_be_read_at_any_moment(sequence: ListSequence, tmp_path: Path) -> None:
    path = tmp_path / "o.3dvc"
    readable: list[int] = []

    def look(report: FrameReport) -> None:
        if report.index >= 3:
            found, error = all_until_error(path.with_name("o.3dvc.part"))
            assert isinstance(error, TruncatedStream)
            readable.append(len(found))

    encode(sequence, path, LIVE, on_frame=look)
    assert readable == [2, 4, 4, 6, 6]
    assert [child.name for child in tmp_path.iterdir()] == ["o.3dvc"]


def test_a_file_encoder_that_dies_leaves_nothing(sequence: ListSequence, tmp_path: Path) -> None:
    def stop(report: FrameReport) -> None:
        if report.index == 5:
            raise Unplugged

    with pytest.raises(Unplugged):
        encode(sequence, tmp_path / "o.3dvc", FILE, on_frame=stop)
    assert list(tmp_path.iterdir()) == []


def damaged_file(folder: Path, data: bytes) -> Path:
    path = folder / "d.3dvc"
    path.write_bytes(data)
    return path


def test_errors_name_the_file_once(tmp_path: Path) -> None:
    good = packed_stream()
    cases: dict[str, tuple[bytes, type[FormatError]]] = {
        "digest": (packed_stream(drifted=True), CorruptStream),
        "cut": (good[:-60], TruncatedStream),
        "without end": (packed_stream(ended=False), TruncatedStream),
        "flipped": (good[:200] + bytes([good[200] ^ 1]) + good[201:], CorruptStream),
    }
    for data, kind in cases.values():
        path = damaged_file(tmp_path, data)
        _, error = all_until_error(path)
        assert isinstance(error, kind)
        assert str(error).startswith(f"{path}: ")
        assert str(error).count(str(path)) == 1
        assert "\n" not in str(error)


def test_a_file_is_closed_when_iteration_stops_early(stream: bytes, tmp_path: Path) -> None:
    path = damaged_file(tmp_path, stream)
    opened = decode(path, render=ONE_THREAD)
    next(opened)
    opened.close()  # type: ignore[attr-defined]
    path.unlink()


def gray_pictures(count: int, shape: tuple[int, int]) -> list[NDArray[np.uint8]]:
    rng = np.random.default_rng(1)
    return [np.repeat(rng.integers(0, 256, (*shape, 1), dtype=np.uint8), 3, axis=2) for _ in range(count)]


def test_gray_input_gives_gray_pictures() -> None:
    small = SyntheticSequence(make_scene("objects", frames=2, size=(48, 36)), threads=1)
    pictures = gray_pictures(2, small[0].depth.shape)
    gray = [replace(frame, color=picture) for frame, picture in zip(small, pictures, strict=True)]
    sink = io.BytesIO()
    encode(ListSequence(gray, replace(small.info, gray=True)), sink, FILE)
    for frame in decode(io.BytesIO(sink.getvalue()), render=ONE_THREAD):
        np.testing.assert_array_equal(frame.color[..., 0], frame.color[..., 1])
        np.testing.assert_array_equal(frame.color[..., 0], frame.color[..., 2])


def test_the_world_is_the_first_camera_where_no_poses_are_given(frames: list[DecodedFrame]) -> None:
    np.testing.assert_array_equal(frames[0].T_world_camera, identity())
