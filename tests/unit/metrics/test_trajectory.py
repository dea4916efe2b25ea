# SPDX-License-Identifier: MIT
"""Measures of motion: poses with known answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threedvc.geometry.pose import Pose, inverse, make_pose, rotation_angle, rotation_from_vector
from threedvc.metrics.trajectory import (
    angles_between,
    mean_pose,
    object_pose_error,
    trajectory_error,
    travel,
)

SMALL = st.integers(0, 2**32 - 1)


def random_walk(rng: np.random.Generator, count: int = 20) -> list[Pose]:
    poses = [np.eye(4)]
    for _ in range(count - 1):
        poses.append(poses[-1] @ make_pose(rotation_from_vector(rng.normal(0, 0.05, 3)), rng.normal(0, 0.02, 3)))
    return poses


def some_pose(rng: np.random.Generator) -> Pose:
    return make_pose(rotation_from_vector(rng.normal(0, 1, 3)), rng.normal(0, 2, 3))


def placed(x: float = 0.0, z_deg: float = 0.0) -> Pose:
    return make_pose(rotation_from_vector(np.array([0, 0, math.radians(z_deg)])), np.array([x, 0, 0]))


class TestAngles:
    @given(SMALL)
    def test_those_of_the_transform_between(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        first, second = some_pose(rng), some_pose(rng)
        (angle,) = angles_between(first[None, :3, :3], second[None, :3, :3])
        assert angle == pytest.approx(rotation_angle(inverse(first) @ second), abs=1e-6)

    def test_a_half_turn_and_none(self) -> None:
        turned = np.array([placed(z_deg=180)[:3, :3], np.eye(3)])
        assert np.degrees(angles_between(turned, np.eye(3)[None])) == pytest.approx([180, 0])


class TestTravel:
    def test_there_and_back(self) -> None:
        found = travel([placed(0, 0), placed(0.1, 10), placed(0.4, 40), placed(0, 0)])
        assert (found.length_m, found.turn_deg) == pytest.approx((0.8, 80))
        assert (found.largest_distance_m, found.largest_turn_deg) == pytest.approx((0.4, 40))
        assert (found.largest_step_m, found.largest_step_deg) == pytest.approx((0.4, 40))

    def test_the_point_tells_how_far_and_not_the_origin(self) -> None:
        around = [placed(z_deg=angle) for angle in (0, 60, 120)]
        assert travel(around).length_m == 0
        away = travel(around, np.array([0.5, 0, 2]))
        assert away.length_m == pytest.approx(1.0)
        assert away.largest_distance_m == pytest.approx(math.sqrt(3) / 2)
        assert away.turn_deg == pytest.approx(120)

    def test_single_pose(self, rng: np.random.Generator) -> None:
        found = travel([some_pose(rng)])
        assert (found.length_m, found.turn_deg, found.largest_step_m, found.largest_step_deg) == (0, 0, 0, 0)
        assert (found.largest_distance_m, found.largest_turn_deg) == (0, 0)


class TestTrajectory:
    @given(SMALL)
    def test_another_world_frame_is_no_error(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        walk, moved = random_walk(rng), some_pose(rng)
        error = trajectory_error(walk, [moved @ pose for pose in walk])
        assert (error.ate_rmse_mm, error.ate_max_mm, error.rpe_translation_mm) == pytest.approx((0, 0, 0), abs=1e-6)
        assert error.rpe_rotation_deg == pytest.approx(0, abs=1e-5)

    def test_scale_is_an_error(self) -> None:
        line = [make_pose(np.eye(3), np.array([0.1 * k, 0, 0])) for k in range(3)]
        double = [make_pose(np.eye(3), np.array([0.2 * k, 0, 0])) for k in range(3)]
        error = trajectory_error(line, double)
        assert error.ate_max_mm == pytest.approx(100)
        assert error.ate_rmse_mm == pytest.approx(1000 * math.sqrt(0.02 / 3))
        assert error.rpe_translation_mm == pytest.approx(100)

    def test_rotation_error_of_a_step(self) -> None:
        still = [np.eye(4)] * 3
        error = trajectory_error(still, [placed(z_deg=2 * k) for k in range(3)])
        assert error.rpe_rotation_deg == pytest.approx(2)
        assert error.ate_rmse_mm == pytest.approx(0)

    def test_one_bad_step_hardly_moves_the_median(self) -> None:
        # Steps are wrong by 1, 1 and 7 mm and degrees.
        found = [placed(x, angle) for x, angle in ((0, 0), (0.001, 1), (0.002, 2), (0.009, 9))]
        error = trajectory_error([np.eye(4)] * 4, found)
        assert (error.rpe_translation_median_mm, error.rpe_rotation_median_deg) == pytest.approx((1, 1))
        assert (error.rpe_translation_mm, error.rpe_rotation_deg) == pytest.approx((math.sqrt(17), math.sqrt(17)))

    def test_steps_across_a_gap_do_not_count(self) -> None:
        found = [placed(), placed(0.001), placed(0.5), placed(0.501)]
        error = trajectory_error([np.eye(4)] * 4, found, [0, 1, 7, 8])
        assert error.rpe_translation_mm == pytest.approx(1)
        assert trajectory_error([np.eye(4)] * 2, found[:2], [3, 5]).rpe_translation_mm == 0

    def test_the_direction_of_a_step_counts_and_not_the_way_it_is_seen(self, rng: np.random.Generator) -> None:
        # Steps of 3 mm forward against steps of 3 mm sideways, from cameras that look elsewhere.
        start = some_pose(rng)
        true = [start @ make_pose(np.eye(3), np.array([0, 0, 0.003 * k])) for k in range(4)]
        found = [make_pose(np.eye(3), np.array([0.003 * k, 0, 0])) for k in range(4)]
        error = trajectory_error(true, found)
        assert error.rpe_translation_mm == pytest.approx(3 * math.sqrt(2))
        assert error.ate_rmse_mm == pytest.approx(0, abs=1e-9)

    def test_single_pose(self, rng: np.random.Generator) -> None:
        error = trajectory_error([some_pose(rng)], [inverse(some_pose(rng))])
        assert (error.frames, error.rpe_translation_mm, error.rpe_rotation_deg) == (1, 0, 0)
        assert (error.rpe_translation_median_mm, error.rpe_rotation_median_deg) == (0, 0)
        assert error.ate_rmse_mm == pytest.approx(0, abs=1e-9)


class TestObjectPoses:
    @given(SMALL)
    def test_another_object_frame_is_no_error(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        walk, T_codec_object = random_walk(rng), some_pose(rng)
        error = object_pose_error([pose @ T_codec_object for pose in walk], walk)
        assert error.frames == 20
        assert (error.rotation_max_deg, error.translation_max_mm) == pytest.approx((0, 0), abs=1e-6)

    def test_another_camera_frame_is_an_error(self) -> None:
        # An object turns before the camera; poses as seen from beside it cannot be explained by its own frame.
        true = [placed(z_deg=angle) for angle in range(0, 360, 10)]
        error = object_pose_error(true, [placed(0.05) @ pose for pose in true])
        assert error.translation_median_mm == pytest.approx(50)
        assert error.rotation_max_deg == pytest.approx(0, abs=1e-6)

    def test_known_errors(self) -> None:
        # Errors of opposite signs leave the alignment alone.
        true, wrong = [np.eye(4)] * 6, (-5, -1, 0, 0, 1, 5)
        shifted = object_pose_error(true, [placed(x / 1000) for x in wrong])
        assert (shifted.translation_median_mm, shifted.translation_max_mm) == pytest.approx((1, 5))
        assert shifted.translation_rmse_mm == pytest.approx(math.sqrt(52 / 6))
        turned = object_pose_error(true, [placed(z_deg=x) for x in wrong])
        assert (turned.rotation_median_deg, turned.rotation_max_deg) == pytest.approx((1, 5))
        assert turned.rotation_rmse_deg == pytest.approx(math.sqrt(52 / 6))
        assert (shifted.rotation_max_deg, turned.translation_max_mm) == pytest.approx((0, 0), abs=1e-6)

    def test_the_mean_does_not_depend_on_where_one_looks(self, rng: np.random.Generator) -> None:
        poses, moved = np.array(random_walk(rng)), some_pose(rng)
        assert np.allclose(mean_pose(moved @ poses), moved @ mean_pose(poses))
        turned = mean_pose(poses @ make_pose(moved[:3, :3], np.zeros(3)))
        assert np.allclose(turned[:3, :3], mean_pose(poses)[:3, :3] @ moved[:3, :3])

    def test_single_pose(self, rng: np.random.Generator) -> None:
        error = object_pose_error([some_pose(rng)], [some_pose(rng)])
        assert (error.frames, error.rotation_max_deg) == (1, pytest.approx(0, abs=1e-6))
        assert error.translation_max_mm == pytest.approx(0, abs=1e-9)
