# SPDX-License-Identifier: MIT
"""How fine color videos are chosen, and what their bytes are found to be worth."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.nonrigid_scene import nonrigid_sequence
from helpers.streams import ListSequence
from threedvc.coding.video.av1 import can_encode_av1
from threedvc.config import ColorVideo, EncoderConfig, VideoConfig, with_quality
from threedvc.config.stages import MAX_COARSENESS, MIN_CRF
from threedvc.encoder.packetizer.captured import color_video
from threedvc.encoder.packetizer.captured.color_video import EXACT, VideoChoice, video_bytes
from threedvc.encoder.packetizer.captured.color_video_trials import ColorVideoTrials
from threedvc.encoder.pipeline.stream_builder import batch_length
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import VideoCodec

pytestmark = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV cannot write AV1")
VIDEO = VideoConfig(coarseness=40, preset=8)


@pytest.fixture(scope="module")
def frames() -> FrameSequence:
    return nonrigid_sequence(4, (64, 48))


@pytest.fixture(scope="module")
def colorful(frames: FrameSequence) -> FrameSequence:
    """Frames whose columns are red and blue by turns."""
    columns = np.where(np.arange(64)[:, None] % 2, (200, 60, 40), (40, 60, 200)).astype(np.uint8)
    picture = np.ascontiguousarray(np.broadcast_to(columns, (48, 64, 3)))
    return ListSequence([replace(frame, color=picture) for frame in frames], frames.info)


def scene_of(frames: FrameSequence, video: VideoConfig = VIDEO) -> Scene:
    scene = Scene(frames.info, EncoderConfig(video=video, color_video=ColorVideo.ON, threads=1))
    for frame in frames:
        scene.add(frame)
    return scene


def trials(frames: FrameSequence, video: VideoConfig = VIDEO) -> ColorVideoTrials:
    return ColorVideoTrials(scene_of(frames, video), frames, 10)


def size(found: ColorVideoTrials, choice: VideoChoice) -> int:
    return video_bytes(found.writer.packets(choice))


def test_of_a_quality_bytes_cost_what_the_video_would_gain_by_them(frames: FrameSequence) -> None:
    found = trials(frames)
    cost = found.cost(None)
    assert cost.budget_bytes is None
    assert cost.sizes[0] == size(found, found.of_quality()) > cost.sizes[1]
    assert 0 < cost.errors[0] < cost.errors[1]


def test_of_a_rate_the_trials_are_about_its_size(frames: FrameSequence) -> None:
    found = trials(frames)
    budget = 2.0 * size(found, VideoChoice(40))
    cost = found.cost(budget)
    assert list(cost.sizes) == sorted(cost.sizes)
    assert 0.5 * budget < cost.sizes[-1] <= 0.8 * budget
    assert cost.at(0) < cost.at(0.5 * budget)


def test_without_loss_nothing_is_given_up(frames: FrameSequence) -> None:
    found = trials(frames, VideoConfig(lossless=True))
    assert found.of_quality() == EXACT
    cost = found.cost(None)
    assert cost.budget_bytes is None
    assert cost.at(0) < cost.at(100)


@pytest.mark.parametrize("least", [30.0, 36.0, 41.0])
def test_a_video_has_the_psnr_asked_for_and_hardly_more(frames: FrameSequence, least: float) -> None:
    found = trials(frames, VideoConfig(coarseness=MAX_COARSENESS, preset=8, min_psnr_db=least))
    choice = found.of_quality()
    assert least <= found._errors(choice).psnr_db < least + 0.5
    assert found.of_quality() == choice


def test_a_psnr_out_of_reach_takes_the_finest_video(frames: FrameSequence) -> None:
    found = trials(frames, VideoConfig(coarseness=4, preset=8, min_psnr_db=90.0))
    assert found.of_quality().coarseness == MIN_CRF


def test_chroma_is_full_where_halving_it_loses_more_than_quantization(
    frames: FrameSequence, colorful: FrameSequence
) -> None:
    dull = ListSequence(
        [replace(each, color=np.repeat(each.color[..., 1:2], 3, axis=2)) for each in frames], frames.info
    )
    assert not trials(dull).of_quality().full_chroma
    assert trials(colorful).of_quality().full_chroma
    found = trials(colorful)
    choice = found.within(float(size(found, VideoChoice(30, full_chroma=True))))
    assert choice.full_chroma
    (packet,) = found.writer.packets(choice)
    assert ColorVideoHeader.from_map(packet.header).codec == VideoCodec.AV1_FULL_CHROMA


def test_pictures_are_larger_where_their_error_is_less(frames: FrameSequence, monkeypatch: pytest.MonkeyPatch) -> None:
    found = trials(frames)
    budget = float(size(found, VideoChoice(62, scale=1.0)))

    def errors(choice: VideoChoice) -> SimpleNamespace:
        return SimpleNamespace(square=1e9, logarithm=-choice.coding.scale, psnr_db=30.0)

    monkeypatch.setattr(found, "_errors", errors)
    choice = found.within(budget)
    assert choice.coding.scale == 1
    assert size(found, choice) <= budget


@pytest.mark.parametrize(("worse", "scale"), [(0.1, 1.0), (0.2, 0.5)])
def test_a_scale_that_is_a_little_worse_does_not_end_the_search(
    frames: FrameSequence, monkeypatch: pytest.MonkeyPatch, worse: float, scale: float
) -> None:
    found = trials(frames)
    first = VideoChoice(66)
    assert first.coding.scale == 0.5
    errors = {0.375: 1.0, 0.5: 0.0, 0.75: worse, 1.0: -0.1}
    monkeypatch.setattr(
        found, "_errors", lambda choice: SimpleNamespace(square=1e9, logarithm=errors[choice.coding.scale])
    )
    assert found._best_scale(first, float(size(found, VideoChoice(40)))).coding.scale == scale


def test_a_scale_serves_budgets_alike_and_larger_ones_that_cannot_fit_are_not_measured(
    frames: FrameSequence, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = trials(frames)
    budget = float(size(found, VideoChoice(62, scale=1.0)))
    found._scales = [(budget, VideoChoice(62, scale=1.0))]
    assert found.within(1.1 * budget).scale == 1
    least = VideoChoice(MAX_COARSENESS)
    size(found, least)
    monkeypatch.setattr(found, "_errors", lambda _: pytest.fail("measured"))
    assert found._best_scale(least, 1.0) == least
    assert len([each for each in found.writer.sizes if each.scale == 0.375]) == 1
    assert not [each for each in found.writer.sizes if each.scale == 0.5]


def test_a_rate_that_no_loss_fits_into_has_none(frames: FrameSequence) -> None:
    found = trials(frames)
    assert found.within(2.0 * size(found, EXACT)) == EXACT
    assert not found.within(0.5 * size(found, EXACT)).exact


def test_only_the_last_choices_are_kept(frames: FrameSequence) -> None:
    writer = trials(frames).writer
    sizes = [writer.size(VideoChoice(float(coarseness))) for coarseness in range(50, 60)]
    assert len(writer.coded) == color_video.MAX_KEPT
    assert sizes == [writer.size(VideoChoice(float(coarseness))) for coarseness in range(50, 60)]


@pytest.mark.parametrize(
    ("config", "most"),
    [
        (EncoderConfig(), 300),
        (with_quality(EncoderConfig(), 95), (1 << 25) // (640 * 480)),
        (EncoderConfig(bitrate_bps=20e6), 300),
        (EncoderConfig(bitrate_bps=100e6), 80),
        (EncoderConfig(causal=True), 30),
        (EncoderConfig(causal=True, latency_s=10), 300),
        (with_quality(EncoderConfig(causal=True, latency_s=10), 95), (1 << 25) // (640 * 480)),
        (EncoderConfig(causal=True, latency_s=10, bitrate_bps=100e6), 80),
    ],
)
def test_batches_of_much_data_are_short(frames: FrameSequence, config: EncoderConfig, most: int) -> None:
    camera = Camera(width=640, height=480, fx=500.0, fy=500.0, cx=320.0, cy=240.0)
    info = replace(frames.info, rig=CameraRig.registered_to(camera), fps=30.0)
    assert batch_length(info, config, video=True) == most
