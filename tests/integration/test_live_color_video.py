# SPDX-License-Identifier: MIT
"""Live streams whose colors are a video, batch by batch."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

import threedvc
from threedvc.coding.video.av1 import can_encode_av1
from threedvc.config import ColorVideo, EncoderConfig, Motion, VideoConfig
from threedvc.decoder.replay import replay
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.formats.container import open_output
from threedvc.frames.multi_sensor import MergedSequence
from threedvc.geometry.pose import identity
from threedvc.metrics.picture_quality import psnr
from threedvc.stream.batch import unpack_batch
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import Packet, PacketType, VideoCodec
from threedvc.synthesis import SyntheticSequence, make_scene

pytestmark = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV cannot write AV1")
FRAMES, BATCH = 14, 6
LIVE = EncoderConfig(
    causal=True,
    motion=Motion.KNOWN,
    batch_frames=BATCH,
    video=VideoConfig(coarseness=40, preset=10),
    threads=1,
)


@cache
def sequence() -> SyntheticSequence:
    return SyntheticSequence(make_scene("room", frames=FRAMES, size=(96, 72)))


@cache
def packets(config: EncoderConfig) -> list[Packet]:
    """Frames come once, and no frame is asked for before the packets of those before it are out."""
    return list(Encoder(sequence().info, config).packets(iter(sequence())))


def members(stream: list[Packet], kind: PacketType) -> list[list[Packet]]:
    """Return the members of a kind, by BATCH."""
    batches = [packet for packet in stream if packet.type == PacketType.BATCH]
    return [[member for member in unpack_batch(batch) if member.type == kind] for batch in batches]


def colors_db(stream: list[Packet]) -> float:
    shown = [replayed.shown()[0] for replayed in replay(stream, 1, lambda state: True, as_captured=True)]
    assert len(shown) == FRAMES
    return float(np.mean([psnr(frame.color, color) for frame, color in zip(sequence(), shown, strict=True)]))


def test_each_batch_has_the_pictures_of_its_frames() -> None:
    headers = [ColorVideoHeader.from_map(video.header) for (video,) in members(packets(LIVE), PacketType.COLOR_VIDEO)]
    assert [(header.frame, header.count) for header in headers] == [(0, 6), (6, 6), (12, 2)]


def test_the_video_shows_what_was_filmed() -> None:
    models = colors_db(packets(replace(LIVE, color_video=ColorVideo.OFF)))
    assert colors_db(packets(LIVE)) > max(25.0, models + 5)


def test_chroma_is_full_from_the_second_batch_on_where_halving_it_loses_most() -> None:
    codecs = [video.header.get("c", 1) for (video,) in members(packets(LIVE), PacketType.COLOR_VIDEO)]
    assert codecs == [VideoCodec.AV1, VideoCodec.AV1_FULL_CHROMA, VideoCodec.AV1_FULL_CHROMA]


def test_models_beside_a_video_take_less_for_their_cells() -> None:
    plain = packets(replace(LIVE, color_video=ColorVideo.OFF))
    sizes = [
        sum(len(model.payload) for batch in members(stream, PacketType.MODEL) for model in batch)
        for stream in (packets(LIVE), plain)
    ]
    assert sizes[0] < 0.7 * sizes[1]
    assert not any(members(packets(LIVE), PacketType.GAIN))


def test_models_are_drawn_in_the_colors_of_the_video(tmp_path: Path) -> None:
    path = tmp_path / "live.3dvc"
    with open_output(path) as writer:
        for packet in packets(LIVE):
            writer.write(packet)
    *_, last = threedvc.decode(path, size=(48, 36))
    small = cv2.resize(sequence()[FRAMES - 1].color, (48, 36), interpolation=cv2.INTER_AREA)
    assert last.color.std() > 20
    assert np.abs(last.color.astype(int) - small).mean() < 25


@pytest.mark.parametrize("rate", [60e3, 200e3])
def test_batches_keep_to_their_rate(rate: float) -> None:
    stream = packets(replace(LIVE, bitrate_bps=rate, live_buffer_s=1.0))
    assert all(members(stream, PacketType.COLOR_VIDEO))
    fps = sequence().info.fps
    sizes = [len(packet.payload) for packet in stream if packet.type == PacketType.BATCH]
    allowed = [rate / 8 * (1 + stop / fps) for stop in (6, 12, 14)]
    assert all(sum(sizes[: k + 1]) <= allowed[k] for k in range(3))


def test_a_rate_too_low_for_a_video_leaves_the_models_their_colors() -> None:
    stream = packets(replace(LIVE, bitrate_bps=8e3))
    assert not any(members(stream, PacketType.COLOR_VIDEO))
    assert stream == packets(replace(LIVE, bitrate_bps=8e3, color_video=ColorVideo.OFF))


def test_where_a_video_does_not_fit_it_is_left_out() -> None:
    stream = packets(replace(LIVE, bitrate_bps=8e3, color_video=ColorVideo.ON))
    assert not all(members(stream, PacketType.COLOR_VIDEO))
    assert members(stream, PacketType.MODEL)[0]


def test_frames_of_one_moment_stay_in_one_batch() -> None:
    merged = MergedSequence([sequence(), sequence()], [identity()])
    config = replace(LIVE, batch_frames=5, color_video=ColorVideo.OFF)
    stream = list(Encoder(merged.info, config).packets(iter(merged)))
    counts = [packet.header["n"] for packet in stream if packet.type == PacketType.BATCH]
    assert counts == [6, 6, 6, 6, 4]
