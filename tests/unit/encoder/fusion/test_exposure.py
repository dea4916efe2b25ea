# SPDX-License-Identifier: MIT
"""The gain of the color camera, found as frames come."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.recorded_room import color_picture, depth_picture, poses
from helpers.streams import ListSequence, drawn
from threedvc.coding.gains import NEUTRAL, apply_gain
from threedvc.config import ColorVideo, EncoderConfig, Motion, Sensor
from threedvc.encoder.fusion.exposure import with_gain
from threedvc.encoder.fusion.integration import observe
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.stream.batch import unpack_batch
from threedvc.stream.packets import PacketType

CAMERA = Camera(width=120, height=90, fx=110.0, fy=110.0, cx=59.5, cy=44.5)
INFO = SequenceInfo(
    name="room", rig=CameraRig.registered_to(CAMERA), depth_scale=1000.0, fps=10.0, frame_count=8, has_camera_poses=True
)
LIVE = EncoderConfig(
    causal=True,
    motion=Motion.KNOWN,
    sensor=Sensor.IDEAL,
    voxel_size_m=0.05,
    color_video=ColorVideo.OFF,
    threads=2,
    batch_frames=2,
)
FACTORS = np.array([1.0, 1.0, 1.0, 1.1, 1.2, 1.2, 0.9, 0.7])


def frames(factors: np.ndarray[tuple[int], np.dtype[np.float64]]) -> list[Frame]:
    """Return frames of a room, each brighter by a factor, and by another in blue."""
    made = []
    for index, (pose, factor) in enumerate(zip(poses(len(factors)), factors, strict=True)):
        plain = 40 + 0.5 * color_picture(CAMERA, pose)
        color = np.rint(plain * [factor, factor, factor**0.5]).astype(np.uint8)
        depth = (depth_picture(CAMERA, pose, 1000) / 1000).astype(np.float32)
        made.append(
            Frame(index=index, timestamp_ns=index * 10**8, color=color, depth=depth, mask=None, T_world_camera=pose)
        )
    return made


def fused(given: list[Frame], config: EncoderConfig = LIVE) -> Scene:
    scene = Scene(INFO, config)
    for frame in given:
        scene.add(frame)
    return scene


def gains_of(scene: Scene) -> list[NDArray[np.int64]]:
    return [record.gain for record in scene.records]


def test_gains_follow_the_camera() -> None:
    scene = fused(frames(FACTORS))
    found = np.array([apply_gain(gain)[0] for gain in gains_of(scene)])
    np.testing.assert_allclose(found[:, 0], FACTORS, rtol=0.04)
    np.testing.assert_allclose(found[:, 2], FACTORS**0.5, rtol=0.04)


def test_colors_of_the_evidence_do_not_follow_the_camera() -> None:
    steady, varying = (fused(frames(factors)).objects[0].evidence for factors in (np.ones(8), FACTORS))
    known = (steady.color_weight > 1) & (varying.color_weight > 1)
    assert np.abs(steady.color[known] - varying.color[known]).mean() < 4


def test_a_steady_camera_has_no_gain() -> None:
    assert all(np.array_equal(gain, NEUTRAL) for gain in gains_of(fused(frames(np.ones(8)))))


def test_files_leave_gains_to_the_fit() -> None:
    scene = fused(frames(FACTORS), replace(LIVE, causal=False))
    assert len(gains_of(scene)) == 8
    assert all(np.array_equal(gain, NEUTRAL) for gain in gains_of(scene))


def test_without_depth_the_last_gain_stays() -> None:
    given = frames(FACTORS[:6])
    blind = replace(given[5], depth=np.zeros_like(given[5].depth))
    scene = fused([*given[:5], blind])
    assert not np.array_equal(gains_of(scene)[4], NEUTRAL)
    np.testing.assert_array_equal(gains_of(scene)[5], gains_of(scene)[4])


@pytest.mark.parametrize("gray", [False, True])
def test_a_frame_without_its_gain_is_as_before(gray: bool) -> None:
    frame = frames(np.ones(1))[0]
    seen = observe(frame, INFO.rig, CAMERA.rays())
    gain = np.array([[256, 256], [128, 0], [64, -128]])
    freed = with_gain(seen, gain)
    for channel, factor in enumerate((2, 1, 0.5)):
        np.testing.assert_allclose(freed.levels[0][..., channel] * factor, frame.color[..., channel], atol=0.3)


def test_live_pictures_are_as_bright_as_they_were_filmed() -> None:
    given = frames(FACTORS)
    packets = list(Encoder(INFO, LIVE).packets(ListSequence(given, INFO)))
    for frame, picture in list(zip(given, drawn(packets), strict=True))[2:]:
        shown = picture.any(axis=-1)
        assert shown.mean() > 0.5
        # Cells at a few looks are off by a little; a gain not sent would make 30 levels.
        assert abs(float(picture[shown].mean()) - float(frame.color[shown].mean())) < 8


def test_live_a_steady_camera_sends_no_gains() -> None:
    packets = list(Encoder(INFO, LIVE).packets(ListSequence(frames(np.ones(8)), INFO)))
    members = [member for packet in packets if packet.type == PacketType.BATCH for member in unpack_batch(packet)]
    assert not [member for member in members if member.type == PacketType.GAIN]
