# SPDX-License-Identifier: MIT
"""The encoder against the decoder: what goes in comes out, and what does not change costs nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise, product

import numpy as np
import pytest

from helpers.streams import ListSequence
from threedvc.config import EncoderConfig, Motion, PoseConfig, SegmentationConfig, SegmentationMode, Sensor
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState
from threedvc.decoder.verification import verified
from threedvc.encoder.fusion.surface_extraction import extract_surface
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.rate.rate_control import stream_bytes
from threedvc.errors import ConfigError, CorruptStream, SequenceError
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import compose, inverse, make_pose, rotation_angle
from threedvc.model.decoded_model import models_digest
from threedvc.stream.batch import unpack_batch
from threedvc.stream.headers import BatchHeader, EndHeader, ModelHeader, PoseHeader, StreamHeader
from threedvc.stream.notes.frame_report import FrameReport
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.sensor_description import nearest_multiple
from threedvc.synthesis import SyntheticSequence, make_scene

THRESHOLD = SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0.0, far_m=1.2)
MASKS = SegmentationConfig(mode=SegmentationMode.MASKS)
WHOLE = SegmentationConfig(mode=SegmentationMode.NONE)
FRAMES = 9
STEPS = PoseConfig(translation_step_m=0.0005, rotation_step_rad=0.00025)
SIZES = {"paper": (56, 56), "objects": (96, 72), "room": (80, 60)}


@cache
def scene(name: str, frames: int = FRAMES, first: int = 0) -> ListSequence:
    """Return frames of a synthetic scene, rendered once."""
    source = SyntheticSequence(make_scene(name, frames=first + frames, size=SIZES[name]))
    kept = [replace(source[first + index], index=index) for index in range(frames)]
    return ListSequence(kept, replace(source.info, frame_count=frames))


def config(**changes: object) -> EncoderConfig:
    """Return a configuration for tests: small groups, the exact sensor, no second pass."""
    values = {
        "batch_frames": 4,
        "threads": 1,
        "sensor": Sensor.IDEAL,
        "refine": False,
        "motion": Motion.KNOWN,
        "pose": STEPS,
    }
    return EncoderConfig(**{**values, **changes})  # type: ignore[arg-type]


def encoded(sequence: ListSequence, settings: EncoderConfig) -> tuple[Encoder, list[Packet]]:
    encoder = Encoder(sequence.info, settings)
    return encoder, list(encoder.packets(sequence))


def decoded(packets: Iterable[Packet]) -> tuple[Decoder, list[FrameState]]:
    decoder = Decoder()
    return decoder, list(decoder.frames(packets))


def pose_headers(packets: Sequence[Packet]) -> list[PoseHeader]:
    """Return the headers of all POSE packets."""
    every = (member for group in batches(packets).values() for member in group)
    return [PoseHeader.from_map(member.header) for member in every if member.type == PacketType.POSE]


def batches(packets: Sequence[Packet]) -> dict[int, list[Packet]]:
    """Return the members of every batch by its first frame."""
    return {
        BatchHeader.from_map(packet.header).frame: unpack_batch(packet)
        for packet in packets
        if packet.type == PacketType.BATCH
    }


def size_of(packets: Iterable[Packet]) -> int:
    return sum(len(packet.payload) for packet in packets)


def posed_frames(packets: Sequence[Packet], number: int) -> list[int]:
    heads = [PoseHeader.from_map(m.header) for ms in batches(packets).values() for m in ms if m.type == PacketType.POSE]
    return [head.frame + step for head in heads if head.object_id == number for step in range(head.count)]


ROUND_TRIPS = {
    "paper, threshold, known": ("paper", {"segmentation": THRESHOLD}),
    "paper, threshold, tracked": ("paper", {"segmentation": THRESHOLD, "motion": Motion.TRACK}),
    "paper, masks, known": ("paper", {"segmentation": MASKS}),
    "objects, masks, known": ("objects", {"segmentation": MASKS}),
    "room, whole, known": ("room", {"segmentation": WHOLE}),
    "room, whole, tracked": ("room", {"segmentation": WHOLE, "motion": Motion.TRACK}),
    "room, whole, known, live": ("room", {"segmentation": WHOLE, "causal": True}),
    "objects, masks, known, live": ("objects", {"segmentation": MASKS, "causal": True}),
    "paper, refined": ("paper", {"segmentation": THRESHOLD, "motion": Motion.TRACK, "refine": True}),
}


@pytest.mark.parametrize("case", ROUND_TRIPS)
def test_round_trip(case: str) -> None:
    name, changes = ROUND_TRIPS[case]
    sequence = scene(name)
    encoder, packets = encoded(sequence, config(**changes))
    decoder, states = decoded(packets)
    assert decoder.complete
    assert [state.timestamp_ns for state in states] == [frame.timestamp_ns for frame in sequence]
    measured = [number for number, model in sorted(decoder.models.items()) if not model.guessed]
    assert measured == sorted(encoder.scene.objects)
    assert all(model.cell_count > 30 for model in decoder.models.values())
    assert decoder.report.status == tuple(report.status for report in encoder.reports)
    for state in states:
        for number, item in encoder.scene.objects.items():
            error = compose(inverse(item.poses[state.index]), state.T_camera_object[number])
            assert rotation_angle(error) < 0.002
            assert np.abs(error[:3, 3]).max() < 0.004


@pytest.mark.parametrize(("name", "segmentation"), [("paper", THRESHOLD), ("objects", MASKS), ("room", WHOLE)])
def test_known_poses_come_back(name: str, segmentation: SegmentationConfig) -> None:
    sequence = scene(name)
    _, states = decoded(encoded(sequence, config(segmentation=segmentation))[1])
    for frame, state in zip(sequence, states, strict=True):
        if frame.T_world_camera is not None:
            np.testing.assert_allclose(state.T_world_camera, frame.T_world_camera, atol=0.002)
        for number, pose in frame.T_camera_object.items():
            np.testing.assert_allclose(state.T_camera_object[number], pose, atol=0.002)


def test_tracked_motion_is_that_of_the_camera() -> None:
    sequence = scene("room")
    _, states = decoded(encoded(sequence, config(motion=Motion.TRACK))[1])
    start = sequence[0].T_world_camera
    assert start is not None
    for frame, state in zip(sequence, states, strict=True):
        assert frame.T_world_camera is not None
        moved = compose(inverse(start), frame.T_world_camera)
        error = compose(inverse(moved), state.T_world_camera)
        assert rotation_angle(error) < 0.01
        assert np.linalg.norm(error[:3, 3]) < 0.02


@pytest.mark.parametrize("causal", [False, True])
def test_model_cells_lie_on_the_surface(causal: bool) -> None:
    sequence = scene("room")
    decoder, _ = decoded(encoded(sequence, config(causal=causal))[1])
    model = decoder.models[0]
    cells, _ = model.cells()
    points = (cells + 0.5) * model.voxel_size_m
    distances = []
    for frame in sequence:
        assert frame.T_world_camera is not None
        T = inverse(frame.T_world_camera)
        there = points @ T[:3, :3].T + T[:3, 3]
        there = there[there[:, 2] > 0.1]
        u, v = np.rint(sequence.info.rig.depth.project(there)).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < frame.depth.shape[1]) & (v < frame.depth.shape[0])
        distances.append(there[inside, 2] - frame.depth[v[inside], u[inside]])
    # Cells may be hidden behind others (beyond the reading) but hardly ever stand before what was measured.
    before = np.concatenate(distances) < -2 * model.voxel_size_m
    assert np.mean(before) < 0.02


# --- What does not change costs nothing ------------------------------------------------------------------------------


def repeated(sequence: ListSequence, index: int, count: int) -> ListSequence:
    """Return a sequence that goes up to a frame and shows it `count` more times."""
    last, period = sequence[index], 1e9 / sequence.info.fps
    more = [replace(last, index=index + k, timestamp_ns=round((index + k) * period)) for k in range(1, count + 1)]
    return ListSequence([*sequence.frames[: index + 1], *more], replace(sequence.info, frame_count=index + 1 + count))


def without_reports(members: Iterable[Packet]) -> list[Packet]:
    return [member for member in members if member.type != PacketType.META]


@pytest.mark.parametrize(("name", "segmentation"), [("paper", THRESHOLD), ("room", WHOLE)])
def test_a_standing_picture_costs_no_packet(name: str, segmentation: SegmentationConfig) -> None:
    sequence = repeated(scene(name), 0, 19)
    _, packets = encoded(sequence, config(segmentation=segmentation))
    later = {frame: without_reports(members) for frame, members in batches(packets).items() if frame}
    assert not any(later.values())
    assert len(decoded(packets)[1]) == 20


def test_repeating_the_last_frame_costs_only_the_report() -> None:
    sizes = {}
    for count in (0, 8, 40):
        sequence = repeated(scene("paper"), FRAMES - 1, count)
        _, packets = encoded(sequence, config(segmentation=THRESHOLD))
        posed = posed_frames(packets, 1)
        assert max(posed) <= FRAMES - 1
        content = batches(packets)
        sizes[count] = size_of(without_reports(member for members in content.values() for member in members))
        # Nothing stands after the moving part but the batch with the report.
        assert sum(frame >= FRAMES for frame in content) <= 1
    # What the model knows of the last view settles, so a few cells may differ.
    assert abs(sizes[40] - sizes[8]) <= 0.1 * sizes[0]


def test_live_a_standing_picture_settles() -> None:
    sequence = repeated(scene("room"), 0, 29)
    _, packets = encoded(sequence, config(causal=True, batch_frames=1))
    decoder, contents = Decoder(), list[dict[tuple[int, ...], tuple[int, ...]]]()
    for _ in decoder.frames(packets):
        cells, colors = decoder.models[0].cells()
        contents.append(dict(zip(map(tuple, cells.tolist()), map(tuple, colors.tolist()), strict=True)))
    # Confidence grows from frame to frame, but nothing is sent twice.
    for before, after in pairwise(contents):
        assert before.items() <= after.items()
    assert len(contents[15]) > 0.98 * len(contents[-1])


def test_live_what_stops_falls_silent() -> None:
    sequence = repeated(scene("paper"), FRAMES - 1, 50)
    _, packets = encoded(sequence, config(segmentation=THRESHOLD, causal=True, batch_frames=1))
    assert max(posed_frames(packets, 1)) == FRAMES - 1
    updates = {frame: size_of(without_reports(members)) for frame, members in batches(packets).items()}
    assert sum(size for frame, size in updates.items() if frame > FRAMES + 20) < 0.06 * sum(updates.values())


def test_an_object_that_rests_has_no_poses_while_others_move() -> None:
    # Object 1 stands still from frame 45 of the scene on, objects 2 and 3 do not.
    sequence = scene("objects", 8, first=46)
    _, packets = encoded(sequence, config(segmentation=MASKS))
    assert posed_frames(packets, 0) == []
    assert posed_frames(packets, 1) == [0]
    for number in (2, 3):
        assert posed_frames(packets, number) == list(range(8))


def test_later_groups_send_only_what_they_see_first() -> None:
    sequence = scene("room")
    _, packets = encoded(sequence, config())
    frames = [
        (frame, ModelHeader.from_map(member.header).frame, len(member.payload))
        for frame, members in batches(packets).items()
        for member in members
        if member.type == PacketType.MODEL
    ]
    assert [frame for frame, _, _ in frames] == [at for _, at, _ in frames]
    assert frames[0][2] > sum(size for _, _, size in frames[1:])


# --- Order of packets, reports, determinism --------------------------------------------------------------------------


def test_packets_come_in_order() -> None:
    _, packets = encoded(scene("room"), config())
    kinds = [packet.type for packet in packets]
    assert (kinds[0], kinds[-1]) == (PacketType.STREAM, PacketType.END)
    assert set(kinds[1:-1]) == {PacketType.BATCH}
    assert list(batches(packets)) == [0, 4, 8]
    assert EndHeader.from_map(packets[-1].header).frames == FRAMES


def test_the_stream_header_tells_of_the_input() -> None:
    sequence = scene("paper")
    header = StreamHeader.from_map(encoded(sequence, config(segmentation=THRESHOLD))[1][0].header)
    assert (header.name, header.grey, header.given_world, header.depth_scale) == ("paper", True, False, 1000.0)
    assert header.color_camera[:2] == SIZES["paper"]
    assert header.depth_camera == header.T_color_depth == ()
    assert StreamHeader.from_map(encoded(scene("room"), config())[1][0].header).given_world


def test_the_digest_in_end_is_that_of_the_decoded_models() -> None:
    packets = encoded(scene("paper"), config(segmentation=THRESHOLD))[1]
    decoder, _ = decoded(packets)
    assert EndHeader.from_map(packets[-1].header).digest == models_digest(decoder.models)


@pytest.mark.parametrize("causal", [False, True])
def test_bytes_do_not_depend_on_threads_or_runs(causal: bool) -> None:
    settings = config(segmentation=THRESHOLD, motion=Motion.TRACK, causal=causal)
    streams = [encoded(scene("paper"), replace(settings, threads=threads))[1] for threads in (1, 3, 1)]
    assert streams[0] == streams[1] == streams[2]


def test_every_frame_is_reported_and_entropy_is_told() -> None:
    told: list[FrameReport] = []
    sequence = scene("paper")
    encoder = Encoder(sequence.info, config(segmentation=THRESHOLD))
    packets = list(encoder.packets(sequence, told.append))
    assert [report.index for report in told] == list(range(FRAMES))
    assert encoder.reports == told
    assert all(report.entropy_bits > 0 for report in told)
    decoder, _ = decoded(packets)
    np.testing.assert_allclose(decoder.report.entropy_bits, [report.entropy_bits for report in told], rtol=0.02)


def test_an_irregular_clock_comes_back_exactly() -> None:
    sequence = scene("paper", 5)
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.integers(1, 10**8, 5)) + 1_650_000_000_123_456_789
    frames = [replace(frame, timestamp_ns=int(time)) for frame, time in zip(sequence, times, strict=True)]
    _, states = decoded(encoded(ListSequence(frames, sequence.info), config(segmentation=THRESHOLD))[1])
    assert [state.timestamp_ns for state in states] == times.tolist()


# --- Live encoding ---------------------------------------------------------------------------------------------------


def test_live_batches_come_while_frames_still_arrive() -> None:
    sequence, taken = scene("room"), list[int]()

    def camera() -> Iterator[Frame]:
        for frame in sequence:
            taken.append(frame.index)
            yield frame

    encoder = Encoder(sequence.info, config(causal=True, batch_frames=2))
    seen = [(packet.type, len(taken)) for packet in encoder.packets(camera())]
    arrivals = [count for kind, count in seen if kind == PacketType.BATCH]
    # A group goes out as soon as the first frame after it shows that it is not the last.
    assert arrivals == [3, 5, 7, 9, 9]


def test_live_and_file_encoding_arrive_at_nearly_the_same_cells() -> None:
    models = [decoded(encoded(scene("room"), config(causal=causal))[1])[0].models[0] for causal in (False, True)]
    cells = [model.cells()[0] for model in models]
    # Files straighten what was measured seldom, by less than a cell; live, unsure cells are not sent.
    around = np.array(list(product((-1, 0, 1), repeat=3)), dtype=np.int32)
    for own, other, least in ((0, 1, 0.9), (1, 0, 0.97)):
        there = {tuple(cell) for cell in (cells[other][:, None] + around).reshape(-1, 3).tolist()}
        near = np.mean([tuple(cell) in there for cell in cells[own].tolist()])
        assert near > least


def test_live_cells_are_those_of_the_evidence() -> None:
    encoder = Encoder(scene("room").info, config(causal=True))
    model = decoded(list(encoder.packets(scene("room"))))[0].models[0]
    read = extract_surface(encoder.scene.objects[0].evidence, 2)
    there = {tuple(cell) for cell in read.cells.tolist()}
    assert np.mean([tuple(cell) in there for cell in model.cells()[0].tolist()]) > 0.7


@pytest.mark.long
@pytest.mark.parametrize("motion", [Motion.KNOWN, pytest.param(Motion.TRACK, marks=pytest.mark.long)])
def test_repeating_the_last_frame_costs_next_to_nothing(motion: Motion) -> None:
    sequence = scene("room")
    last, fps = sequence.frames[-1], int(sequence.info.fps)
    again = [
        replace(last, index=index, timestamp_ns=nearest_multiple(index, 10**9, fps))
        for index in range(last.index + 1, last.index + 101)
    ]
    sizes = []
    for frames in (sequence.frames, [*sequence.frames, *again]):
        encoder = Encoder(sequence.info, EncoderConfig(motion=motion, threads=1))
        sizes.append(stream_bytes(list(encoder.packets(ListSequence(frames, sequence.info)))))
    assert sizes[1] - sizes[0] < 100


def test_refining_needs_frames_that_can_be_read_again() -> None:
    sequence = scene("paper")
    settings = config(segmentation=THRESHOLD, motion=Motion.TRACK, refine=True)
    once = Encoder(sequence.info, settings)
    assert decoded(list(once.packets(iter(sequence))))[0].complete


# --- Bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("causal", [False, True])
def test_no_frames(causal: bool) -> None:
    with pytest.raises(SequenceError, match="paper has no frames"):
        list(Encoder(scene("paper").info, config(causal=causal)).packets([]))


def test_no_depth_at_all() -> None:
    sequence = scene("paper", 3)
    blind = [replace(frame, depth=np.zeros_like(frame.depth)) for frame in sequence]
    with pytest.raises(SequenceError, match="paper: no frame has a depth measurement that could be used"):
        list(Encoder(sequence.info, config(segmentation=THRESHOLD)).packets(blind))


def test_known_motion_needs_poses() -> None:
    sequence = scene("room", 2)
    info = replace(sequence.info, has_camera_poses=False)
    with pytest.raises(
        ConfigError, match=r"room has no poses for object 0; give poses.txt or .*, or use --motion track"
    ):
        list(Encoder(info, config()).packets(sequence))


@pytest.mark.parametrize("motion", [Motion.KNOWN, Motion.TRACK])
def test_a_frame_without_depth_is_passed_over(motion: Motion) -> None:
    sequence = scene("room")
    frames = list(sequence)
    frames[4] = replace(frames[4], depth=np.zeros_like(frames[4].depth))
    encoder, packets = encoded(ListSequence(frames, sequence.info), config(motion=motion))
    decoder, states = decoded(packets)
    assert decoder.complete
    assert len(states) == FRAMES
    if motion is Motion.TRACK:
        true = inverse(frames[0].T_world_camera) @ frames[4].T_world_camera
        np.testing.assert_allclose(states[4].T_world_camera, true, atol=0.05)
    assert encoder.reports[-1].status != "lost"


def test_a_frame_that_does_not_fit_is_lost_and_not_fused() -> None:
    sequence = scene("room")
    frames = list(sequence)
    rng = np.random.default_rng(2)
    clutter = rng.uniform(0.5, 4.0, frames[4].depth.shape).astype(np.float32)
    frames[4] = replace(frames[4], depth=clutter, color=rng.integers(0, 256, frames[4].color.shape, dtype=np.uint8))
    disturbed, packets = encoded(ListSequence(frames, sequence.info), config(motion=Motion.TRACK))
    assert disturbed.reports[4].status == "lost"
    assert [report.index for report in disturbed.reports if report.status == "lost"] == [4]
    decoder, _ = decoded(packets)
    clean, _ = decoded(encoded(sequence, config(motion=Motion.TRACK))[1])
    cells = [{tuple(cell) for cell in each.models[0].cells()[0].tolist()} for each in (decoder, clean)]
    assert len(cells[0] & cells[1]) > 0.85 * max(map(len, cells))


def test_measurements_beyond_the_limit_are_ignored() -> None:
    sequence = scene("room", 3)
    decoder, _ = decoded(encoded(sequence, config(max_depth_m=1.8))[1])
    cells, _ = decoder.models[0].cells()
    points = (cells + 0.5) * decoder.models[0].voxel_size_m
    for frame in sequence:
        assert frame.T_world_camera is not None
        T = inverse(frame.T_world_camera)
        assert (points @ T[2, :3] + T[2, 3]).max() < 2.1


def test_cells_have_the_size_asked_for() -> None:
    for size in (0.03, 0.08):
        decoder, _ = decoded(encoded(scene("room", 2), config(voxel_size_m=size))[1])
        assert decoder.models[0].voxel_size_m == size


def test_two_cameras_survive_the_stream() -> None:
    sequence = scene("room", 2)
    shifted = make_pose(np.eye(3), np.array([0.02, 0.0, 0.0]))
    depth = replace(sequence.info.rig.depth, distortion=(0.05, 0.0, 0.0, 0.0, 0.0))
    rig = CameraRig(color=sequence.info.rig.color, depth=depth, T_color_depth=shifted)
    packets = encoded(ListSequence(list(sequence), replace(sequence.info, rig=rig)), config())[1]
    header = StreamHeader.from_map(packets[0].header)
    assert header.depth_camera[6] == 0.05
    assert header.T_color_depth == tuple(shifted[:3].ravel())


# --- Verification ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("causal", [False, True])
def test_verification_passes_packets_on(causal: bool) -> None:
    sequence = scene("paper")
    settings = config(segmentation=THRESHOLD, causal=causal)
    plain = encoded(sequence, settings)[1]
    assert list(verified(Encoder(sequence.info, settings).packets(sequence))) == plain


def test_verification_fails_where_the_decoder_would() -> None:
    packets = encoded(scene("paper"), config(segmentation=THRESHOLD))[1]
    wrong_end = [*packets[:-1], replace(packets[-1], header={**packets[-1].header, "d": bytes(16)})]
    with pytest.raises(CorruptStream, match="digest"):
        list(verified(wrong_end))
    damaged = replace(packets[1], payload=packets[1].payload[:-9])
    with pytest.raises(CorruptStream):
        list(verified([packets[0], damaged, *packets[2:]]))


def test_live_a_rest_costs_next_to_nothing() -> None:
    room = scene("room")
    settled, rested = (
        encoded(repeated(room, FRAMES - 1, count), config(causal=True, batch_frames=10))[1] for count in (30, 330)
    )
    assert stream_bytes(rested) - stream_bytes(settled) < 100
    decoder = Decoder()
    assert sum(1 for _ in decoder.frames(rested)) == FRAMES + 330
    assert decoder.report is not None
    assert len(decoder.report.status) == FRAMES + 330


@pytest.mark.parametrize("refine", [False, True])
def test_a_tracked_camera_that_only_trembles_stands_still(refine: bool) -> None:
    rng = np.random.default_rng(5)
    still = [
        replace(frame, depth=(frame.depth * (1 + rng.normal(0, 0.004, frame.depth.shape))).astype(np.float32))
        for frame in [scene("room")[0]] * 6
    ]
    frames = [
        replace(frame, index=k, timestamp_ns=k * 33_333_333, T_world_camera=None) for k, frame in enumerate(still)
    ]
    info = replace(scene("room").info, has_camera_poses=False, frame_count=len(frames))
    settings = config(motion=Motion.TRACK, sensor=Sensor.KINECT1, refine=refine)
    encoder, packets = encoded(ListSequence(frames, info), settings)
    assert encoder.scene.objects[0].at_rest
    assert not pose_headers(packets)


def test_a_tracked_camera_that_moves_does_not_rest() -> None:
    encoder, packets = encoded(scene("room"), config(motion=Motion.TRACK))
    assert not encoder.scene.objects[0].at_rest
    assert pose_headers(packets)
