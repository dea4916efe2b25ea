# SPDX-License-Identifier: MIT
"""What a live color video does with the bytes that are left to it."""

from __future__ import annotations

from math import inf

import pytest

from helpers.nonrigid_scene import nonrigid_sequence
from threedvc.coding.video.av1 import can_encode_av1
from threedvc.config import EncoderConfig, VideoConfig
from threedvc.config.stages import MAX_COARSENESS, MIN_CRF
from threedvc.encoder.packetizer.batch_budget import packed_bytes
from threedvc.encoder.packetizer.captured.live_color_video import (
    COARSEST,
    LiveColorVideo,
    _first_coarseness,
    _LikelySizes,
)
from threedvc.encoder.packetizer.scene_source import BatchFrames
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.stream.captured_headers import ColorVideoHeader

pytestmark = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV cannot write AV1")
FRAMES = 6


def video_and_scene(config: EncoderConfig) -> tuple[LiveColorVideo, Scene]:
    sequence = nonrigid_sequence(FRAMES, (64, 48))
    scene = Scene(sequence.info, config)
    video = LiveColorVideo(scene)
    for frame in sequence:
        scene.add(frame)
        video.keep([frame])
    return video, scene


def config(coarseness: float = 50, min_psnr_db: float = 0.0) -> EncoderConfig:
    return EncoderConfig(
        causal=True, video=VideoConfig(coarseness=coarseness, preset=10, min_psnr_db=min_psnr_db), threads=1
    )


@pytest.mark.parametrize("budget", [-500.0, 0.0, 10.0])
def test_no_bytes_are_no_video(budget: float) -> None:
    video, scene = video_and_scene(config())
    assert video.packets(BatchFrames.of(scene, 0, 3), budget) == []


@pytest.mark.parametrize("budget", [700.0, 1500.0, 6000.0])
def test_no_video_exceeds_its_bytes(budget: float) -> None:
    video, scene = video_and_scene(config())
    for first in (0, 3):
        packets = video.packets(BatchFrames.of(scene, first, first + 3), budget)
        assert packed_bytes(packets) <= budget
        assert [(ColorVideoHeader.from_map(each.header).frame, each.header["n"]) for each in packets] == [(first, 3)]


def test_frames_of_batches_that_were_sent_are_forgotten() -> None:
    video, scene = video_and_scene(config())
    video.packets(BatchFrames.of(scene, 0, 4), inf)
    assert sorted(video._frames) == [4, 5]
    video.packets(BatchFrames.of(scene, 4, 6), -1.0)
    assert not video._frames


def test_without_a_rate_pictures_come_to_the_psnr_asked_for() -> None:
    video, scene = video_and_scene(config(coarseness=70, min_psnr_db=34.0))
    before = video._choice.coarseness
    video.packets(BatchFrames.of(scene, 0, 2), inf)
    assert video._choice.coarseness < before
    fine, fine_scene = video_and_scene(config(coarseness=30, min_psnr_db=10.0))
    fine.packets(BatchFrames.of(fine_scene, 0, 2), inf)
    assert fine._choice.coarseness == 30


def test_bytes_for_the_coarsest_video_are_enough() -> None:
    video, scene = video_and_scene(config())
    batch = BatchFrames.of(scene, 0, 3)
    least = packed_bytes(video._writer(batch).packets(COARSEST))
    packets = video.packets(batch, least + 1)
    assert packets
    assert packed_bytes(packets) <= least + 1


def test_sizes_of_other_coarsenesses_are_guessed_by_those_known() -> None:
    sizes = _LikelySizes()
    assert sizes.coarseness_of(500, 61.25) == 61.25
    sizes.learn({60.0: 4000})
    assert sizes.coarseness_of(500, 61.25) == 61.25
    sizes.learn({60.0: 4000, 74.0: 1000})
    assert sizes.coarseness_of(2000, 0.0) == 67
    assert sizes.coarseness_of(9000, 0.0) == 60
    assert sizes.coarseness_of(10, 0.0) == 74


def test_the_first_trial_is_as_coarse_as_the_bytes_ask() -> None:
    found = [_first_coarseness(each) for each in (1e-9, 1e-4, 4.5e-4, 9e-4, 1e-2, 1e9)]
    assert found == sorted(found, reverse=True)
    assert found[2:4] == [72.0, 68.5]
    assert (found[0], found[-1]) == (MAX_COARSENESS, MIN_CRF)


def test_sizes_that_the_last_batch_contradicts_are_forgotten() -> None:
    sizes = _LikelySizes()
    sizes.learn({60.0: 4000, 67.0: 2000, 74.0: 1000})
    sizes.learn({70.0: 3000})
    assert sizes.coarseness_of(2000, 0.0) == 71.5
    assert sizes.coarseness_of(3000, 0.0) == 70
