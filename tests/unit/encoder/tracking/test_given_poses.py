# SPDX-License-Identifier: MIT
"""Poses of a recording against its depth: conventions, other recordings, shifted clocks, and frames without a pose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from helpers.streams import ListSequence
from threedvc.config import EncoderConfig, Motion
from threedvc.encoder.tracking.pose_agreement import PoseAgreement, measure_agreement
from threedvc.encoder.tracking.pose_completion import complete_poses
from threedvc.errors import ConfigError, SequenceError
from threedvc.formats.pose_check import settle_poses
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.pose import (
    Pose,
    compose,
    inverse,
    make_pose,
    quaternion,
    rotation_angle,
    rotation_from_quaternion,
)
from threedvc.geometry.pose_readings import pose_reading, reading_names
from threedvc.synthesis import SyntheticSequence, make_scene

COUNT = 20
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
BODY = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


class PosedSequence(ListSequence):
    """Frames in memory whose facts are known beforehand."""

    def facts(self) -> Sequence[Frame]:
        return list(self)


@pytest.fixture(scope="module")
def room() -> tuple[SequenceInfo, list[Frame]]:
    """Return a camera's way through a furnished room, every third frame of it."""
    sequence = SyntheticSequence(make_scene("room", frames=3 * COUNT, size=(112, 84), seed=3), threads=1)
    return sequence.info, [replace(sequence[3 * index], index=index) for index in range(COUNT)]


def with_poses(room: tuple[SequenceInfo, list[Frame]], poses: Sequence[Pose | None]) -> PosedSequence:
    info, frames = room
    posed = [replace(frame, T_world_camera=pose) for frame, pose in zip(frames, poses, strict=True)]
    return PosedSequence(posed, replace(info, has_camera_poses=all(pose is not None for pose in poses)))


def true_poses(room: tuple[SequenceInfo, list[Frame]]) -> list[Pose]:
    return [frame.T_world_camera for frame in room[1] if frame.T_world_camera is not None]


def measured(room: tuple[SequenceInfo, list[Frame]], poses: Sequence[Pose]) -> PoseAgreement:
    agreement = measure_agreement(with_poses(room, poses))
    assert agreement is not None
    return agreement


def wrong_order(pose: Pose) -> Pose:
    """Return what a pose written w x y z becomes when read x y z w."""
    x, y, z, w = quaternion(pose[:3, :3])
    return make_pose(rotation_from_quaternion(np.array([w, x, y, z])), pose[:3, 3])


def scaled(factor: float) -> Callable[[Pose], Pose]:
    return lambda pose: make_pose(pose[:3, :3], factor * pose[:3, 3])


def test_right_poses_agree(room: tuple[SequenceInfo, list[Frame]]) -> None:
    agreement = measured(room, true_poses(room))
    assert agreement.as_given < 0.03
    assert not agreement.contradicts


@pytest.mark.parametrize(
    ("written", "name"),
    [
        (inverse, "inverted"),
        (lambda pose: compose(pose, OPENGL), "opengl"),
        (lambda pose: compose(pose, inverse(BODY)), "body"),
        (lambda pose: inverse(compose(pose, OPENGL)), "inverted+opengl"),
        (wrong_order, "w-first"),
        (scaled(1000), "millimeters"),
        (scaled(100), "centimeters"),
        (lambda pose: scaled(1000)(inverse(pose)), "millimeters+inverted"),
    ],
)
def test_other_conventions_are_named(
    room: tuple[SequenceInfo, list[Frame]], written: Callable[[Pose], Pose], name: str
) -> None:
    given = [written(pose) for pose in true_poses(room)]
    agreement = measured(room, given)
    assert agreement.contradicts
    assert agreement.reading is not None
    assert agreement.reading.name == name
    assert f"use --poses {name}" in agreement.explanation
    read = [agreement.reading.convert(pose) for pose in given]
    assert not measured(room, read).contradicts


def test_poses_of_another_recording(room: tuple[SequenceInfo, list[Frame]]) -> None:
    way = [make_pose(pose[:3, :3].T, 0.5 * pose[:3, 3][[2, 0, 1]]) for pose in true_poses(room)[::-1]]
    agreement = measured(room, way)
    assert agreement.contradicts
    assert agreement.reading is None
    assert "poses contradict the depth: " in agreement.explanation


def test_poses_of_other_frames(room: tuple[SequenceInfo, list[Frame]]) -> None:
    poses = true_poses(room)
    agreement = measured(room, [*poses[4:], *[poses[-1]] * 4])
    assert agreement.contradicts
    assert agreement.shift is not None
    assert agreement.shift[0] == 4
    assert "poses look like those of 4 frames later: " in agreement.explanation


def test_shaking_poses_are_no_contradiction(room: tuple[SequenceInfo, list[Frame]]) -> None:
    random = np.random.default_rng(2)
    shaken = [make_pose(pose[:3, :3], pose[:3, 3] + random.normal(0, 0.004, 3)) for pose in true_poses(room)]
    assert not measured(room, shaken).contradicts


def test_no_two_frames_to_compare(room: tuple[SequenceInfo, list[Frame]]) -> None:
    blind = [replace(frame, depth=np.zeros_like(frame.depth)) for frame in room[1]]
    assert measure_agreement(PosedSequence(blind, room[0])) is None
    assert measure_agreement(PosedSequence(room[1][:1], room[0])) is None


def test_wrong_poses_are_set_aside_or_an_error(room: tuple[SequenceInfo, list[Frame]]) -> None:
    frames = with_poses(room, [inverse(pose) for pose in true_poses(room)])
    settled = settle_poses(frames, EncoderConfig())
    assert settled.config.motion is Motion.TRACK
    assert not settled.frames.info.has_camera_poses
    assert all(frame.T_world_camera is None for frame in settled.frames)
    (notice,) = settled.notices
    assert notice.warning
    assert "use --poses inverted; the camera is tracked instead" in notice.text
    with pytest.raises(SequenceError, match=r"use --poses inverted; correct them, or use --motion track$"):
        settle_poses(frames, EncoderConfig(motion=Motion.KNOWN))
    assert settle_poses(frames, EncoderConfig(motion=Motion.TRACK)).frames is frames


def test_right_poses_are_left_alone(room: tuple[SequenceInfo, list[Frame]]) -> None:
    frames, config = with_poses(room, true_poses(room)), EncoderConfig()
    settled = settle_poses(frames, config)
    assert (settled.frames, settled.config, settled.notices) == (frames, config, ())


def test_frames_without_a_pose_get_one(room: tuple[SequenceInfo, list[Frame]]) -> None:
    true = true_poses(room)
    missing = (0, 1, 5, 9, 10, 11, 12, 13, 19)
    frames = with_poses(room, [None if k in missing else pose for k, pose in enumerate(true)])
    settled = settle_poses(frames, EncoderConfig())
    assert settled.frames.info.has_camera_poses
    assert "11 of 20 frames have a pose; 1 is interpolated and 8 are found by registration" in settled.notices[0].text
    for k, frame in enumerate(settled.frames):
        assert frame.T_world_camera is not None
        off = compose(inverse(true[k]), frame.T_world_camera)
        assert np.linalg.norm(off[:3, 3]) < 0.01
        assert np.degrees(rotation_angle(off)) < 0.3


def test_few_poses_are_set_aside(room: tuple[SequenceInfo, list[Frame]]) -> None:
    frames = with_poses(room, [pose if k < 4 else None for k, pose in enumerate(true_poses(room))])
    settled = settle_poses(frames, EncoderConfig())
    assert settled.config.motion is Motion.TRACK
    assert "4 of 20 frames have a pose; the camera is tracked instead" in settled.notices[0].text


def test_frames_that_cannot_be_placed_are_told(room: tuple[SequenceInfo, list[Frame]]) -> None:
    info, frames = room
    blind = [replace(frame, depth=np.zeros_like(frame.depth)) if frame.index < 2 else frame for frame in frames]
    poses = [None if k < 2 else pose for k, pose in enumerate(true_poses(room))]
    completed = complete_poses(with_poses((info, blind), poses), poses)
    assert completed.missing == 2
    settled = settle_poses(with_poses((info, blind), poses), EncoderConfig())
    assert "2 cannot be placed beside their neighbors; the camera is tracked instead" in settled.notices[0].text


def test_readings_of_any_order_are_the_same() -> None:
    pose = make_pose(rotation_from_quaternion(np.array([0.1, 0.2, 0.3, 0.9])), np.array([1.0, 2.0, 3.0]))
    one, other = pose_reading("opengl+inverted"), pose_reading("inverted+opengl")
    assert one.name == other.name == "inverted+opengl"
    assert np.array_equal(one.convert(pose), other.convert(pose))
    assert np.array_equal(pose_reading("as-given").convert(pose), pose)


@pytest.mark.parametrize("name", ["upside-down", "inverted+", "inverted+inverted", "as-given+inverted", ""])
def test_unknown_readings(name: str) -> None:
    with pytest.raises(
        ConfigError, match=rf"^--poses {name.replace('+', '[+]')}: no such reading; choose from as-given, "
    ):
        pose_reading(name)
    assert name not in reading_names()
