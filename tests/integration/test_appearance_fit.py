# SPDX-License-Identifier: MIT
"""What is fitted to the drawn pictures (colors, gains, light, poses, shifts, backdrop), and rates of whole streams."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.streams import ListSequence, drawn
from threedvc.coding.video.av1 import can_encode_av1
from threedvc.config import (
    AppearanceConfig,
    ColorVideo,
    EncoderConfig,
    Motion,
    Preset,
    RenderConfig,
    SegmentationConfig,
    SegmentationMode,
    Sensor,
    with_preset,
    with_quality,
)
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.appearance.appearance_fit import fit_appearance
from threedvc.encoder.appearance.photometric_alignment import aligned_shift
from threedvc.encoder.appearance.samples import Sampler
from threedvc.encoder.fusion.surface_extraction import extract_surface
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.rate.rate_control import stream_bytes
from threedvc.formats.container import StreamWriter
from threedvc.geometry.pose import Pose, compose, identity, inverse, make_pose, rotation_angle, rotation_from_vector
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer
from threedvc.stream.batch import unpack_batch
from threedvc.stream.packets import Packet, PacketType, type_name
from threedvc.stream.sensor_description import rig_of
from threedvc.synthesis import SyntheticSequence, make_scene

MASKS = SegmentationConfig(mode=SegmentationMode.MASKS)
THRESHOLD = SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0.0, far_m=1.2)
WHOLE = SegmentationConfig(mode=SegmentationMode.NONE)
SIZES = {"paper": (80, 80), "small room": (96, 72), "room": (128, 96), "objects": (128, 96)}
FILE = EncoderConfig(
    color_video=ColorVideo.OFF, threads=1, sensor=Sensor.IDEAL, motion=Motion.KNOWN, segmentation=WHOLE, batch_frames=4
)
FAST = with_preset(FILE, Preset.FAST)
PAPER = replace(FAST, segmentation=THRESHOLD)
needs_av1 = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1")
pytestmark = pytest.mark.usefixtures("quick_av1")


@cache
def scene(name: str, frames: int = 8) -> ListSequence:
    source = SyntheticSequence(make_scene(name.split()[-1], frames=60, size=SIZES[name]), threads=1)
    kept = [replace(source[index], index=index) for index in range(frames)]
    return ListSequence(kept, replace(source.info, frame_count=frames))


def members(packets: Iterable[Packet], kind: PacketType) -> list[Packet]:
    batches = [packet for packet in packets if packet.type == PacketType.BATCH]
    return [member for batch in batches for member in unpack_batch(batch) if member.type == kind]


def psnr(pictures: list[NDArray[np.uint8]], sequence: ListSequence) -> float:
    errors = [
        np.square(got.astype(float) - frame.color).mean() for got, frame in zip(pictures, sequence.frames, strict=True)
    ]
    return float(np.mean(10 * np.log10(255**2 / np.array(errors))))


def encoded(sequence: ListSequence, config: EncoderConfig) -> list[Packet]:
    return list(Encoder(sequence.info, config).packets(sequence))


@cache
def stream(name: str, config: EncoderConfig) -> list[Packet]:
    """Return the stream of a scene, encoded once."""
    return encoded(scene(name), config)


def test_fitted_colors_are_nearer_than_means() -> None:
    sequence = scene("small room")
    fitted = stream("small room", FAST)
    # Frames that can be read once only cannot be fitted to.
    means = list(Encoder(sequence.info, FAST).packets(iter(sequence.frames)))
    assert psnr(drawn(fitted), sequence) > psnr(drawn(means), sequence) + 0.3


def test_exposure_is_sent_as_gains() -> None:
    still = scene("small room")
    factors = [1.0, 0.8, 1.15, 0.9, 1.1, 0.85, 1.0, 0.75]
    frames = [
        replace(frame, color=np.clip(frame.color * factor + 6, 0, 255).astype(np.uint8))
        for frame, factor in zip(still.frames, factors, strict=True)
    ]
    sequence = ListSequence(frames, still.info)
    packets = encoded(sequence, FAST)
    assert members(packets, PacketType.GAIN)
    same = stream("small room", FAST)
    assert psnr(drawn(packets), sequence) > psnr(drawn(same), still) - 1.5
    assert sum(len(packet.payload) for packet in members(same, PacketType.GAIN)) < 10, "a steady exposure needs one"


@needs_av1
def test_a_background_at_rest_is_a_picture() -> None:
    sequence, packets = scene("paper"), stream("paper", PAPER)
    assert len(members(packets, PacketType.BACKGROUND)) == 1
    pictures = drawn(packets)
    background = np.all([frame.mask == 0 for frame in sequence.frames if frame.mask is not None], axis=0)
    for got, frame in zip(pictures, sequence.frames, strict=True):
        error = np.square(got.astype(float) - frame.color).mean(axis=2)[background].mean()
        assert 10 * np.log10(255**2 / error) > 28


@needs_av1
def test_a_rate_above_what_there_is_to_send_takes_the_finest_steps() -> None:
    sequence = scene("paper", 3)
    packets = encoded(sequence, replace(PAPER, bitrate_bps=4_000_000))
    assert members(packets, PacketType.BACKGROUND)
    assert psnr(drawn(packets), sequence) > 20


@needs_av1
def test_a_background_at_rest_gets_its_cells_from_a_picture() -> None:
    sequence, packets = scene("paper"), stream("paper", PAPER)
    pictures = members(packets, PacketType.DEPTH)
    assert len(pictures) == 1
    assert {member.header.get("o", 0) for member in members(packets, PacketType.MODEL)} == {1}
    plain = list(Encoder(sequence.info, PAPER).packets(iter(sequence.frames)))
    cells = sum(len(each.payload) for each in members(plain, PacketType.MODEL) if not each.header.get("o", 0))
    assert len(pictures[0].payload) < 0.8 * cells
    decoder = Decoder()
    for state in decoder.frames(packets):
        model = RenderModel(decoder.models[0])
        model.refresh(2)
        assert decoder.header is not None
        renderer = Renderer(rig_of(decoder.header), RenderConfig(threads=1))
        depth = renderer.draw({0: model}, {0: state.T_camera_object[0]}, color=False).depth
        frame = sequence.frames[state.index]
        assert frame.mask is not None
        wrong = np.abs(depth / np.maximum(frame.depth, 0.1) - 1)[(frame.mask == 0) & (frame.depth > 0)] > 0.01
        assert wrong.mean() < 0.05
    assert decoder.complete


def test_a_moving_camera_has_no_backdrop() -> None:
    packets = stream("small room", FAST)
    assert not members(packets, PacketType.BACKGROUND)
    assert not members(packets, PacketType.DEPTH)


@pytest.mark.long
def test_objects_that_turn_have_a_light() -> None:
    packets = encoded(scene("objects", 30), replace(FILE, segmentation=MASKS))
    lights = members(packets, PacketType.LIGHT)
    assert lights
    assert all(len(packet.payload) == 8 and packet.header["o"] > 0 for packet in lights)


def lit_anew(frames: int, change: int) -> ListSequence:
    """Return objects on which the lamps change places from frame `change` on, before a background that stays."""
    day = make_scene("objects", frames=60, size=SIZES["objects"])
    lamp, other = day.lights
    night = replace(day, lights=(replace(lamp, position=(0.2, 4.5, 0.6)), replace(other, position=lamp.position)))
    before, after = SyntheticSequence(day), SyntheticSequence(night)
    kept = []
    for index in range(frames):
        frame = before[index]
        if index >= change:
            assert frame.mask is not None
            color = np.where(frame.mask[..., None] > 0, after[index].color, frame.color)
            frame = replace(frame, color=color.astype(np.uint8))
        kept.append(frame)
    return ListSequence(kept, replace(before.info, frame_count=frames))


@pytest.mark.long
def test_a_light_that_changes_is_sent_when_it_does() -> None:
    change, config = 24, replace(FAST, segmentation=MASKS)
    errors = []
    for sequence in (lit_anew(40, change), lit_anew(40, 40)):
        packets = encoded(sequence, config)
        for number in (1, 2):
            starts = [light.header["f"] for light in members(packets, PacketType.LIGHT) if light.header["o"] == number]
            assert starts[0] == 0
            assert len(starts) <= 3
            assert (change in starts) == (not errors)
        pairs = zip(drawn(packets), sequence.frames, strict=True)
        squares = [np.square(got.astype(float) - frame.color)[frame.mask > 0].mean() for got, frame in pairs]
        errors.append(np.mean(squares[change:]))
    assert errors[0] < 1.3 * errors[1]


def wrong_poses(sequence: ListSequence) -> ListSequence:
    rng = np.random.default_rng(4)
    frames = []
    for frame in sequence.frames:
        assert frame.T_world_camera is not None
        away = make_pose(rotation_from_vector(rng.normal(0, 0.004, 3)), rng.normal(0, 0.008, 3))
        frames.append(replace(frame, T_world_camera=compose(frame.T_world_camera, away)))
    return ListSequence(frames, sequence.info)


def relative(poses: list[Pose]) -> list[Pose]:
    return [compose(inverse(poses[0]), pose) for pose in poses]


def scatter(found: list[Pose], sequence: ListSequence) -> tuple[float, float]:
    true = [frame.T_world_camera for frame in sequence.frames if frame.T_world_camera is not None]
    off = [compose(inverse(a), b) for a, b in zip(relative(true), relative(found), strict=True)]
    return (
        float(np.mean([np.linalg.norm(T[:3, 3]) for T in off])),
        float(np.mean([rotation_angle(T[:3, :3]) for T in off])),
    )


@pytest.mark.long
def test_wrong_camera_poses_are_put_right() -> None:
    true = scene("room", 16)
    given = wrong_poses(true)
    packets = encoded(given, replace(FILE, appearance=AppearanceConfig(rounds=3)))
    found = [state.T_world_camera for state in Decoder().frames(packets)]
    before = scatter([frame.T_world_camera for frame in given.frames if frame.T_world_camera is not None], true)
    after = scatter(found, true)
    assert after[0] < 0.6 * before[0]
    assert after[1] < 0.6 * before[1]


@pytest.mark.long
def test_a_color_picture_taken_later_is_found_by_its_shift() -> None:
    sequence = scene("room", 14)
    encoder = Encoder(sequence.info, FAST)
    list(encoder.packets(sequence))
    fitted = fit_appearance(encoder.scene, sequence).colors
    rig = sequence.info.rig
    for index in (2, 5, 9):
        frame, later = sequence.frames[index], sequence.frames[index + 4]
        assert frame.T_world_camera is not None
        assert later.T_world_camera is not None
        pose, true = inverse(frame.T_world_camera), inverse(later.T_world_camera)
        sample = Sampler(rig, 10_000, 2).sample(frame, fitted, {0: pose}, identity())
        luma = sample.luma(fitted)
        late = replace(frame, color=later.color)
        shift = identity()
        for _ in range(3):
            shift = aligned_shift(late, rig, pose, sample.points, luma, shift)

        def pixels(T: Pose, points: NDArray[np.float64] = sample.points) -> NDArray[np.float64]:
            return rig.color.project(points @ T[:3, :3].T + T[:3, 3])

        before, after = (
            np.median(np.linalg.norm(pixels(T) - pixels(true), axis=1)) for T in (pose, compose(shift, pose))
        )
        assert after < 0.7 * before


@pytest.mark.long
def test_hidden_cells_are_dropped_and_nothing_that_is_seen_goes() -> None:
    sequence = scene("room", 12)
    encoder = Encoder(sequence.info, FAST)
    list(encoder.packets(sequence))
    item = encoder.scene.objects[0]
    size, front = item.evidence.voxel_size_m, extract_surface(item.evidence, 2, smooth=True).cells
    # A wall of evidence that no frame can see: a copy of what is seen, set back by a meter.
    away = np.rint(np.array([0.0, 0.0, 1.0]) / size).astype(np.int32)
    T = item.poses[0]
    behind = front + np.rint(T[:3, :3].T @ away).astype(np.int32)
    evidence = item.evidence
    positions = evidence.index.locate(front)
    evidence.allocate(np.unique(behind >> 3, axis=0))
    there = evidence.index.locate(behind)
    free = evidence.distance_weight.reshape(-1)[there] == 0
    for values in (evidence.distance, evidence.distance_weight, evidence.log_odds):
        flat = values.reshape(-1)
        flat[there[free]] = flat[positions[free]]
    with_hidden = extract_surface(evidence, 2, smooth=True)
    kept = fit_appearance(encoder.scene, sequence).surfaces[0].cells
    known, hidden = ({tuple(cell) for cell in cells.tolist()} for cells in (front, behind[free]))
    read, left = ({tuple(cell) for cell in cells.tolist()} for cells in (with_hidden.cells, kept))
    assert left <= read
    assert len(known & left) > 0.97 * len(known)
    planted = (hidden & read) - known
    assert len(planted) > 100
    assert len(planted & left) < 0.4 * len(planted), "a third of them stand beside what is seen"


@pytest.mark.long
def test_what_is_seen_but_for_a_moment_is_not_hidden() -> None:
    moving = scene("room", 12)
    rng = np.random.default_rng(6)
    frames = []
    for index in range(40):
        # The first view for long, with a little noise, as else it would be a copy; at the end one from elsewhere.
        frame = moving.frames[11 if index == 39 else 0]
        noise = rng.integers(-1, 2, frame.color.shape)
        color = np.clip(frame.color.astype(int) + noise, 0, 255).astype(np.uint8)
        frames.append(replace(frame, index=index, timestamp_ns=index * 33_000_000, color=color))
    sequence = ListSequence(frames, replace(moving.info, frame_count=40))
    encoder = Encoder(sequence.info, FAST)
    list(encoder.packets(sequence))
    read = extract_surface(encoder.scene.objects[0].evidence, 2, smooth=True)
    late = read.first_seen == 39
    assert np.count_nonzero(late) > 100
    kept = fit_appearance(encoder.scene, sequence).surfaces[0]
    there = {tuple(cell) for cell in kept.cells.tolist()}
    assert np.mean([tuple(cell) in there for cell in read.cells[late].tolist()]) > 0.8


@pytest.mark.long
@pytest.mark.parametrize("motion", [Motion.KNOWN, Motion.TRACK])
def test_pictures_taken_when_the_depth_is_have_no_shifts(motion: Motion) -> None:
    assert not members(encoded(scene("room", 10), replace(FILE, motion=motion)), PacketType.SHIFT)


@pytest.mark.long
def test_pictures_taken_later_have_shifts_and_depth_keeps_its_poses() -> None:
    sequence = scene("room", 16)
    frames = [replace(frame, color=sequence.frames[frame.index + 3].color) for frame in sequence.frames[:-3]]
    late = ListSequence(frames, replace(sequence.info, frame_count=len(frames)))
    packets = encoded(late, FILE)
    assert members(packets, PacketType.SHIFT)
    decoder = Decoder()
    states = list(decoder.frames(packets))
    assert decoder.header is not None
    true = [frame.T_world_camera for frame in frames if frame.T_world_camera is not None]
    steps = [compose(inverse(a), b) for a, b in pairwise(true)]
    way = float(np.mean([np.linalg.norm(T[:3, 3]) for T in steps]))
    assert scatter([state.T_world_camera for state in states], late)[0] < 0.5 * way
    # On the picture, its own pose is nearer to that three frames later than the one of the depth is.
    rig, slopes = rig_of(decoder.header), late.info.rig.depth.rays()[8::16, 8::16].reshape(-1, 2)
    before, after = [], []
    for state, frame, T_true in zip(states, frames, true[3:], strict=False):
        z = frame.depth[8::16, 8::16].reshape(-1)
        seen = np.column_stack([slopes * z[:, None], z])[z > 0]
        assert frame.T_world_camera is not None
        T_late = compose(inverse(T_true), frame.T_world_camera)
        with_depth, shifted = rig.T_color_depth, compose(rig.T_color_depth, state.T_shifted_camera)
        wanted, one, other = (rig.color.project(seen @ T[:3, :3].T + T[:3, 3]) for T in (T_late, with_depth, shifted))
        before.append(np.median(np.linalg.norm(one - wanted, axis=1)))
        after.append(np.median(np.linalg.norm(other - wanted, axis=1)))
    assert np.median(after) < 0.85 * np.median(before)


LONG = pytest.mark.long


@pytest.mark.parametrize(
    ("rate", "frames"), [pytest.param(14e3, 30, marks=LONG), (50e3, 8), pytest.param(90e3, 30, marks=LONG)]
)
def test_a_file_meets_its_rate(rate: float, frames: int) -> None:
    sequence = scene("room", frames)
    packets = encoded(sequence, replace(FAST, bitrate_bps=rate))
    wanted = rate / 8 * frames / sequence.info.fps
    assert 0.95 * wanted < stream_bytes(packets) <= 1.02 * wanted


def test_quality_raises_bytes_and_psnr() -> None:
    sequence = scene("small room")
    made = [stream("small room", with_quality(FAST, quality)) for quality in (20, 50, 70)]
    sizes, values = [stream_bytes(packets) for packets in made], [psnr(drawn(packets), sequence) for packets in made]
    assert sizes == sorted(sizes)
    assert values == sorted(values)


@pytest.mark.parametrize(
    ("name", "segmentation", "rate", "group", "frames"),
    [
        ("small room", WHOLE, 14e3, 2, 16),
        ("small room", WHOLE, 8e3, 5, 20),
        ("objects", MASKS, 12e3, 3, 18),
    ],
    ids=["room", "room at the lowest rate", "objects"],
)
def test_a_live_stream_never_exceeds_its_rate(
    name: str, segmentation: SegmentationConfig, rate: float, group: int, frames: int
) -> None:
    sequence = scene(name, frames)
    config = replace(FILE, segmentation=segmentation, causal=True, batch_frames=group, bitrate_bps=rate)
    sink = io.BytesIO()
    writer = StreamWriter(sink)
    seconds = 0.0
    for packet in Encoder(sequence.info, config).packets(sequence):
        if packet.type == PacketType.BATCH:
            seconds = (packet.header["f"] + packet.header["n"]) / sequence.info.fps
            assert all(member.payload for member in unpack_batch(packet) if member.type == PacketType.MODEL)
        writer.write(packet)
        # Everything counts: the head of the file, STREAM, and at last INDEX and END.
        assert writer.offset <= rate / 8 * (seconds + config.live_buffer_s), f"{type_name(packet.type)} at {seconds} s"
    free = sum(len(packet.payload) for packet in encoded(sequence, replace(config, bitrate_bps=None)))
    assert free > writer.offset, "the rate must have been a limit"


def with_hole(sequence: ListSequence) -> ListSequence:
    """Return frames without depth in a part of the scene that all of them show."""
    frames = []
    for frame in sequence.frames:
        depth = frame.depth.copy()
        depth[22:53, 30:68] = 0
        frames.append(replace(frame, depth=depth))
    return ListSequence(frames, sequence.info)


def test_holes_in_depth_are_drawn_in_color_alone() -> None:
    sequence = with_hole(scene("small room"))
    packets = encoded(sequence, FAST)
    guessed = [packet.header["o"] for packet in members(packets, PacketType.OBJECT) if packet.header.get("g")]
    assert len(guessed) == 1
    assert not [packet for packet in members(packets, PacketType.POSE) if packet.header.get("o", 0) == guessed[0]]
    decoder = Decoder()
    state = next(iter(decoder.frames(packets)))
    shown = {number: RenderModel(model) for number, model in decoder.models.items()}
    for model in shown.values():
        model.refresh(1)
    renderer = Renderer(sequence.info.rig, RenderConfig(threads=1))
    whole = renderer.draw(shown, state.T_camera_object)
    without = renderer.draw(shown, {n: pose for n, pose in state.T_camera_object.items() if n not in guessed})
    np.testing.assert_array_equal(whole.depth, without.depth)
    np.testing.assert_array_equal(whole.labels, without.labels)
    hole = (slice(27, 48), slice(35, 63))
    wanted = sequence.frames[0].color[hole]
    errors = [np.square(each.color[hole].astype(float) - wanted).mean() for each in (whole, without)]
    assert errors[0] < 0.8 * errors[1]
    same = without.depth > 0
    assert np.mean(np.any(whole.color != without.color, axis=2)[same]) < 0.1


def test_a_scene_without_holes_needs_no_guess() -> None:
    packets = stream("paper", PAPER)
    assert not [packet for packet in members(packets, PacketType.OBJECT) if packet.header.get("g")]


@pytest.mark.parametrize("bits", [0, 1, 3])
def test_a_relief_goes_with_every_group_of_cells(bits: int) -> None:
    sequence = scene("small room", 4)
    fine = replace(FAST, batch_frames=2, appearance=replace(FAST.appearance, relief_bits=bits))
    packets = encoded(sequence, fine)
    updates = [packet for packet in members(packets, PacketType.MODEL) if packet.header.get("o", 0) == 0]
    assert len(updates) > 1
    assert len(members(packets, PacketType.RELIEF)) == (len(updates) if bits else 0)
    decoder = Decoder()
    assert len(list(decoder.frames(packets))) == len(sequence)
    assert (decoder.complete, decoder.models[0].relief_bits) == (True, bits)
