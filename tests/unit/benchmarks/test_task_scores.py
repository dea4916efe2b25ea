# SPDX-License-Identifier: MIT
"""Scores of tasks: steps become trajectories, surfaces are held against each other, matches against geometry."""

from __future__ import annotations

import numpy as np
import pytest

from task_scores import View, agreeing_matches, chained, f_score, trajectory_scores
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, make_pose, rotation_from_vector

CAMERA = Camera(width=200, height=150, fx=180.0, fy=180.0, cx=99.5, cy=74.5)
SHIFT_PX, DEPTH_M = 9, 2.0


def step(x: float = 0.0, turn: float = 0.0) -> Pose:
    return make_pose(rotation_from_vector(np.array([0.0, turn, 0.0])), np.array([x, 0.0, 0.0]))


def textured() -> np.ndarray:
    coarse = np.random.default_rng(3).integers(0, 256, (30, 42), dtype=np.uint8)
    return np.repeat(np.kron(coarse, np.ones((5, 5), dtype=np.uint8))[..., None], 3, axis=2)


def views(moved_px: int = SHIFT_PX, depth_m: float = DEPTH_M) -> tuple[View, View]:
    """Return a plane as two cameras side by side see it, shifted by some pixels."""
    wide = textured()
    depth = np.full((CAMERA.height, CAMERA.width), depth_m, dtype=np.float32)
    to_right = step(SHIFT_PX * DEPTH_M / CAMERA.fx)
    return (
        View(color=np.ascontiguousarray(wide[:, : CAMERA.width]), depth=depth, T_world_camera=np.eye(4)),
        View(
            color=np.ascontiguousarray(wide[:, moved_px : moved_px + CAMERA.width]),
            depth=depth,
            T_world_camera=to_right,
        ),
    )


class TestTrajectory:
    def test_steps_are_joined_in_their_order(self) -> None:
        poses = chained([step(1.0), step(turn=np.pi / 2), step(1.0)])
        assert len(poses) == 4
        assert poses[-1][:3, 3] == pytest.approx([1.0, 0.0, -1.0])

    def test_true_steps_have_no_error_wherever_the_world_is(self) -> None:
        steps = [step(0.1, 0.02), step(0.1, -0.03), step(0.05, 0.01)]
        truth = [step(3.0, 1.0) @ pose for pose in chained(steps)]
        assert trajectory_scores(truth, steps) == pytest.approx({"ate_mm": 0, "rpe_mm": 0, "rpe_deg": 0}, abs=1e-4)

    def test_a_step_that_is_too_long_counts(self) -> None:
        truth = chained([step(0.1), step(0.1)])
        scores = trajectory_scores(truth, [step(0.1), step(0.13)])
        assert scores["rpe_mm"] == pytest.approx(30 / np.sqrt(2))
        assert 0 < scores["ate_mm"] < 30


class TestFScore:
    def test_harmonic_mean_of_both_shares(self) -> None:
        near, far = np.array([0.0, 0.01]), np.array([0.0, 0.01, 0.02, 0.03])
        assert f_score(near, near, 0.01) == 1
        assert f_score(near, far, 0.01) == pytest.approx(2 * 0.5 / 1.5)
        assert f_score(far, near, 0.01) == f_score(near, far, 0.01)

    def test_nothing_found_or_nothing_right_is_zero(self) -> None:
        assert f_score(np.zeros(0), np.ones(3), 0.01) == 0
        assert f_score(np.ones(3), np.ones(3), 0.01) == 0


class TestMatches:
    def test_matches_that_geometry_confirms_count(self) -> None:
        assert agreeing_matches(*views(), CAMERA) > 100

    def test_matches_that_contradict_geometry_do_not(self) -> None:
        assert agreeing_matches(*views(moved_px=SHIFT_PX + 5), CAMERA) < 20

    def test_points_without_depth_do_not(self) -> None:
        assert agreeing_matches(*views(depth_m=0.0), CAMERA) == 0

    def test_pictures_without_texture_have_none(self) -> None:
        flat = View(
            color=np.full((CAMERA.height, CAMERA.width, 3), 90, dtype=np.uint8),
            depth=np.ones((CAMERA.height, CAMERA.width), dtype=np.float32),
            T_world_camera=np.eye(4),
        )
        assert agreeing_matches(flat, views()[1], CAMERA) == 0
