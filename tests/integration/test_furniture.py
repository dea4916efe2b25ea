# SPDX-License-Identifier: MIT
"""Labeled things that rest in a room before a camera that moves: they stay where they are."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.streams import ListSequence
from threedvc.config import AppearanceConfig, ColorVideo, EncoderConfig, Motion, SegmentationConfig, SegmentationMode
from threedvc.encoder.pipeline.fusion_pass import FrameReporter, FusionPass
from threedvc.encoder.pipeline.offline_passes import find_objects, improve
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.tracking.pose_track import TrackedPose, carry_resting_objects
from threedvc.geometry.pose import compose, inverse, make_pose, rotation_angle, rotation_from_vector
from threedvc.stream.pose_status import PoseStatus
from threedvc.synthesis import SyntheticSequence, make_scene

FRAMES, SIZE, RADIUS_M = 16, (96, 72), 0.45
HIDDEN = range(9, 12)
CONFIG = EncoderConfig(
    color_video=ColorVideo.OFF,
    motion=Motion.TRACK,
    segmentation=SegmentationConfig(mode=SegmentationMode.MASKS),
    refine=False,
    appearance=AppearanceConfig(rounds=1),
    threads=1,
)


@cache
def furnished() -> ListSequence:
    """Return a room whose things within a ball are labeled 1, but for some frames."""
    source = SyntheticSequence(make_scene("room", frames=4 * FRAMES, size=SIZE))
    frames = [
        replace(source[4 * index], index=index, timestamp_ns=round(index * 10**9 / source.info.fps))
        for index in range(FRAMES)
    ]
    places = [world_points(frame.depth, frame.T_world_camera, source) for frame in frames]
    middle = places[0][SIZE[1] // 2, SIZE[0] // 3]
    kept = []
    for frame, place in zip(frames, places, strict=True):
        near = (np.linalg.norm(place - middle, axis=-1) < RADIUS_M) & (frame.index not in HIDDEN)
        kept.append(replace(frame, mask=near.astype(np.uint8), T_world_camera=None))
    info = replace(source.info, frame_count=FRAMES, has_masks=True, has_camera_poses=False)
    return ListSequence(kept, info)


def world_points(depth: NDArray[np.float32], T: object, source: SyntheticSequence) -> NDArray[np.float64]:
    slopes = source.info.rig.depth.rays()
    points = np.concatenate([slopes, np.ones((*depth.shape, 1))], axis=-1) * depth[..., None]
    pose = np.asarray(T)
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def in_the_room(scene: Scene, number: int) -> list[NDArray[np.float64]]:
    world = scene.objects[0].poses
    return [inverse(camera) @ pose for camera, pose in zip(world, scene.objects[number].poses, strict=True)]


@pytest.mark.parametrize("refine", [False, True])
def test_furniture_stays_in_its_place(refine: bool) -> None:
    sequence = furnished()
    fusion = FusionPass(sequence, FrameReporter(None))
    state, _ = improve(find_objects(sequence.info, replace(CONFIG, refine=refine), fusion), fusion)
    places = in_the_room(state.scene, 1)
    assert max(np.linalg.norm(place[:3, 3] - places[0][:3, 3]) for place in places) < 0.05
    assert max(rotation_angle(inverse(places[0]) @ place) for place in places) < 0.06


def test_what_is_out_of_sight_stays_in_the_room() -> None:
    sequence = furnished()
    scene = Scene(sequence.info, CONFIG)
    for frame in sequence:
        scene.add(frame)
    found, places = scene.objects[1].found, in_the_room(scene, 1)
    for frame in HIDDEN:
        at = found[frame]
        assert at is not None
        assert at.status is PoseStatus.UNSEEN
        np.testing.assert_allclose(places[frame], places[HIDDEN.start - 1], atol=1e-9)
    camera = scene.objects[0].poses
    assert np.linalg.norm(camera[HIDDEN.stop][:3, 3] - camera[HIDDEN.start][:3, 3]) > 0.01


def at(shift_m: float, turn: float = 0.0, status: PoseStatus = PoseStatus.TRACKED) -> TrackedPose:
    pose = make_pose(rotation_from_vector(np.array([0.0, turn, 0.0])), np.array([shift_m, 0.0, 1.0]))
    return TrackedPose(T_camera_object=pose, status=status)


def test_a_new_path_of_the_camera_takes_along_what_rests() -> None:
    old, new = [at(0.1 * k, 0.01 * k) for k in range(5)], [at(0.11 * k, 0.02 * k) for k in range(5)]
    rests = [compose(inverse(old[0].T_camera_object), at(0.3).T_camera_object)] * 5
    moves = [compose(rests[0], make_pose(np.eye(3), np.array([0.0, 0.05 * k, 0.0]))) for k in range(5)]

    def seen(places: list[NDArray[np.float64]], status: PoseStatus = PoseStatus.TRACKED) -> list[TrackedPose]:
        pairs = zip(old, places, strict=True)
        return [TrackedPose(T_camera_object=camera.T_camera_object @ place, status=status) for camera, place in pairs]

    before = {0: old, 1: seen(rests), 2: seen(moves), 3: seen(rests, PoseStatus.KNOWN), 4: [None, *seen(rests)[1:]]}
    after = carry_resting_objects(before | {0: new}, before)
    places = [
        inverse(camera.T_camera_object) @ each.T_camera_object for camera, each in zip(new, after[1], strict=True)
    ]
    for place in places:
        np.testing.assert_allclose(place, places[0], atol=1e-12)
    assert after[2] == before[2]
    assert after[3] == before[3]
    assert after[4][0] is None
    still = {0: [at(0.0)] * 5, 1: seen(rests)}
    assert carry_resting_objects(still, still)[1] == still[1]
