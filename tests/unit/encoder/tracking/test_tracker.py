# SPDX-License-Identifier: MIT
"""Where poses come from, and a tracker that follows what it can see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from threedvc.config import FusionConfig, Motion, Sensor
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import fuse, observe
from threedvc.encoder.registration.frame_resolutions import Downsampled, FrameResolutions, ObjectView
from threedvc.encoder.tracking.given_poses import known_pose, motion_of
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.encoder.tracking.tracker import Tracker
from threedvc.errors import ConfigError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sensor_model import SENSORS
from threedvc.geometry.pose import compose, identity, inverse, make_pose, rotation_angle
from threedvc.stream.pose_status import PoseStatus
from threedvc.synthesis import SyntheticSequence, make_scene

ROOM = SyntheticSequence(make_scene("room", frames=6, size=(96, 72)))
IDEAL = SENSORS[Sensor.IDEAL]


def info(*, camera: bool, objects: bool) -> SequenceInfo:
    return replace(ROOM.info, has_camera_poses=camera, has_object_poses=objects)


@pytest.mark.parametrize(
    ("number", "camera", "objects", "expected"),
    [
        (0, True, False, Motion.KNOWN),
        (0, True, True, Motion.KNOWN),
        (0, False, True, Motion.KNOWN),
        (0, False, False, Motion.TRACK),
        (2, False, True, Motion.KNOWN),
        (2, True, True, Motion.KNOWN),
        (2, True, False, Motion.TRACK),
        (2, False, False, Motion.TRACK),
    ],
)
def test_automatic_motion_takes_the_poses_that_there_are(
    number: int, camera: bool, objects: bool, expected: Motion
) -> None:
    given = info(camera=camera, objects=objects)
    assert motion_of(number, given, Motion.AUTO) is expected
    assert motion_of(number, given, Motion.TRACK) is Motion.TRACK
    if expected is Motion.KNOWN:
        assert motion_of(number, given, Motion.KNOWN) is Motion.KNOWN
    else:
        with pytest.raises(ConfigError, match=f"room has no poses for object {number}; .* use --motion track"):
            motion_of(number, given, Motion.KNOWN)


def frame_with(poses: dict[int, np.ndarray], camera: np.ndarray | None = None) -> Frame:
    empty = np.zeros((2, 2), dtype=np.float32)
    return Frame(
        index=0,
        timestamp_ns=0,
        color=np.zeros((2, 2, 3), dtype=np.uint8),
        depth=empty,
        T_world_camera=camera,
        T_camera_object=poses,
    )


def test_known_poses() -> None:
    T_world_camera = make_pose(np.eye(3), np.array([1.0, 2.0, 3.0]))
    place = make_pose(np.eye(3), np.array([0.0, 0.0, 1.0]))
    frame = frame_with({4: place}, T_world_camera)
    np.testing.assert_array_equal(known_pose(0, frame, False), inverse(T_world_camera))
    np.testing.assert_array_equal(known_pose(0, frame_with({}), False), identity())
    np.testing.assert_array_equal(known_pose(4, frame, False), place)
    assert known_pose(1, frame, False) is None


def test_the_object_of_a_depth_threshold_is_the_only_one_there_is() -> None:
    place, other = identity(), make_pose(np.eye(3), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_array_equal(known_pose(1, frame_with({7: other}), True), other)
    np.testing.assert_array_equal(known_pose(1, frame_with({1: place, 7: other}), True), place)
    assert known_pose(1, frame_with({5: place, 7: other}), True) is None
    assert known_pose(1, frame_with({}), True) is None


@pytest.mark.parametrize(
    ("status", "usable"),
    [
        (PoseStatus.KNOWN, True),
        (PoseStatus.TRACKED, True),
        (PoseStatus.RELOCALIZED, True),
        (PoseStatus.WEAK, True),
        (PoseStatus.LOST, False),
        (PoseStatus.UNSEEN, False),
    ],
)
def test_only_what_is_lost_or_unseen_is_not_fused(status: PoseStatus, usable: bool) -> None:
    assert TrackedPose(T_camera_object=identity(), status=status).usable is usable


class Follower:
    """A tracker with the model that it builds."""

    def __init__(self) -> None:
        self.rig = ROOM.info.rig
        self.full = Downsampled(self.rig, 1)
        self.tracker = Tracker(IDEAL, 1)
        self.model = EvidenceModel(0.04)
        self.mask = np.ones((72, 96), dtype=bool)

    def start(self, frame: Frame, number: int = 0) -> TrackedPose:
        found = self.tracker.start(self.view(frame), number, self.rig)
        self.fuse(frame, found)
        return found

    def follow(self, frame: Frame) -> TrackedPose:
        found = self.tracker.locate([self.view(frame)], self.model)
        if found.usable:
            self.fuse(frame, found)
        return found

    def view(self, frame: Frame) -> ObjectView:
        return ObjectView(FrameResolutions(frame, self.full, self.full), self.mask)

    def fuse(self, frame: Frame, at: TrackedPose) -> None:
        seen = observe(frame, self.rig, self.rig.depth.rays())
        fuse(self.model, seen, self.mask, at.T_camera_object, IDEAL, FusionConfig(), 1)


def test_the_background_starts_at_the_camera() -> None:
    np.testing.assert_array_equal(Follower().start(ROOM[0]).T_camera_object, identity())


def test_an_object_starts_in_its_own_middle() -> None:
    follower = Follower()
    follower.mask[:] = False
    follower.mask[30:40, 50:60] = True
    pose = follower.start(ROOM[0], number=2).T_camera_object
    np.testing.assert_array_equal(pose[:3, :3], np.eye(3))
    u, v = follower.rig.depth.project(pose[:3, 3])
    assert 50 <= u <= 60
    assert 30 <= v <= 40
    assert pose[2, 3] == pytest.approx(np.median(ROOM[0].depth[follower.mask]), abs=1e-3)


def test_follows_a_hand_held_camera() -> None:
    follower = Follower()
    frames = list(ROOM)
    follower.start(frames[0])
    start = frames[0].T_world_camera
    assert start is not None
    for frame in frames[1:]:
        found = follower.follow(frame)
        assert found.status is PoseStatus.TRACKED
        assert frame.T_world_camera is not None
        error = compose(found.T_camera_object, compose(inverse(start), frame.T_world_camera))
        assert rotation_angle(error) < 0.01
        assert np.linalg.norm(error[:3, 3]) < 0.02


def test_what_rests_keeps_its_pose_exactly() -> None:
    follower = Follower()
    frame = ROOM[0]
    follower.start(frame)
    for _ in range(4):
        np.testing.assert_array_equal(follower.follow(frame).T_camera_object, identity())


def test_a_frame_that_shows_something_else_is_lost_at_the_pace_so_far_and_the_next_is_found() -> None:
    follower, rng = Follower(), np.random.default_rng(8)
    frames = list(ROOM)
    follower.start(frames[0])
    before = follower.follow(frames[1])
    clutter = rng.uniform(0.3, 3.0, frames[2].depth.shape).astype(np.float32)
    strange = replace(frames[2], depth=clutter, color=rng.integers(0, 256, frames[2].color.shape, dtype=np.uint8))
    lost = follower.follow(strange)
    assert lost.status is PoseStatus.LOST
    np.testing.assert_allclose(lost.T_camera_object, before.T_camera_object @ before.T_camera_object, atol=1e-9)
    assert follower.follow(frames[3]).status is PoseStatus.TRACKED


def test_a_frame_without_depth_is_lost() -> None:
    follower = Follower()
    follower.start(ROOM[0])
    blind = replace(ROOM[1], depth=np.zeros_like(ROOM[1].depth))
    assert follower.follow(blind).status is PoseStatus.LOST
