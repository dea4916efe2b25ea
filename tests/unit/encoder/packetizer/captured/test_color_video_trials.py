# SPDX-License-Identifier: MIT
"""What the bytes of a color video are found to be worth."""

from __future__ import annotations

import pytest

from helpers.nonrigid_scene import nonrigid_sequence
from threedvc.coding.video.av1 import can_encode_av1
from threedvc.config import EncoderConfig, VideoConfig
from threedvc.encoder.packetizer.captured.color_video import ColorVideoWriter, video_bytes
from threedvc.encoder.packetizer.captured.color_video_trials import color_cost
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence

pytestmark = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV cannot write AV1")
VIDEO = VideoConfig(coarseness=40, preset=8)


@pytest.fixture(scope="module")
def frames() -> FrameSequence:
    return nonrigid_sequence(4, (64, 48))


@pytest.fixture(scope="module")
def scene(frames: FrameSequence) -> Scene:
    scene = Scene(frames.info, EncoderConfig(video=VIDEO, threads=1))
    for frame in frames:
        scene.add(frame)
    return scene


@pytest.fixture
def writer(scene: Scene, frames: FrameSequence) -> ColorVideoWriter:
    return ColorVideoWriter(scene, frames, 10)


def test_of_a_quality_bytes_cost_what_the_video_would_gain_by_them(
    writer: ColorVideoWriter, scene: Scene, frames: FrameSequence
) -> None:
    cost = color_cost(writer, scene, frames, VIDEO, None)
    assert cost.budget_bytes is None
    assert cost.sizes[0] == video_bytes(writer.packets(40)) > cost.sizes[1]
    assert 0 < cost.errors[0] < cost.errors[1]


def test_of_a_rate_the_trials_are_about_its_size(writer: ColorVideoWriter, scene: Scene, frames: FrameSequence) -> None:
    budget = 2.0 * video_bytes(writer.packets(40))
    cost = color_cost(writer, scene, frames, VIDEO, budget)
    assert list(cost.sizes) == sorted(cost.sizes)
    assert 0.5 * budget < cost.sizes[-1] <= 0.75 * budget
    assert cost.at(0) < cost.at(0.5 * budget)


def test_without_loss_nothing_is_given_up(scene: Scene, frames: FrameSequence) -> None:
    exact = VideoConfig(lossless=True)
    writer = ColorVideoWriter(scene.with_config(EncoderConfig(video=VIDEO, threads=1)), frames, 10)
    cost = color_cost(writer, scene, frames, exact, None)
    assert cost.budget_bytes is None
    assert cost.at(0) < cost.at(100)
