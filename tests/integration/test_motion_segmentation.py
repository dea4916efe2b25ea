# SPDX-License-Identifier: MIT
"""Objects found by their motion alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from threedvc.config import ColorVideo, EncoderConfig, Motion, SegmentationConfig, SegmentationMode
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.segmentation.motion.downsampling import Downsampling
from threedvc.encoder.segmentation.sequence_labels import VOID_LABEL, SequenceLabels
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import inverse, make_pose, rotation_angle, rotation_from_vector
from threedvc.stream.packets import Packet
from threedvc.stream.pose_status import PoseStatus
from threedvc.synthesis import SyntheticSequence, make_scene

CONFIG = EncoderConfig(
    color_video=ColorVideo.OFF,
    threads=1,
    motion=Motion.TRACK,
    segmentation=SegmentationConfig(mode=SegmentationMode.MOTION),
    refine=False,
)
SIZE = (96, 72)
FRAMES = 28
START, STOP = 6, 22


class Kept:
    """Frames that were rendered once."""

    def __init__(self, frames: FrameSequence) -> None:
        self.info: SequenceInfo = frames.info
        self.frames: list[Frame] = list(frames)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Frame:
        return self.frames[index]

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.frames)


def eased(frame: int) -> float:
    t = float(np.clip((frame - START) / (STOP - START), 0, 1))
    return t * t * (3 - 2 * t)


@cache
def filmed(way: Callable[[int], tuple[tuple[float, float, float], float]] | None, count: int = FRAMES) -> Kept:
    """Return a toy before a wall; `way` gives for a frame its shift in meters and turn about the upright axis."""
    scene = make_scene("paper", frames=count, size=SIZE)
    body = scene.bodies[0]
    if way is None:
        return Kept(SyntheticSequence(replace(scene, bodies=()), "kinect", 1))
    first, script = body.T_world_body[0], []
    for frame in range(count):
        shift, turn = way(frame)
        moved = make_pose(rotation_from_vector(np.array([0.0, 0.0, turn])) @ first[:3, :3], first[:3, 3] + shift)
        script.append(moved)
    return Kept(SyntheticSequence(replace(scene, bodies=(replace(body, T_world_body=np.array(script)),)), "kinect", 1))


def moved_aside(frame: int) -> tuple[tuple[float, float, float], float]:
    return (-0.16 * eased(frame), 0.16 * eased(frame), 0.05 * eased(frame)), 0.8 * eased(frame)


def overlap(labels: np.ndarray, frame: Frame) -> float:
    assert frame.mask is not None
    known = frame.depth > 0
    there = (labels > 0) & (labels != VOID_LABEL) & known, (frame.mask > 0) & known
    return float(np.count_nonzero(there[0] & there[1]) / max(np.count_nonzero(there[0] | there[1]), 1))


@cache
def divided() -> SequenceLabels:
    frames = filmed(moved_aside)
    sequence_labels = SequenceLabels(frames.info, CONFIG)
    sequence_labels.segment_all(frames)
    return sequence_labels


def test_a_thing_that_moves_is_one_object_before_while_and_after() -> None:
    frames = filmed(moved_aside)
    labels = [divided().labels(frame) for frame in frames]
    assert set(np.unique(labels)) - {VOID_LABEL} == {0, 1}
    found = [overlap(picture, frame) for picture, frame in zip(labels, frames, strict=True)]
    assert np.median(found) > 0.9
    assert min(found) > 0.8


def test_its_pose_is_followed() -> None:
    frames = filmed(moved_aside)
    scene = Scene(frames.info, CONFIG, None, divided())
    for frame in frames:
        scene.add(frame)
    assert sorted(scene.objects) == [0, 1]

    poses, true = scene.objects[1].poses, [frame.T_camera_object[1] for frame in frames]
    moved, expected = poses[-1] @ inverse(poses[0]), true[-1] @ inverse(true[0])
    assert np.degrees(rotation_angle(inverse(expected) @ moved)) < 4
    assert np.linalg.norm((moved @ true[0] - true[-1])[:3, 3]) < 0.01


def test_a_room_at_rest_has_no_objects() -> None:
    frames = filmed(None)
    sequence_labels = SequenceLabels(frames.info, CONFIG)
    sequence_labels.segment_all(frames)
    assert set(np.unique([sequence_labels.labels(frame) for frame in frames])) <= {0, VOID_LABEL}


def test_before_a_thing_is_an_object_it_is_out_of_the_picture() -> None:
    frames = filmed(moved_aside)
    scene = Scene(frames.info, CONFIG)
    for frame in frames:
        scene.add(frame)
    item = scene.objects[1]
    assert item.born is not None
    assert item.born > START
    far = [np.linalg.norm(pose[:3, 3]) > 100 for pose in item.poses]
    assert all(far[: item.born])
    assert not any(far[item.born :])


def test_while_frames_come_a_thing_is_an_object_once_it_has_moved() -> None:
    frames = filmed(moved_aside)
    sequence_labels = SequenceLabels(frames.info, CONFIG)
    labels = [sequence_labels.labels(frame) for frame in frames]
    assert not any(np.any(picture == 1) for picture in labels[:START])
    assert all(np.any(picture == 1) for picture in labels[STOP:])
    assert overlap(labels[-1], frames[-1]) > 0.5
    np.testing.assert_array_equal(sequence_labels.labels(frames[-1]), labels[-1])


def there_and_back(frame: int) -> tuple[tuple[float, float, float], float]:
    far = 0.6 * max(0.0, min(1.0, (frame - 4) / 15, (40 - frame) / 15))
    return (-far, far, 0.0), 0.0


def test_a_thing_that_left_is_out_of_the_picture_and_the_same_when_it_comes_back() -> None:
    frames = filmed(there_and_back, 44)
    sequence_labels = SequenceLabels(frames.info, CONFIG)
    sequence_labels.segment_all(frames)
    scene = Scene(frames.info, CONFIG, None, sequence_labels)
    for frame in frames:
        scene.add(frame)
    assert sorted(scene.objects) == [0, 1]
    gone = [at is not None and at.status is PoseStatus.UNSEEN for at in scene.objects[1].found]
    assert all(gone[19:25])
    assert not any(gone[:8])
    assert not any(gone[39:])
    first, last = scene.objects[1].poses[0], scene.objects[1].poses[-1]
    assert np.linalg.norm(first[:3, 3] - last[:3, 3]) < 0.02


@pytest.mark.parametrize("causal", [False, True])
def test_a_stream_holds_the_object(causal: bool) -> None:
    frames = filmed(moved_aside)
    packets = list(Encoder(frames.info, replace(CONFIG, causal=causal, voxel_size_m=0.03)).packets(frames))
    decoder = Decoder()
    states = list(decoder.frames(iter(packets)))
    assert len(states) == FRAMES
    assert decoder.complete
    assert sorted(states[-1].T_camera_object)[:2] == [0, 1]


def test_downsampling_keeps_every_nth_pixel() -> None:
    camera = Camera(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
    info = SequenceInfo(name="x", rig=CameraRig.registered_to(camera), depth_scale=1000.0, fps=30.0, frame_count=1)
    downsampling = Downsampling(info)
    frame = Frame(
        index=0,
        timestamp_ns=0,
        color=np.full((480, 640, 3), 7, np.uint8),
        depth=np.arange(480 * 640, dtype=np.float32).reshape(480, 640),
    )
    small = downsampling.downsampled(frame)
    assert (downsampling.stride, small.depth.shape, small.color.shape) == (2, (240, 320), (240, 320, 3))
    assert downsampling.rig.registered
    np.testing.assert_array_equal(small.depth, frame.depth[::2, ::2])


def test_two_toys_are_two_objects(sequence_dir: Callable[[str], Path]) -> None:
    from threedvc.formats.sources import open_sequence

    sequence = open_sequence(sequence_dir("two_toys"))
    sequence_labels = SequenceLabels(sequence.info, CONFIG)
    sequence_labels.segment_all(sequence)
    labels = [sequence_labels.labels(frame) for frame in sequence]
    assert set(np.unique(labels)) - {VOID_LABEL} == {0, 1, 2}
    assert np.mean([overlap(picture, frame) for picture, frame in zip(labels, sequence, strict=True)]) > 0.9


def untold(kept: Kept) -> Kept:
    """Return frames of which nobody says what moves in them."""
    result = Kept(kept)
    result.info = replace(kept.info, has_masks=False, has_object_poses=False, has_camera_poses=False)
    result.frames = [replace(frame, mask=None, T_camera_object={}, T_world_camera=None) for frame in kept]
    return result


def encoded(frames: Kept, mode: SegmentationMode) -> tuple[Encoder, list[Packet]]:
    config = replace(CONFIG, segmentation=SegmentationConfig(mode=mode), refine=True, voxel_size_m=0.03)
    encoder = Encoder(frames.info, replace(config, appearance=replace(config.appearance, rounds=0)))
    return encoder, list(encoder.packets(frames))


@pytest.mark.long
def test_a_file_is_searched_for_what_moves_where_nobody_says() -> None:
    encoder, _ = encoded(untold(filmed(moved_aside)), SegmentationMode.AUTO)
    assert encoder.scene.sequence_labels is not None
    assert set(encoder.scene.objects) >= {0, 1}


@pytest.mark.long
def test_where_nothing_moves_a_file_is_as_if_it_had_not_been_searched() -> None:
    frames = untold(filmed(None, 12))
    encoder, packets = encoded(frames, SegmentationMode.AUTO)
    assert encoder.scene.sequence_labels is None
    assert packets == encoded(frames, SegmentationMode.NONE)[1]
