# SPDX-License-Identifier: MIT
"""A camera that loses its way: a new part of the model begins, and is joined to the first when that is recognized."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers.streams import ListSequence
from threedvc.config import ColorVideo, EncoderConfig, Motion, Sensor
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.tracking.pose_track import TrackedPose, interpolate_blind_frames, merge_submaps, pose_between
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import Pose, identity, inverse, make_pose
from threedvc.stream.pose_status import PoseStatus
from threedvc.synthesis import SyntheticSequence, make_scene

ROOM = SyntheticSequence(make_scene("room", frames=60, size=(96, 72)))
INFO = replace(ROOM.info, has_camera_poses=False, fps=6)
COVERED = 8
FIRST, ELSEWHERE = list(range(12)), list(range(40, 55))
PERIOD_NS = 10**9 // 6


@cache
def filmed(number: int) -> Frame:
    return ROOM[number]


def recording(*numbers: int | None) -> ListSequence:
    """Return frames of the room as filmed without poses; None: the lens is covered."""
    frames = []
    for index, number in enumerate(numbers):
        frame = filmed(number or 0)
        if number is None:
            frame = replace(frame, color=np.zeros_like(frame.color), depth=np.zeros_like(frame.depth))
        frames.append(replace(frame, index=index, timestamp_ns=index * PERIOD_NS, T_world_camera=None))
    return ListSequence(frames, INFO)


def true_pose(number: int) -> Pose:
    """Return T_camera_world, in the world that is the camera of frame 0."""
    first, here = filmed(0).T_world_camera, filmed(number).T_world_camera
    assert first is not None
    assert here is not None
    return inverse(here) @ first


def distance(found: Pose, number: int) -> float:
    return float(np.linalg.norm((inverse(found) @ true_pose(number))[:3, 3]))


def tracked(frames: list[Frame]) -> tuple[Scene, list[PoseStatus]]:
    scene = Scene(INFO, EncoderConfig(motion=Motion.TRACK, sensor=Sensor.IDEAL))
    return scene, [scene.add(frame) for frame in frames]


@pytest.fixture(scope="module")
def there_and_back() -> tuple[list[int | None], Scene, list[PoseStatus]]:
    numbers = [*FIRST, *[None] * COVERED, *ELSEWHERE, *range(53, 4, -1)]
    return numbers, *tracked(recording(*numbers).frames)


def test_a_new_part_begins_a_second_after_the_way_was_lost(
    there_and_back: tuple[list[int | None], Scene, list[PoseStatus]],
) -> None:
    _, scene, status = there_and_back
    covered = slice(len(FIRST), len(FIRST) + COVERED)
    assert set(status[covered]) == {PoseStatus.LOST}
    assert PoseStatus.LOST not in status[: len(FIRST)] + status[covered.stop :]
    parts = [None if at is None else at.submap for at in scene.objects[0].found]
    assert set(parts[: len(FIRST)]) == {0}
    assert set(parts[covered.stop : covered.stop + len(ELSEWHERE)]) == {1}


def test_nothing_of_a_new_part_touches_the_first(
    there_and_back: tuple[list[int | None], Scene, list[PoseStatus]],
) -> None:
    _, scene, _ = there_and_back
    places = [inverse(at.T_camera_object)[:3, 3] for at in scene.objects[0].found if at is not None]
    heights = -np.array(places)[:, 1]
    assert heights[len(FIRST) - 1] < 3
    assert heights[len(FIRST) + COVERED] > 20


def test_parts_are_joined_when_the_first_is_recognized(
    there_and_back: tuple[list[int | None], Scene, list[PoseStatus]],
) -> None:
    numbers, scene, status = there_and_back
    item = scene.objects[0]
    assert status.count(PoseStatus.RELOCALIZED) == 1
    assert item.found[-1] is not None
    assert item.found[-1].submap == 0
    assert item.tracker is not None
    for at, number in zip(merge_submaps(item.found, item.tracker.submap_links), numbers, strict=True):
        if number is not None:
            assert at is not None
            assert distance(at.T_camera_object, number) < 0.02


def test_a_camera_that_comes_back_at_once_needs_no_part() -> None:
    numbers = [*FIRST, None, None, *range(13, 18)]
    scene, status = tracked(recording(*numbers).frames)
    assert [index for index, each in enumerate(status) if each is PoseStatus.LOST] == [12, 13]
    assert all(at is not None and at.submap == 0 for at in scene.objects[0].found)
    assert scene.objects[0].found[-1] is not None
    assert distance(scene.objects[0].found[-1].T_camera_object, 17) < 0.02


@pytest.mark.parametrize("causal", [False, True])
def test_the_stream_goes_on(causal: bool) -> None:
    numbers = [*FIRST, *[None] * COVERED, *ELSEWHERE[:6]]
    settings = EncoderConfig(
        color_video=ColorVideo.OFF,
        motion=Motion.TRACK,
        sensor=Sensor.IDEAL,
        causal=causal,
        refine=False,
        voxel_size_m=0.08,
    )
    decoder, encoder = Decoder(), Encoder(INFO, settings)
    states = list(decoder.frames(encoder.packets(recording(*numbers))))
    assert decoder.complete
    assert len(states) == len(numbers)
    assert encoder.reports[-1].status is PoseStatus.TRACKED


def test_chains_of_parts_are_joined() -> None:
    found: list[TrackedPose | None] = [
        TrackedPose(T_camera_object=identity(), status=PoseStatus.TRACKED, submap=part) for part in (0, 1, 2, 3)
    ]
    found.append(None)
    up = make_pose(np.eye(3), np.array([0.0, 1.0, 0.0]))
    joined = merge_submaps(found, {2: (up, 1), 1: (up, 0)})
    assert [at and at.submap for at in joined] == [0, 0, 0, 3, None]
    assert [at and at.T_camera_object[1, 3] for at in joined] == [0.0, 1.0, 2.0, 0.0, None]


def test_a_lost_frame_is_between_its_neighbors_only_within_a_part() -> None:
    up = make_pose(np.eye(3), np.array([0.0, 4.0, 0.0]))
    lost = TrackedPose(T_camera_object=identity(), status=PoseStatus.LOST)
    first, second = (TrackedPose(T_camera_object=pose, status=PoseStatus.TRACKED) for pose in (identity(), up))
    assert pose_between([first, lost, lost, lost, second], 1)[1, 3] == pytest.approx(1.0)
    far = replace(second, submap=1)
    for frame in (1, 3):
        np.testing.assert_array_equal(pose_between([first, lost, lost, lost, far], frame), identity())
    np.testing.assert_array_equal(pose_between([lost, far], 0), up)
    np.testing.assert_array_equal(pose_between([far, lost], 1), up)
    np.testing.assert_array_equal(pose_between([lost], 0), identity())


def test_short_runs_without_depth_are_bridged() -> None:
    def at(way: float, status: PoseStatus = PoseStatus.TRACKED, submap: int = 0) -> TrackedPose:
        return TrackedPose(T_camera_object=make_pose(np.eye(3), np.array([way, 0, 0])), status=status, submap=submap)

    def ways(found: list[TrackedPose | None], blind: list[bool], most: int = 3) -> list[float]:
        return [
            float(each.T_camera_object[0, 3])
            for each in interpolate_blind_frames(found, blind, most)
            if each is not None
        ]

    weak = at(9.0, PoseStatus.WEAK)
    run = [at(0.0), weak, weak, at(3.0), weak]
    blind = [False, True, True, False, False]
    assert ways(run, blind) == pytest.approx([0, 1, 2, 3, 9])
    assert ways(run, blind, most=1) == pytest.approx([0, 9, 9, 3, 9])
    assert ways([*run[:3], at(3.0, submap=1)], blind[:4]) == pytest.approx([0, 9, 9, 3])
    assert ways([weak, at(3.0), weak], [True, False, True]) == pytest.approx([9, 3, 9])
    assert ways([], []) == []
