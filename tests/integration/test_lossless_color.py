# SPDX-License-Identifier: MIT
"""Color without loss: its way through a stream, and what contradicts it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import threedvc
import threedvc.encoder.pipeline.encoder as encoder_module
from helpers.lossless import EXACT_COLORS
from helpers.packet_changes import members_of, with_changed, written
from helpers.streams import ListSequence
from threedvc.cli.main import main
from threedvc.coding.video.ffv1 import can_encode_ffv1
from threedvc.config import (
    ColorVideo,
    Preset,
    RenderConfig,
    with_preset,
    with_quality,
)
from threedvc.decoder import packet_handlers
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.pipeline.stream_builder import batch_length
from threedvc.errors import ConfigError, CorruptStream
from threedvc.frames.frame import Frame
from threedvc.frames.multi_sensor import MergedSequence
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import identity
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import Packet, PacketType, VideoCodec
from threedvc.synthesis import SyntheticSequence, make_scene

pytestmark = pytest.mark.skipif(not can_encode_ffv1(), reason="this build of PyAV has no FFV1")

FRAMES = 5
CONFIG = replace(EXACT_COLORS, batch_frames=3)


def noisy(frame: Frame, gray: bool) -> Frame:
    noise = np.random.default_rng(frame.index).integers(0, 8, frame.color.shape, dtype=np.uint8)
    color = frame.color // 2 + noise
    return replace(frame, color=color[..., :1].repeat(3, axis=-1) if gray else color)


@pytest.fixture(scope="module", params=[False, True], ids=["color", "gray"])
def sequence(request: pytest.FixtureRequest) -> FrameSequence:
    filmed = SyntheticSequence(make_scene("room", frames=FRAMES, size=(64, 48)))
    frames = [noisy(frame, request.param) for frame in filmed]
    return ListSequence(frames, replace(filmed.info, gray=request.param))


@pytest.fixture(scope="module")
def packets(sequence: FrameSequence) -> list[Packet]:
    return list(Encoder(sequence.info, CONFIG).packets(sequence))


def with_header(packets: list[Packet], **change: int) -> list[Packet]:
    """Return the packets with the headers of the videos in them changed."""
    return with_changed(packets, PacketType.COLOR_VIDEO, lambda packet: replace(packet, header=packet.header | change))


def test_pictures_come_back_exactly(sequence: FrameSequence, packets: list[Packet], tmp_path: Path) -> None:
    path = written(packets, tmp_path / "room.3dvc")
    for threads in (1, 3):
        shown = [frame.color for frame in threedvc.decode(path, render=RenderConfig(threads=threads))]
        np.testing.assert_array_equal(shown, [frame.color for frame in sequence])
    some = [frame.color for frame in threedvc.decode(path, frames=(1, 4))]
    np.testing.assert_array_equal(some, [sequence[k].color for k in range(1, 4)])


def test_elsewhere_models_have_the_colors_of_the_video(
    sequence: FrameSequence, packets: list[Packet], tmp_path: Path
) -> None:
    path = written(packets, tmp_path / "room.3dvc")
    shown = [frame.color for frame in threedvc.decode(path, objects=[0])]
    errors = [got.astype(float) - frame.color for got, frame in zip(shown, sequence, strict=True)]
    assert np.mean([np.square(error).mean() for error in errors]) < 700


def test_headers_tell_the_codec(packets: list[Packet]) -> None:
    members = members_of(packets)
    videos = [ColorVideoHeader.from_map(each.header) for each in members if each.type == PacketType.COLOR_VIDEO]
    assert [(video.frame, video.count) for video in videos] == [(0, 3), (3, 2)]
    for video in videos:
        assert (video.codec, video.columns, video.rows, video.bits) == (VideoCodec.FFV1, 64, 48, 8)
        assert video.magnified == 0


def test_streams_do_not_depend_on_threads(sequence: FrameSequence, packets: list[Packet]) -> None:
    again = list(Encoder(sequence.info, replace(CONFIG, threads=1)).packets(sequence))
    assert [packet.payload for packet in again] == [packet.payload for packet in packets]


@pytest.mark.parametrize("change", [{"w": 63}, {"h": 40}, {"b": 10}, {"m": 2}])
def test_headers_that_contradict_the_camera_are_refused(
    change: dict[str, int], packets: list[Packet], tmp_path: Path
) -> None:
    path = written(with_header(packets, **change), tmp_path / "damaged.3dvc")
    with pytest.raises(CorruptStream, match="must have 64x48 of 8 bits"):
        list(threedvc.decode(path))
    assert len(list(threedvc.decode(path, render=RenderConfig(captured_color=False)))) == FRAMES


def test_what_cannot_be_decoded_is_said(packets: list[Packet], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(packets, tmp_path / "room.3dvc")
    monkeypatch.setattr(packet_handlers, "can_decode_ffv1", lambda: False)
    result = CliRunner().invoke(main, ["decode", str(path), str(tmp_path / "out")])
    assert result.exit_code == 0
    assert "cannot decode its color video (codec 2)" in result.stderr
    assert "install av with FFV1" in result.stderr


def test_every_sensor_has_a_video_of_its_own(sequence: FrameSequence, tmp_path: Path) -> None:
    mirrored = [replace(frame, color=frame.color[:, ::-1].copy()) for frame in sequence]
    merged = MergedSequence([sequence, ListSequence(mirrored, sequence.info)], [identity()])
    path = written(list(Encoder(merged.info, CONFIG).packets(merged)), tmp_path / "two.3dvc")
    for sensor, filmed in enumerate((sequence, mirrored)):
        shown = [frame.color for frame in threedvc.decode(path, sensor=sensor)]
        np.testing.assert_array_equal(shown, [frame.color for frame in filmed])


def test_batches_stay_below_the_largest_payload(sequence: FrameSequence) -> None:
    camera = replace(sequence.info.rig.color, width=1920, height=1080)
    large = replace(sequence.info, rig=replace(sequence.info.rig, color=camera))
    config = replace(CONFIG, batch_frames=None)
    assert batch_length(large, config, video=True) == 8
    assert batch_length(sequence.info, config, video=True) == 10 * sequence.info.fps


def test_choices_that_contradict_it_are_refused(sequence: FrameSequence, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="takes the bytes it needs; leave out the rate"):
        replace(CONFIG, bitrate_bps=1e6)
    for choice in (ColorVideo.OFF, ColorVideo.AUTO):
        with pytest.raises(ConfigError, match="give --color-video on"):
            replace(CONFIG, color_video=choice)
    assert with_quality(with_preset(CONFIG, Preset.SLOW), 10).video.lossless
    monkeypatch.setattr(encoder_module, "can_encode_av1", lambda: False)
    assert list(Encoder(sequence.info, CONFIG).packets(sequence))
    monkeypatch.setattr(encoder_module, "can_encode_ffv1", lambda: False)
    with pytest.raises(ConfigError, match="install av 14"):
        list(Encoder(sequence.info, CONFIG).packets(sequence))
