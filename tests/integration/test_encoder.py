# SPDX-License-Identifier: MIT
"""The encoder against the decoder: what goes in comes out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from helpers.encoded_scenes import FRAMES, MASKS, SIZES, THRESHOLD, batches, config, decoded, encoded, scene, stream
from helpers.streams import ListSequence
from threedvc.config import Motion
from threedvc.decoder.verification import verified
from threedvc.encoder.fusion.surface_extraction import extract_surface
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.errors import ConfigError, CorruptStream, SequenceError
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import compose, inverse, make_pose, rotation_angle
from threedvc.model.decoded_model import models_digest
from threedvc.stream.headers import EndHeader, ModelHeader, StreamHeader
from threedvc.stream.notes.frame_report import FrameReport
from threedvc.stream.packets import PacketType

pytestmark = pytest.mark.usefixtures("quick_av1")

ROUND_TRIPS = {
    "paper, threshold, known": ("paper", {}),
    "paper, threshold, tracked": ("paper", {"motion": Motion.TRACK}),
    "paper, masks, known": ("paper", {"segmentation": MASKS}),
    "objects, masks, known": ("objects", {}),
    "room, whole, known": ("room", {}),
    "room, whole, tracked": ("room", {"motion": Motion.TRACK}),
    "room, whole, known, live": ("room", {"causal": True}),
    "objects, masks, known, live": ("objects", {"causal": True}),
    "paper, refined": ("paper", {"motion": Motion.TRACK, "refine": True}),
}


@pytest.mark.parametrize("case", ROUND_TRIPS)
def test_round_trip(case: str) -> None:
    name, changes = ROUND_TRIPS[case]
    sequence = scene(name)
    encoder, packets = stream(name, **changes)
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


@pytest.mark.parametrize("name", SIZES)
def test_known_poses_come_back(name: str) -> None:
    sequence = scene(name)
    _, states = decoded(stream(name)[1])
    for frame, state in zip(sequence, states, strict=True):
        if frame.T_world_camera is not None:
            np.testing.assert_allclose(state.T_world_camera, frame.T_world_camera, atol=0.002)
        for number, pose in frame.T_camera_object.items():
            np.testing.assert_allclose(state.T_camera_object[number], pose, atol=0.002)


def test_tracked_motion_is_that_of_the_camera() -> None:
    sequence = scene("room")
    _, states = decoded(stream("room", motion=Motion.TRACK)[1])
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
    decoder, _ = decoded(stream("room", causal=causal)[1])
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


# --- Order of packets, reports, determinism --------------------------------------------------------------------------


def test_later_groups_send_only_what_they_see_first() -> None:
    _, packets = stream("room")
    frames = [
        (frame, ModelHeader.from_map(member.header).frame, len(member.payload))
        for frame, members in batches(packets).items()
        for member in members
        if member.type == PacketType.MODEL
    ]
    assert [frame for frame, _, _ in frames] == [at for _, at, _ in frames]
    assert frames[0][2] > sum(size for _, _, size in frames[1:])


def test_packets_come_in_order() -> None:
    _, packets = stream("room")
    kinds = [packet.type for packet in packets]
    assert (kinds[0], kinds[-1]) == (PacketType.STREAM, PacketType.END)
    assert set(kinds[1:-1]) == {PacketType.BATCH}
    assert list(batches(packets)) == [0, 3, 6]
    assert EndHeader.from_map(packets[-1].header).frames == FRAMES


def test_the_stream_header_tells_of_the_input() -> None:
    header = StreamHeader.from_map(stream("paper")[1][0].header)
    assert (header.name, header.gray, header.given_world, header.depth_scale) == ("paper", True, False, 1000.0)
    assert header.color_camera[:2] == SIZES["paper"]
    assert header.depth_camera == header.T_color_depth == ()
    assert StreamHeader.from_map(stream("room")[1][0].header).given_world


def test_the_digest_in_end_is_that_of_the_decoded_models() -> None:
    _, packets = stream("paper")
    decoder, _ = decoded(packets)
    assert EndHeader.from_map(packets[-1].header).digest == models_digest(decoder.models)


@pytest.mark.parametrize("causal", [False, True])
def test_bytes_do_not_depend_on_threads_or_runs(causal: bool) -> None:
    settings = config(segmentation=THRESHOLD, motion=Motion.TRACK, causal=causal, threads=3)
    again = encoded(scene("paper"), settings)[1]
    assert again == stream("paper", motion=Motion.TRACK, causal=causal)[1]


def test_every_frame_is_reported_and_entropy_is_told() -> None:
    told: list[FrameReport] = []
    sequence = scene("room", 4)
    encoder = Encoder(sequence.info, config())
    packets = list(encoder.packets(sequence, told.append))
    assert [report.index for report in told] == list(range(4))
    assert encoder.reports == told
    assert all(report.entropy_bits > 0 for report in told)
    decoder, _ = decoded(packets)
    np.testing.assert_allclose(decoder.report.entropy_bits, [report.entropy_bits for report in told], rtol=0.02)


def test_an_irregular_clock_comes_back_exactly() -> None:
    sequence = scene("room", 4)
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.integers(1, 10**8, 4)) + 1_650_000_000_123_456_789
    frames = [replace(frame, timestamp_ns=int(time)) for frame, time in zip(sequence, times, strict=True)]
    _, states = decoded(encoded(ListSequence(frames, sequence.info), config())[1])
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
    assert arrivals == [3, 5, 7, 7]


@pytest.mark.parametrize(("latency_s", "frames"), [(0.1, 3), (0.13, 3), (0.2, 6)])
def test_live_no_frame_waits_longer_than_the_latency(latency_s: float, frames: int) -> None:
    sequence = scene("room")
    encoder = Encoder(sequence.info, config(causal=True, batch_frames=None, latency_s=latency_s))
    batches = [each.header for each in encoder.packets(iter(sequence)) if each.type == PacketType.BATCH]
    assert [header["n"] for header in batches] == [frames] * (len(sequence) // frames) + [len(sequence) % frames]
    assert encoder.latency_s is not None
    assert encoder.latency_s >= frames / sequence.info.fps - 1e-6


def test_live_and_file_encoding_arrive_at_nearly_the_same_cells() -> None:
    models = [decoded(stream("room", causal=causal)[1])[0].models[0] for causal in (False, True)]
    cells = [model.cells()[0] for model in models]
    # Files straighten what was measured seldom, by less than a cell; live, unsure cells are not sent.
    around = np.array(list(product((-1, 0, 1), repeat=3)), dtype=np.int32)
    for own, other, least in ((0, 1, 0.9), (1, 0, 0.97)):
        there = {tuple(cell) for cell in (cells[other][:, None] + around).reshape(-1, 3).tolist()}
        near = np.mean([tuple(cell) in there for cell in cells[own].tolist()])
        assert near > least


def test_live_cells_are_those_of_the_evidence() -> None:
    encoder, packets = stream("room", causal=True)
    model = decoded(packets)[0].models[0]
    read = extract_surface(encoder.scene.objects[0].evidence, 2)
    there = {tuple(cell) for cell in read.cells.tolist()}
    assert np.mean([tuple(cell) in there for cell in model.cells()[0].tolist()]) > 0.7


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
    sequence = scene("room", 6)
    frames = list(sequence)
    frames[4] = replace(frames[4], depth=np.zeros_like(frames[4].depth))
    encoder, packets = encoded(ListSequence(frames, sequence.info), config(motion=motion))
    decoder, states = decoded(packets)
    assert decoder.complete
    assert len(states) == 6
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
    clean, _ = decoded(stream("room", motion=Motion.TRACK)[1])
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
    for size in (0.05, 0.08):
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
    plain = stream("paper", causal=causal)[1]
    assert list(verified(Encoder(sequence.info, settings).packets(sequence))) == plain


def test_verification_fails_where_the_decoder_would() -> None:
    _, packets = stream("paper")
    wrong_end = [*packets[:-1], replace(packets[-1], header={**packets[-1].header, "d": bytes(16)})]
    with pytest.raises(CorruptStream, match="digest"):
        list(verified(wrong_end))
    damaged = replace(packets[1], payload=packets[1].payload[:-9])
    with pytest.raises(CorruptStream):
        list(verified([packets[0], damaged, *packets[2:]]))
