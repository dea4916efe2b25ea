# SPDX-License-Identifier: MIT
"""The decoder follows packets frame by frame and refuses what contradicts itself."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from threedvc.coding.color import ColorSettings
from threedvc.coding.poses import PoseCoder
from threedvc.coding.update import encode_update_with_result
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState, camera_poses
from threedvc.errors import CorruptStream, FormatError, LimitExceeded, TruncatedStream, UnsupportedVersion
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, compose, inverse, make_pose, rotation_from_vector
from threedvc.limits import MAX_COUNT, MAX_FRAME
from threedvc.model.decoded_model import DecodedModel, models_digest
from threedvc.model.model_update import ModelUpdate
from threedvc.stream.batch import pack_batch
from threedvc.stream.headers import (
    BatchHeader,
    ClockHeader,
    EndHeader,
    ModelHeader,
    ObjectHeader,
    PoseHeader,
    StreamHeader,
)
from threedvc.stream.notes.frame_report import FrameReport, report_packet
from threedvc.stream.packets import Packet
from threedvc.stream.pose_status import PoseStatus
from threedvc.stream.sensor_description import nearest_multiple, rig_of
from threedvc.stream.wire import pack_signed_varint

STEP = 0.001
STREAM = StreamHeader(
    color_camera=(8, 6, 10, 10, 3.5, 2.5, 0, 0, 0, 0, 0),
    depth_scale=1000.0,
    start_ns=5_000,
    period_num=100,
    period_den=3,
    translation_step_m=STEP,
    rotation_step_rad=STEP,
)
NO_CELLS, NO_COLORS = np.empty((0, 3), dtype=np.int32), np.empty((0, 3), dtype=np.int16)


def row_of_cells(start: int, count: int) -> NDArray[np.int32]:
    return np.stack([np.arange(start, start + count), np.zeros(count), np.zeros(count)], axis=1).astype(np.int32)


def changed(added: NDArray[np.int32] = NO_CELLS, removed: NDArray[np.int32] = NO_CELLS) -> ModelUpdate:
    colors = np.full((len(added), 3), 100, dtype=np.int16)
    return ModelUpdate(
        added=added, added_colors=colors, removed=removed, recolored=NO_CELLS, recolored_colors=NO_COLORS
    )


def place(index: int, z: float = 1.0) -> Pose:
    return make_pose(rotation_from_vector(np.array([0, 0.01 * index, 0])), np.array([0.02 * index, 0.0, z]))


class Author:
    """Writes packets as an encoder would, keeping its state."""

    def __init__(self) -> None:
        self.models: dict[int, DecodedModel] = {}
        self.coders: dict[int, PoseCoder] = {}
        self.due: dict[int, int] = {}

    def object(self, number: int) -> Packet:
        self.models[number] = DecodedModel(0.01)
        self.coders[number] = PoseCoder(STEP, STEP)
        return ObjectHeader(object_id=number, voxel_size_m=0.01).packet()

    def model(self, number: int, frame: int, update: ModelUpdate) -> Packet:
        model = self.models[number]
        payload, decoded = encode_update_with_result(update, *model.cells(), ColorSettings())
        model.apply(decoded)
        return ModelHeader(object_id=number, frame=frame).packet(payload)

    def poses(self, number: int, frame: int, poses: Sequence[Pose]) -> Packet:
        if frame != self.due.get(number, 0):
            self.coders[number].reset_velocity()
        self.due[number] = frame + len(poses)
        payload = self.coders[number].encode(poses)
        return PoseHeader(object_id=number, frame=frame, count=len(poses)).packet(payload)

    def end(self, frames: int) -> Packet:
        return EndHeader(frames=frames, digest=models_digest(self.models)).packet()


def batch(frame: int, count: int, *members: Packet) -> Packet:
    return pack_batch(BatchHeader(frame=frame, count=count), members)


def decoded(*packets: Packet, seen: Callable[[FrameState], None] = lambda state: None) -> Decoder:
    """Decode a stream whose STREAM is left out here, to its END."""
    decoder = Decoder()
    for state in decoder.frames([STREAM.packet(), *packets]):
        seen(state)
    return decoder


def states(decoder: Decoder, packets: Iterable[Packet]) -> list[FrameState]:
    return list(decoder.frames([STREAM.packet(), *packets]))


def assert_near(pose: Pose, expected: Pose) -> None:
    np.testing.assert_allclose(pose, expected, atol=2 * STEP)


def test_models_and_poses_are_those_of_the_frame() -> None:
    author = Author()
    first = [
        author.object(0),
        author.object(1),
        author.model(0, 0, changed(row_of_cells(0, 50))),
        author.model(1, 0, changed(row_of_cells(0, 20))),
        author.poses(1, 0, [place(0), place(1), place(2)]),
        author.model(1, 2, changed(row_of_cells(20, 10), row_of_cells(0, 5))),
    ]
    second = [author.poses(0, 4, [place(7, 0.0)]), author.poses(1, 3, [place(3), place(4)])]
    decoder, cells, found = Decoder(), list[tuple[int, int]](), list[FrameState]()
    for state in decoder.frames([STREAM.packet(), batch(0, 3, *first), batch(3, 2, *second), author.end(5)]):
        cells.append((decoder.models[0].cell_count, decoder.models[1].cell_count))
        found.append(state)
        assert decoder.frame_count == state.index + 1
    assert cells == [(50, 20), (50, 20), (50, 25), (50, 25), (50, 25)]
    assert [state.index for state in found] == [0, 1, 2, 3, 4]
    assert decoder.complete
    T_camera_world = [np.eye(4)] * 4 + [place(7, 0.0)]
    for state, T in zip(found, T_camera_world, strict=True):
        assert_near(state.T_world_camera, inverse(T))
        assert_near(state.T_camera_object[0], T)
        assert_near(state.T_camera_object[1], compose(T, place(state.index)))


def test_frames_without_a_batch_repeat_the_last_state() -> None:
    author = Author()
    start = [author.object(0), author.object(1), author.model(1, 1, changed(row_of_cells(0, 9)))]
    packets = [
        batch(1, 2, *start, author.poses(1, 1, [place(1), place(2)])),
        batch(6, 1, author.poses(1, 6, [place(6)])),
        author.end(9),
    ]
    found = states(Decoder(), packets)
    assert [state.index for state in found] == list(range(9))
    assert found[0].T_camera_object == {}
    for state, index in zip(found[1:], [1, 2, 2, 2, 2, 6, 6, 6], strict=True):
        assert_near(state.T_camera_object[1], place(index))


def test_a_gap_between_poses_is_a_rest() -> None:
    # After a rest the encoder predicts no motion; a decoder that did would be off by a step of 20 mm.
    author = Author()
    members = [
        author.object(0),
        author.poses(0, 0, [place(0), place(1), place(2)]),
        author.poses(0, 5, [place(2), place(3)]),
    ]
    found = states(Decoder(), [batch(0, 10, *members), author.end(10)])
    for state, index in zip(found, [0, 1, 2, 2, 2, 2, 3, 3, 3, 3], strict=True):
        assert_near(state.T_camera_object[0], place(index))


def test_times_are_nominal_unless_corrected() -> None:
    clock = ClockHeader(frame=2, count=3).packet(b"".join(map(pack_signed_varint, (-7, 0, 1 << 40))))
    author = Author()
    found = states(Decoder(), [batch(0, 6, author.object(0), clock), author.end(8)])
    nominal = [5000, 5033, 5067, 5100, 5133, 5167, 5200, 5233]
    nominal[2] -= 7
    nominal[4] += 1 << 40
    assert [state.timestamp_ns for state in found] == nominal


@given(st.integers(0, MAX_FRAME), st.integers(1, 10**15), st.integers(1, 10**9))
def test_nearest_multiple_rounds_halves_up(frame: int, num: int, den: int) -> None:
    assert nearest_multiple(frame, num, den) == int((Fraction(frame * num, den) + Fraction(1, 2)).__floor__())


def test_the_report_is_gathered_wherever_it_stands() -> None:
    told = [
        FrameReport(index=k, timestamp_ns=k, status=PoseStatus(s), entropy_bits=1024.0)
        for k, s in enumerate(["known", "lost", "weak"])
    ]
    author = Author()
    decoder = decoded(
        batch(0, 2, author.object(0), report_packet(told[:2])), batch(2, 1, report_packet(told[2:])), author.end(3)
    )
    assert decoder.report.status == ("known", "lost", "weak")
    assert decoder.report.entropy_bits == (1024.0, 1024.0, 1024.0)
    assert decoded(report_packet(told), Author().end(3)).report.status == ("known", "lost", "weak")
    assert decoded(Author().end(3), report_packet(told)).report.status == ()


def test_an_unbounded_report_keeps_its_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("threedvc.stream.notes.frame_report.MAX_COUNT", 5)
    told = [FrameReport(index=k, timestamp_ns=k, status=PoseStatus.KNOWN, entropy_bits=2.0**k) for k in range(4)]
    decoder = decoded(*[report_packet(told)] * 3, Author().end(0))
    assert decoder.report.entropy_bits == (1, 2, 4, 8, 1)
    assert len(decoder.report.status) == 5


def test_a_stream_without_end_is_truncated_after_its_frames() -> None:
    author = Author()
    packets = [batch(0, 2, author.object(0), author.model(0, 0, changed(row_of_cells(0, 4)))), batch(2, 1)]
    decoder, found = Decoder(), list[FrameState]()
    with pytest.raises(TruncatedStream, match="the stream ends after 3 frames, before its END packet"):
        found.extend(decoder.frames([STREAM.packet(), *packets]))
    assert (len(found), decoder.complete, decoder.models[0].cell_count) == (3, False, 4)


def test_unknown_ancillary_packets_are_passed_over() -> None:
    author = Author()
    private = Packet(type=0x93, payload=b"?", critical=False)
    assert decoded(batch(0, 1, author.object(0), private), author.end(1)).complete
    with pytest.raises(UnsupportedVersion, match="type 0x93"):
        decoded(batch(0, 1, author.object(0), replace(private, critical=True)))


def one_object() -> tuple[Author, Packet]:
    author = Author()
    return author, batch(0, 3, author.object(0), author.model(0, 0, changed(row_of_cells(0, 30))))


def contradictions() -> dict[str, tuple[list[Packet], str]]:
    author, start = one_object()
    foreign = ModelHeader(object_id=7, frame=3).packet()
    poses = author.poses(0, 4, [place(1)] * 3)
    return {
        "two STREAM packets": ([STREAM.packet()], "the stream has two STREAM packets"),
        "batch goes back": ([start, batch(2, 1)], "the BATCH of frame 2 comes after 3 frames"),
        "object introduced twice": ([start, batch(3, 1, author.object(0))], "object 0 is introduced twice"),
        "model of a stranger": ([start, batch(3, 1, foreign)], "names object 7, which was not introduced"),
        "pose of a stranger": (
            [start, batch(3, 1, PoseHeader(object_id=7, frame=3).packet(b""))],
            "names object 7, which was not introduced",
        ),
        "model outside the batch": (
            [start, batch(5, 1, ModelHeader(frame=3).packet())],
            "frame 3 stands in the BATCH of frames 5..5",
        ),
        "pose outside the batch": ([start, batch(3, 3, poses)], "frame 6 stands in the BATCH of frames 3..5"),
        "clock outside the batch": (
            [start, batch(3, 1, ClockHeader(frame=3, count=2).packet(b"\0\0"))],
            "frame 4 stands in the BATCH of frames 3..3",
        ),
        "clock too short": (
            [start, batch(3, 2, ClockHeader(frame=3, count=2).packet(b"\0"))],
            "1 bytes are wanted at byte 1",
        ),
        "clock too long": (
            [start, batch(3, 1, ClockHeader(frame=3).packet(b"\0\0"))],
            "1 bytes follow the corrections of CLOCK",
        ),
        "clock goes back": (
            [start, batch(3, 2, ClockHeader(frame=4).packet(b"\0"), ClockHeader(frame=3).packet(b"\0"))],
            "a CLOCK from frame 3 on follows one up to frame 4",
        ),
        "end too early": ([start, author.end(2)], "END tells of 2 frames, the stream conveyed 3"),
        "wrong digest": (
            [start, EndHeader(frames=3, digest=bytes(16)).packet()],
            "digest of the decoded models differs",
        ),
        "damaged update": ([start, batch(3, 1, ModelHeader(frame=3).packet(b"\xff" * 9))], "payload"),
        "damaged poses": ([start, batch(3, 1, PoseHeader(frame=3).packet(b"\xff" * 99))], "payload"),
        "MODEL outside a batch": ([start, ModelHeader(frame=3).packet()], "MODEL stands outside a BATCH"),
        "OBJECT outside a batch": (
            [ObjectHeader(object_id=0, voxel_size_m=1).packet()],
            "OBJECT stands outside a BATCH",
        ),
    }


@pytest.mark.parametrize("case", contradictions())
def test_contradictions_are_corrupt(case: str) -> None:
    packets, message = contradictions()[case]
    with pytest.raises(CorruptStream, match=message):
        decoded(*packets)


def test_an_update_that_does_not_fit_is_corrupt() -> None:
    author, start = one_object()
    packet = author.model(0, 3, changed(row_of_cells(30, 5), row_of_cells(0, 3)))
    with pytest.raises(CorruptStream):
        decoded(start, batch(3, 1, packet), batch(4, 1, replace(packet, header={"f": 4})), author.end(5))


def test_poses_of_an_object_do_not_go_back() -> None:
    author, start = one_object()
    twice = [author.poses(0, 4, [place(1), place(2)]), author.poses(0, 5, [place(3)])]
    with pytest.raises(CorruptStream, match="a POSE of object 0 from frame 5 on follows one up to frame 5"):
        decoded(start, batch(3, 3, *twice))


def test_nothing_can_come_before_stream() -> None:
    author, start = one_object()
    for packet in (start, author.end(0)):
        with pytest.raises(CorruptStream, match="before STREAM"):
            list(Decoder().frames([packet]))


def test_the_wrong_digest_comes_after_every_frame() -> None:
    _, start = one_object()
    decoder, found = Decoder(), list[FrameState]()
    with pytest.raises(CorruptStream, match="digest"):
        found.extend(decoder.frames([STREAM.packet(), start, EndHeader(frames=5, digest=bytes(16)).packet()]))
    assert (len(found), decoder.complete) == (5, False)


def rich_stream() -> list[tuple[BatchHeader, list[Packet]]]:
    """Return the batches of a stream with every kind of packet."""
    author = Author()
    told = [FrameReport(index=k, timestamp_ns=k, status=PoseStatus.WEAK, entropy_bits=3.0**k) for k in range(4)]
    first = [
        author.object(0),
        author.object(1),
        author.model(0, 0, changed(row_of_cells(-20, 90))),
        author.model(1, 1, changed(row_of_cells(5, 30))),
        author.poses(1, 0, [place(0), place(1)]),
        ClockHeader(frame=0, count=2).packet(b"\x03\x85\x01"),
    ]
    second = [
        author.model(0, 2, changed(row_of_cells(100, 9), row_of_cells(0, 4))),
        author.poses(1, 2, [place(5), place(9)]),
        report_packet(told),
    ]
    return [(BatchHeader(frame=0, count=2), first), (BatchHeader(frame=2, count=2), second)]


@given(st.data())
def test_damaged_packets_raise_only_format_errors(data: st.DataObject) -> None:
    stream = rich_stream()
    _, members = data.draw(st.sampled_from(stream))
    place_of = data.draw(st.integers(0, len(members) - 1))
    member = members[place_of]
    if data.draw(st.booleans()) and member.payload:
        at, bits = data.draw(st.integers(0, len(member.payload) - 1)), data.draw(st.integers(1, 255))
        damaged = bytearray(member.payload)
        damaged[at] ^= bits
        members[place_of] = replace(member, payload=bytes(damaged[: data.draw(st.integers(at + 1, len(damaged)))]))
    else:
        number = st.integers(-1, 1 << 33) | st.integers(0, 6)
        finite = st.floats(allow_nan=False, allow_infinity=False)
        key = data.draw(st.sampled_from(["o", "f", "n", "h", "k"]))
        members[place_of] = replace(
            member, header={**member.header, key: data.draw(number | finite | st.text(max_size=9))}
        )
    packets = [pack_batch(head, members) for head, members in stream]
    # END is missing on purpose: damage that decodes leaves a stream that is merely cut short.
    with pytest.raises(FormatError):
        decoded(*packets)


def test_updates_of_one_byte_raise_only_format_errors() -> None:
    _, start = one_object()
    for value in range(256):
        with pytest.raises(FormatError):
            decoded(start, batch(3, 1, ModelHeader(frame=3).packet(bytes([value]))))


@pytest.mark.parametrize("frame", [3 + MAX_COUNT + 1, MAX_FRAME])
def test_endless_rests_are_refused(frame: int) -> None:
    author, start = one_object()
    for packet in (batch(frame, 1), author.end(frame)):
        decoder = Decoder()
        with pytest.raises(
            LimitExceeded, match=f"frame {frame} .* 3 frames, at most {MAX_COUNT} may pass|{frame} frames"
        ):
            list(decoder.frames([STREAM.packet(), start, packet]))
        assert decoder.frame_count == 3


def test_a_long_rest_is_not_refused() -> None:
    author, start = one_object()
    found = decoded(start, batch(20_000, 1), author.end(30_000))
    assert (found.frame_count, found.complete) == (30_000, True)


def test_poses_of_a_batch_are_limited_before_memory_is_taken() -> None:
    author = Author()
    members = []
    for number in range(3):
        members += [
            author.object(number),
            PoseHeader(object_id=number, frame=0, count=MAX_COUNT // 2).packet(bytes(200)),
        ]
    packet = batch(0, MAX_COUNT, *members)
    tracemalloc.start()
    try:
        with pytest.raises(
            LimitExceeded, match=f"a BATCH holds {3 * (MAX_COUNT // 2)} poses, shifts and gains, at most {MAX_COUNT}"
        ):
            decoded(packet)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


def test_cameras_of_a_stream() -> None:
    rig = rig_of(STREAM)
    assert rig.registered
    assert rig.color == Camera(width=8, height=6, fx=10, fy=10, cx=3.5, cy=2.5)
    two = replace(
        STREAM, depth_camera=(4, 3, 5, 5, 1, 1, 0.1, 0, 0, 0, 0), T_color_depth=(1, 0, 0, 0.025, 0, 1, 0, 0, 0, 0, 1, 0)
    )
    rig = rig_of(two)
    assert (rig.color.width, rig.depth.width, rig.depth.distortion[0]) == (8, 4, 0.1)
    np.testing.assert_array_equal(rig.T_color_depth, make_pose(np.eye(3), np.array([0.025, 0, 0])))


def test_scripts_stand_for_poses_before_the_camera() -> None:
    T_camera_world, T_world_object = place(3), place(5, 2.0)
    poses = camera_poses({0: T_camera_world, 4: T_world_object})
    np.testing.assert_array_equal(poses[0], T_camera_world)
    np.testing.assert_allclose(poses[4], T_camera_world @ T_world_object, atol=1e-12)
    np.testing.assert_array_equal(camera_poses({4: T_world_object})[4], T_world_object)


def test_the_digest_depends_on_numbers_and_not_on_order() -> None:
    author = Author()
    for number in (1, 2):
        author.object(number)
        author.model(number, 0, changed(row_of_cells(number, 5)))
    one, two = author.models[1], author.models[2]
    assert models_digest({1: one, 2: two}) == models_digest({2: two, 1: one})
    assert (
        len(
            {
                models_digest({1: one, 2: two}),
                models_digest({1: two, 2: one}),
                models_digest({1: one}),
                models_digest({}),
            }
        )
        == 4
    )
