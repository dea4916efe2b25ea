# SPDX-License-Identifier: MIT
"""Depth as filmed: what its samples show, when it is worth its bytes, and its way through a stream."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import threedvc
from streams import ListSequence
from threedvc.coding.picture_sequence import can_decode_sequences, can_encode_sequences, encode_sequence
from threedvc.config import DepthVideo, EncoderConfig, Motion, RenderConfig
from threedvc.decoder import Decoder
from threedvc.depth_video import EDGE, FilmedDepth, depth_levels
from threedvc.encoder import Encoder, verified
from threedvc.errors import CorruptStream
from threedvc.packets import BatchHeader, Packet, PacketType, VideoHeader, pack_batch, unpack_batch
from threedvc.rate_control import stream_bytes
from threedvc.synthesis import SyntheticSequence, make_scene
from wobbling_room import wobbling

with_video = pytest.mark.skipif(
    not (can_encode_sequences() and can_decode_sequences()), reason="these builds of Pillow and OpenCV have no AVIF"
)
FRAMES = 12
LEVELS = depth_levels(0.5, 1.01)
CONFIG = EncoderConfig(motion=Motion.KNOWN, depth_video=DepthVideo.ON, refine=False, threads=2)


def filmed(samples: NDArray[np.uint8], *, complete: bool = True) -> FilmedDepth:
    return FilmedDepth(samples=samples, levels=LEVELS, complete=complete)


def test_levels_rise_by_their_ratio() -> None:
    assert LEVELS.shape == (256,)
    np.testing.assert_allclose(LEVELS, 0.5 * 1.01 ** np.arange(256), rtol=1e-12)


def test_samples_of_full_size_are_shown_as_they_are(rng: np.random.Generator) -> None:
    samples = (100 + rng.integers(0, 5, (30, 40))).astype(np.uint8)
    shown = filmed(samples).shown(np.zeros((30, 40), dtype=np.float32), 2)
    np.testing.assert_allclose(shown, LEVELS[samples], rtol=1e-6)


def test_a_slope_stays_straight_when_magnified() -> None:
    samples = np.tile(np.arange(60, 100, 2, dtype=np.uint8), (16, 1))
    shown = filmed(samples).shown(np.zeros((64, 80), dtype=np.float32), 1)
    middle = np.log(shown[20, 8:-8] / 0.5) / np.log(1.01)
    np.testing.assert_allclose(np.diff(middle), 0.5, atol=0.01)
    np.testing.assert_array_equal(shown[8:-8], np.tile(shown[20], (48, 1)))


def test_depth_does_not_depend_on_the_threads(rng: np.random.Generator) -> None:
    samples = rng.integers(0, 256, (17, 23)).astype(np.uint8)
    drawn = rng.uniform(0.5, 5, (51, 70)).astype(np.float32)
    np.testing.assert_array_equal(filmed(samples).shown(drawn, 1), filmed(samples).shown(drawn, 5))


def test_where_surfaces_meet_the_models_tell_where() -> None:
    samples = np.full((20, 20), 50, dtype=np.uint8)
    samples[:, 10:] = 120
    near, far = LEVELS[50], LEVELS[120]
    assert far > EDGE * near
    drawn = np.where(np.arange(80) < 41, near * 1.001, far * 0.999).astype(np.float32)[None].repeat(80, axis=0)
    shown = filmed(samples).shown(drawn, 2)
    np.testing.assert_array_equal(shown[:, 38:42], drawn[:, 38:42])
    np.testing.assert_allclose(shown[:, :30], near, rtol=1e-6)
    # What is drawn off both surfaces is no witness.
    wrong = filmed(samples).shown(np.full_like(drawn, 10 * far), 2)
    assert wrong.max() < 1.1 * far


@pytest.mark.parametrize("complete", [False, True])
def test_what_is_not_drawn_is_shown_if_the_video_is_complete(complete: bool) -> None:
    drawn = np.full((20, 20), 0.8, dtype=np.float32)
    drawn[5:9] = 0
    shown = filmed(np.full((5, 5), 30, dtype=np.uint8), complete=complete).shown(drawn, 1)
    assert (shown[5:9] > 0).all() == complete
    assert (shown[10:] > 0).all()


def video_of(packets: list[Packet]) -> list[Packet]:
    members = [member for packet in packets if packet.type == PacketType.BATCH for member in unpack_batch(packet)]
    return [member for member in members if member.type == PacketType.VIDEO]


def saved(sequence: ListSequence, config: EncoderConfig, path: Path) -> Path:
    threedvc.encode(sequence, path, config)
    return path


def within_one_per_cent(path: Path, sequence: ListSequence, render: RenderConfig | None = None) -> float:
    shares = []
    for drawn, given in zip(threedvc.decode(path, render=render), sequence, strict=True):
        valid = given.depth > 0
        shares.append(np.mean(np.abs(drawn.depth - given.depth)[valid] <= 0.01 * given.depth[valid]))
    return float(np.mean(shares))


@with_video
def test_a_video_shows_depth_that_no_rigid_model_can(tmp_path: Path) -> None:
    sequence = wobbling(FRAMES)
    path = saved(sequence, CONFIG, tmp_path / "with.3dvc")
    models = within_one_per_cent(path, sequence, RenderConfig(filmed_depth=False, threads=2))
    assert within_one_per_cent(path, sequence) > max(0.6, 1.8 * models)
    without = saved(sequence, replace(CONFIG, depth_video=DepthVideo.OFF), tmp_path / "without.3dvc")
    assert within_one_per_cent(without, sequence) == pytest.approx(models, abs=1e-9)


@with_video
def test_groups_of_frames_have_a_video_each() -> None:
    sequence = wobbling(FRAMES)
    encoder = Encoder(sequence.info, replace(CONFIG, group_frames=5))
    packets = list(verified(encoder.packets(sequence)))
    headers = [VideoHeader.from_map(member.header) for member in video_of(packets)]
    assert [(header.frame, header.count) for header in headers] == [(0, 5), (5, 5), (10, 2)]
    assert not any(member.critical for member in video_of(packets))
    states = list(Decoder().frames(packets))
    assert all(state.filmed is not None for state in states)


@with_video
@pytest.mark.parametrize("noise", ["ideal", "kinect"])
def test_rigid_depth_gets_none(noise: str) -> None:
    source = SyntheticSequence(make_scene("room", frames=FRAMES, size=(96, 72)), noise, seed=3)
    sequence = ListSequence(list(source), source.info)
    encoder = Encoder(sequence.info, replace(CONFIG, depth_video=DepthVideo.AUTO, refine=True))
    assert not video_of(list(encoder.packets(sequence)))


@with_video
def test_a_rate_is_met_with_a_video() -> None:
    sequence = wobbling(FRAMES)
    rate = 120_000.0
    encoder = Encoder(sequence.info, replace(CONFIG, bitrate_bps=rate))
    packets = list(encoder.packets(sequence))
    assert video_of(packets)
    assert stream_bytes(packets) <= rate * FRAMES / sequence.info.fps / 8


@with_video
def test_other_views_show_the_models(tmp_path: Path) -> None:
    sequence = wobbling(FRAMES)
    path = saved(sequence, CONFIG, tmp_path / "a.3dvc")
    models = [frame.depth for frame in threedvc.decode(path, render=RenderConfig(filmed_depth=False, threads=2))]
    film = [frame.depth for frame in threedvc.decode(path)]
    alone = [frame.depth for frame in threedvc.decode(path, objects=[0])]
    there = [frame.T_world_camera for frame in threedvc.decode(path)]
    again = [frame.depth for frame in threedvc.decode(path, camera_path=there)]
    assert not np.array_equal(film[3], models[3])
    np.testing.assert_array_equal(alone[3], models[3])
    np.testing.assert_allclose(again[3], models[3], atol=1e-3)
    larger = [frame.depth for frame in threedvc.decode(path, size=(192, 144))]
    assert np.mean(np.abs(larger[3][::2, ::2] - film[3]) < 0.01 * film[3]) > 0.9


@with_video
def test_a_video_of_the_wrong_frames_is_refused() -> None:
    sequence = wobbling(FRAMES)
    packets = list(Encoder(sequence.info, CONFIG).packets(sequence))
    (video,) = video_of(packets)

    def told(header: VideoHeader, payload: bytes) -> None:
        def changed(packet: Packet) -> Packet:
            members = [
                header.packet(payload, critical=False) if member.type == PacketType.VIDEO else member
                for member in unpack_batch(packet)
            ]
            return pack_batch(BatchHeader.from_map(packet.header), members)

        list(Decoder().frames(changed(each) if each.type == PacketType.BATCH else each for each in packets))

    header = VideoHeader.from_map(video.header)
    told(header, video.payload)
    with pytest.raises(CorruptStream):
        told(replace(header, count=FRAMES + 1), video.payload)
    with pytest.raises(CorruptStream):
        told(replace(header, count=FRAMES - 1), video.payload)
    with pytest.raises(CorruptStream):
        told(replace(header, columns=header.columns + 1), video.payload)
    with pytest.raises(CorruptStream, match="names sensor 3"):
        told(replace(header, sensor=3), video.payload)
    with pytest.raises(CorruptStream):
        told(header, video.payload[: len(video.payload) // 2])
    blank = encode_sequence(np.full((FRAMES, header.rows, header.columns), 9, dtype=np.uint8), 50)
    told(header, blank)
