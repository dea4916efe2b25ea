# SPDX-License-Identifier: MIT
"""Poses found again by picture features."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from threedvc.encoder.tracking import relocalization
from threedvc.encoder.tracking.relocalization import Keyframes
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import Pose, inverse, rotation_angle
from threedvc.synthesis import SyntheticSequence, make_scene

ROOM = SyntheticSequence(make_scene("room", frames=30, size=(320, 240)), threads=1)


@cache
def frame_of(number: int) -> Frame:
    return ROOM[number]


def everywhere(frame: int) -> np.ndarray:
    return np.ones(frame_of(frame).depth.shape, dtype=np.bool_)


def pose_of(frame: int) -> Pose:
    T = frame_of(frame).T_world_camera
    assert T is not None
    return inverse(T)


def kept(*numbers: int) -> Keyframes:
    keyframes = Keyframes(ROOM.info.rig)
    for number in numbers:
        keyframes.add(frame_of(number), everywhere(number), pose_of(number))
    return keyframes


@cache
def three_kept() -> Keyframes:
    return kept(0, 12, 24)


def assert_near(found: Pose, frame: int) -> None:
    error = found @ inverse(pose_of(frame))
    assert rotation_angle(error) < np.radians(2)
    assert np.linalg.norm(error[:3, 3]) < 0.05


def test_a_frame_is_found_among_keyframes_without_a_guess() -> None:
    hypotheses = three_kept().query(frame_of(13))
    assert hypotheses
    assert_near(hypotheses[0].T_camera_object, 13)


def test_depth_is_not_needed() -> None:
    blind = replace(frame_of(13), depth=np.zeros_like(frame_of(13).depth))
    assert_near(three_kept().query(blind)[0].T_camera_object, 13)


def test_frames_from_about_the_same_place_are_kept_once() -> None:
    assert len(kept(5, 5, 5)) == 1
    assert len(kept(0, 15, 29)) > 1


def test_features_of_other_pixels_do_not_count() -> None:
    assert not three_kept().query(frame_of(13), np.zeros_like(everywhere(13)))


def test_nothing_is_found_where_there_is_nothing() -> None:
    keyframes = kept(0, 12)
    dark = replace(frame_of(13), color=np.zeros_like(frame_of(13).color))
    assert not keyframes.query(dark)
    keyframes.add(dark, everywhere(13), pose_of(13) @ pose_of(29))
    assert len(keyframes) == len(kept(0, 12))
    noise = np.random.default_rng(0).integers(0, 256, dark.color.shape, dtype=np.uint8)
    assert not keyframes.query(replace(dark, color=noise))
    assert not Keyframes(ROOM.info.rig).query(frame_of(3))


def test_a_frame_without_depth_is_not_kept() -> None:
    keyframes = Keyframes(ROOM.info.rig)
    keyframes.add(replace(frame_of(0), depth=np.zeros_like(frame_of(0).depth)), everywhere(0), pose_of(0))
    assert len(keyframes) == 0


def test_of_many_keyframes_the_most_alike_are_matched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relocalization, "MAX_TRIED", 1)
    few = kept(0, 29)
    assert len(few) == 2
    assert_near(few.query(frame_of(0))[0].T_camera_object, 0)
    brighter = replace(frame_of(29), color=(frame_of(29).color // 2 + 90).astype(np.uint8))
    assert_near(few.query(brighter)[0].T_camera_object, 29)


def test_a_thinned_depth_picture_lifts_features_to_about_their_points() -> None:
    wide = SyntheticSequence(make_scene("room", frames=30, size=(640, 480)), threads=1)
    frame, camera = wide[0], wide.info.rig.color
    pixels = np.stack(np.meshgrid(np.arange(3, 640, 7.0), np.arange(3, 480, 7.0)), axis=-1).reshape(-1, 2)
    depth = frame.depth[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    points, found = Keyframes(wide.info.rig)._lift(frame, np.ones(frame.depth.shape, dtype=np.bool_), pixels)
    assert found[depth > 0].mean() > 0.95
    seen = found & (depth > 0)
    true = np.column_stack([camera.unproject_pixels(pixels), np.ones(len(pixels))]) * depth[:, None]
    errors = np.linalg.norm(points - true, axis=1)[seen] / depth[seen]
    assert np.median(errors) < 0.005
