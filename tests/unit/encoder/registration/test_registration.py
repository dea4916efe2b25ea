# SPDX-License-Identifier: MIT
"""Registration on scenes whose every pixel is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from helpers.registration_scene import (
    BOX,
    CAMERA,
    LENS,
    MOTION,
    T_CAMERA_BOX,
    assert_found,
    errors,
    moved,
    noise,
    noisy,
    problem,
    run,
    sample_of,
)
from reference.registration import ROOM, WALL, Planes, Sphere, draw
from threedvc.encoder.registration.icp import Alignment
from threedvc.encoder.registration.initial_poses import initial_poses, pose_from_features, predict, register_multi_start
from threedvc.encoder.registration.registration import (
    DepthSample,
    ModelView,
    Registration,
    RegistrationConfig,
    is_stationary,
    register,
    view_of_frame,
)
from threedvc.errors import ConfigError
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, identity, inverse, is_rigid, make_pose, rotation_angle, rotation_from_vector
from threedvc.stream.pose_status import PoseStatus


class TestRecovery:
    @pytest.mark.parametrize("camera", [CAMERA, LENS], ids=["pinhole", "lens"])
    @pytest.mark.parametrize("plain", [False, True], ids=["textured", "plain"])
    def test_camera_in_a_room(self, camera: Camera, plain: bool) -> None:
        view, seen = draw(camera, identity(), ROOM, plain=plain), draw(camera, MOTION, ROOM, plain=plain)
        assert_found(run(seen, view, identity()), MOTION)

    def test_view_may_be_cast_from_another_pose_than_the_guess(self) -> None:
        view = draw(CAMERA, moved((0.0, 0.02, 0.0), (-0.01, 0.01, 0.02)), ROOM)
        assert_found(run(draw(CAMERA, MOTION, ROOM), view, identity()), MOTION)

    def test_object_before_nothing(self) -> None:
        true = moved((0.05, -0.08, 0.03), (0.01, 0.005, -0.01)) @ T_CAMERA_BOX
        assert_found(run(draw(CAMERA, true, BOX), draw(CAMERA, T_CAMERA_BOX, BOX), T_CAMERA_BOX), true)

    def test_texture_tells_how_a_sphere_turned(self) -> None:
        start = make_pose(np.eye(3), np.array([0.0, 0.0, 0.8]))
        true = start @ moved((0.02, 0.04, -0.03), (0.0, 0.0, 0.0))
        shape = Sphere(0.2)
        result = run(draw(CAMERA, true, shape), draw(CAMERA, start, shape), start)
        assert_found(result, true, degrees=0.3)
        plain = run(draw(CAMERA, true, shape, plain=True), draw(CAMERA, start, shape, plain=True), start)
        assert plain.status is PoseStatus.WEAK
        assert rotation_angle(plain.T_camera_object @ inverse(start)) < 1e-3

    def test_noise_averages_out(self, rng: np.random.Generator) -> None:
        result = run(noisy(draw(CAMERA, MOTION, ROOM), rng), draw(CAMERA, identity(), ROOM), identity())
        assert_found(result, MOTION)
        assert 0.001 < result.residual_m < 0.01

    @pytest.mark.parametrize("luma_weight", [0.0, 1.0])
    def test_unknown_model_and_holes_give_no_residual(self, luma_weight: float, rng: np.random.Generator) -> None:
        view, seen = draw(CAMERA, identity(), ROOM), draw(CAMERA, MOTION, ROOM)
        unknown = rng.random((12, 16)).repeat(10, axis=0).repeat(10, axis=1) < 0.4
        view.depth[unknown], view.normals[unknown], view.intensity[unknown] = 0, 0, np.nan
        seen.depth[rng.random(seen.depth.shape) < 0.2] = 0
        result = run(seen, view, identity(), luma_weight=luma_weight)
        assert_found(result, MOTION)
        assert result.overlap < 0.75
        assert result.inlier_fraction > 0.8

    def test_only_masked_pixels_count(self) -> None:
        true = moved((0.03, 0.05, 0.0), (0.01, 0.0, 0.01)) @ T_CAMERA_BOX
        box, wall = draw(CAMERA, true, BOX), draw(CAMERA, moved((0, 0, 0), (0.1, 0.05, -0.3)), WALL)
        mask = box.depth > 0
        depth = np.where(mask, box.depth, wall.depth)
        luma = np.where(mask, box.intensity, wall.intensity)
        seen = replace(box, depth=depth, intensity=luma)
        assert_found(run(seen, draw(CAMERA, T_CAMERA_BOX, BOX), T_CAMERA_BOX, mask), true)

    def test_something_that_moves_otherwise_is_outvoted(self) -> None:
        seen = draw(CAMERA, MOTION, ROOM)
        seen.depth[30:70, 40:80] -= np.float32(0.25)
        seen.intensity[30:70, 40:80] = 200
        result = run(seen, draw(CAMERA, identity(), ROOM), identity())
        assert_found(result, MOTION)
        assert result.inlier_fraction < 0.95

    @pytest.mark.parametrize("detail_pixels", [0, 11])
    def test_exposure_does_not_matter(self, detail_pixels: int) -> None:
        seen = draw(CAMERA, moved((0.0, 0.0, 0.0), (0.015, -0.01, 0.0)), WALL)
        seen = replace(seen, intensity=(1.4 * seen.intensity - 35).astype(np.float32))
        result = run(seen, draw(CAMERA, identity(), WALL), identity(), detail_pixels=detail_pixels)
        assert_found(result, moved((0, 0, 0), (0.015, -0.01, 0)))


class TestDegenerate:
    def test_plain_wall_does_not_slide(self, rng: np.random.Generator) -> None:
        seen = noisy(draw(CAMERA, moved((0.02, -0.01, 0.0), (0.0, 0.0, 0.03)), WALL, plain=True), rng)
        result = run(seen, draw(CAMERA, identity(), WALL, plain=True), identity())
        assert result.status is PoseStatus.WEAK
        assert result.conditioning < RegistrationConfig().min_conditioning
        assert np.abs(result.T_camera_object @ [0.0, 0.0, 1.5, 1.0] - [0.0, 0.0, 1.53, 1.0]).max() < 0.001
        assert abs(result.T_camera_object[1, 0]) < 1e-3
        tilt = moved((0.02, -0.01, 0.0), (0.0, 0.0, 0.0))
        np.testing.assert_allclose(result.T_camera_object[:3, 2], tilt[:3, 2], atol=1e-3)

    def test_wall_seen_by_noise_alone_keeps_the_prediction(self, rng: np.random.Generator) -> None:
        first, second = (noisy(draw(CAMERA, identity(), WALL, plain=True), rng) for _ in range(2))
        view = view_of_frame(sample_of(first), identity(), reach=4)
        guess = moved((0.0, 0.0, 0.01), (0.02, -0.01, 0.0))
        result = run(second, view, guess)
        shift, _ = errors(result.T_camera_object, guess, (0.0, 0.0, 1.5))
        assert shift < 3.0

    def test_textured_wall_is_followed(self) -> None:
        true = moved((0.01, 0.0, 0.02), (0.02, -0.015, 0.01))
        assert_found(run(draw(CAMERA, true, WALL), draw(CAMERA, identity(), WALL), identity()), true)

    def test_corridor_keeps_only_its_own_direction(self) -> None:
        corridor = Planes(np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, -1.0, 0]]), np.array([-0.6, -0.6, -0.5]))
        true, guess = moved((0.0, 0.01, 0.01), (0.02, 0.01, 0.05)), moved((0, 0, 0), (0.0, 0.0, 0.01))
        view = draw(CAMERA, identity(), corridor, plain=True)
        result = run(draw(CAMERA, true, corridor, plain=True), view, guess)
        assert result.status is PoseStatus.WEAK
        np.testing.assert_allclose(result.T_camera_object[:3, 3], [0.02, 0.01, 0.01], atol=0.002)


class TestFailure:
    def assert_lost(self, result: Registration, guess: Pose) -> None:
        assert result.status is PoseStatus.LOST
        np.testing.assert_array_equal(result.T_camera_object, guess)

    def test_nothing_measured(self) -> None:
        view = draw(CAMERA, identity(), ROOM)
        seen = replace(view, depth=np.zeros_like(view.depth))
        self.assert_lost(run(seen, view, MOTION), MOTION)

    def test_nothing_known(self) -> None:
        seen = draw(CAMERA, identity(), ROOM)
        self.assert_lost(run(seen, replace(seen, depth=np.zeros_like(seen.depth)), MOTION), MOTION)

    def test_another_scene(self) -> None:
        view = draw(CAMERA, identity(), ROOM)
        other = Planes(np.array([[-0.6, 0.0, -0.8], [0.0, 0.8, -0.6]]), np.array([-1.0, -1.3]))
        self.assert_lost(run(draw(CAMERA, identity(), other), view, identity()), identity())

    def test_covered_lens(self, rng: np.random.Generator) -> None:
        view = draw(CAMERA, identity(), ROOM)
        depth = rng.uniform(0.4, 3.0, size=view.depth.shape).astype(np.float32)
        self.assert_lost(run(replace(view, depth=depth), view, identity()), identity())

    def test_implausible_jump(self) -> None:
        view, seen = draw(CAMERA, identity(), ROOM), draw(CAMERA, MOTION, ROOM)
        assert run(seen, view, identity()).status is PoseStatus.TRACKED
        self.assert_lost(run(seen, view, identity(), max_turn_rad=0.01), identity())
        self.assert_lost(run(seen, view, identity(), max_shift=0.005), identity())

    def test_mostly_unknown_is_weak(self) -> None:
        view, seen = draw(CAMERA, identity(), ROOM), draw(CAMERA, MOTION, ROOM)
        view.depth[:, : CAMERA.width * 3 // 4] = 0
        assert run(seen, view, identity()).status is PoseStatus.WEAK

    def test_sizes_must_agree(self) -> None:
        view = draw(CAMERA, identity(), ROOM)
        with pytest.raises(ConfigError, match=r"^depth has shape \(3, 4\), the camera asks for \(120, 160\)$"):
            DepthSample(np.zeros((3, 4), np.float32), view.intensity, None, CAMERA)
        with pytest.raises(ConfigError, match=r"^view normals has shape \(120, 160\)"):
            replace(view, normals=view.depth)
        with pytest.raises(ConfigError, match="another camera"):
            problem(replace(view, camera=LENS), view)

    @pytest.mark.parametrize(
        ("options", "text"),
        [
            ({"levels": 0}, "levels 0 .* must be at least 1"),
            ({"luma_noise": 0.0}, "luma noise 0.0 must be positive"),
            ({"fine_gate": 0.2}, "gate bounds of registration 0.2, 0.1 must be"),
            ({"weak_overlap": 0.1}, "overlap bounds of registration 0.15, 0.1 must be"),
        ],
    )
    def test_impossible_choices(self, options: dict[str, Any], text: str) -> None:
        with pytest.raises(ConfigError, match=text):
            RegistrationConfig(**options)


class TestRobustness:
    def test_result_does_not_depend_on_threads(self, rng: np.random.Generator) -> None:
        camera = CAMERA.resized(256, 192)
        view, seen = draw(camera, identity(), ROOM), noisy(draw(camera, MOTION, ROOM), rng)
        results = [
            register(replace(problem(seen, view, samples=60000), threads=threads), identity()) for threads in (1, 2, 3)
        ]
        for result in results[1:]:
            np.testing.assert_array_equal(result.T_camera_object, results[0].T_camera_object)
            assert result.residual_m == results[0].residual_m

    def test_noise_may_be_a_picture(self) -> None:
        view, seen = draw(CAMERA, identity(), ROOM), draw(CAMERA, MOTION, ROOM)
        sigma = noise(seen.depth).astype(np.float32)
        result = register(replace(problem(seen, view), sigma_m=sigma), identity())
        assert_found(result, MOTION)

    def test_input_need_not_be_contiguous(self) -> None:
        view, seen = draw(CAMERA, identity(), ROOM), draw(CAMERA, MOTION, ROOM)
        depth, luma = np.repeat(seen.depth, 2, axis=1)[:, ::2], np.asfortranarray(seen.intensity)
        result = run(replace(seen, depth=depth, intensity=luma), view, identity())
        np.testing.assert_array_equal(result.T_camera_object, run(seen, view, identity()).T_camera_object)

    def test_absurdly_far_readings_do_no_harm(self, rng: np.random.Generator) -> None:
        seen = draw(CAMERA, MOTION, ROOM)
        seen.depth[rng.random(seen.depth.shape) < 0.05] = 65.0
        assert_found(run(seen, draw(CAMERA, identity(), ROOM), identity()), MOTION)

    def test_depth_that_fits_badly_is_not_overruled_by_luma(self, rng: np.random.Generator) -> None:
        view = draw(CAMERA, identity(), ROOM)
        depth = view.depth + rng.normal(size=view.depth.shape) * 5 * noise(view.depth)
        luma = np.roll(view.intensity, 2, axis=1)
        alignment = Alignment(problem(replace(view, depth=depth.astype(np.float32), intensity=luma), view))
        shift, _ = errors(alignment.solve(identity()).T_camera_object, identity(), (0.0, 0.0, 1.5))
        assert shift < 6.0

    def test_poses_stay_rigid_over_many_predictions(self) -> None:
        start = draw(CAMERA, identity(), ROOM)
        before = previous = identity()
        for _ in range(60):
            guess = predict(before, previous)
            view = replace(start, T_camera_object=guess)
            found = run(start, view, guess)
            before, previous = previous, found.T_camera_object
        assert is_rigid(previous, 1e-12)
        np.testing.assert_allclose(previous, identity(), atol=1e-6)

    def test_a_small_object_uses_every_pixel(self) -> None:
        camera = CAMERA.resized(64, 48)
        true = moved((0.02, 0.03, 0.0), (0.005, 0.0, 0.0)) @ T_CAMERA_BOX
        view = draw(camera, T_CAMERA_BOX, BOX)
        result = run(draw(camera, true, BOX), view, T_CAMERA_BOX)
        assert_found(result, true, mm=1.0, degrees=0.3)


class TestRest:
    def decide(self, seen: ModelView, view: ModelView, previous: Pose, resting: bool) -> tuple[bool, Registration]:
        found = run(seen, view, previous)
        still = is_stationary(problem(seen, view), previous, found, resting=resting)
        return still, found

    @pytest.mark.parametrize("resting", [True, False])
    def test_noise_is_no_motion(self, resting: bool, rng: np.random.Generator) -> None:
        view = draw(CAMERA, T_CAMERA_BOX, BOX)
        for _ in range(5):
            still, _ = self.decide(noisy(view, rng), view, T_CAMERA_BOX, resting)
            assert still

    @pytest.mark.parametrize("resting", [True, False])
    def test_a_pixel_of_motion_is_seen(self, resting: bool, rng: np.random.Generator) -> None:
        true = moved((0, 0, 0), (0.9 / 130, 0, 0)) @ T_CAMERA_BOX
        view, seen = draw(CAMERA, T_CAMERA_BOX, BOX), noisy(draw(CAMERA, true, BOX), rng)
        still, _ = self.decide(seen, view, T_CAMERA_BOX, resting)
        assert not still

    def test_slow_motion_is_followed_within_a_fraction_of_a_pixel(self, rng: np.random.Generator) -> None:
        view, previous, resting = draw(CAMERA, T_CAMERA_BOX, BOX), T_CAMERA_BOX, True
        pixel = 0.9 / CAMERA.fx
        steps = 0
        for step in range(1, 21):
            true = moved((0, 0, 0), (0.08 * step * pixel, 0, 0)) @ T_CAMERA_BOX
            resting, found = self.decide(noisy(draw(CAMERA, true, BOX), rng), view, previous, resting)
            previous = previous if resting else found.T_camera_object
            steps += not resting
            assert np.linalg.norm((previous - true)[:3, 3]) < 0.5 * pixel
        assert steps >= 4

    def test_a_lost_object_does_not_rest(self) -> None:
        view = draw(CAMERA, T_CAMERA_BOX, BOX)
        still, found = self.decide(replace(view, depth=np.zeros_like(view.depth)), view, T_CAMERA_BOX, True)
        assert found.status is PoseStatus.LOST
        assert not still


class TestStarts:
    def test_constant_velocity(self) -> None:
        np.testing.assert_allclose(predict(identity(), MOTION), MOTION @ MOTION, atol=1e-12)

    @pytest.mark.parametrize("axis", range(3))
    def test_a_large_turn_is_found(self, axis: int) -> None:
        turn = np.zeros(3)
        turn[axis] = 0.45
        place = make_pose(np.eye(3), T_CAMERA_BOX[:3, 3] + [0.02, 0, 0])
        true = place @ make_pose(rotation_from_vector(turn) @ T_CAMERA_BOX[:3, :3], np.zeros(3))
        view, seen = draw(CAMERA, T_CAMERA_BOX, BOX), draw(CAMERA, true, BOX)
        result = register_multi_start(problem(seen, view), T_CAMERA_BOX)
        assert_found(result, true)

    def test_a_good_guess_is_all_it_takes(self) -> None:
        view, seen = draw(CAMERA, identity(), ROOM), draw(CAMERA, MOTION, ROOM)
        result = register_multi_start(problem(seen, view), identity())
        np.testing.assert_array_equal(result.T_camera_object, run(seen, view, identity()).T_camera_object)

    def test_another_scene_stays_lost(self) -> None:
        view, seen = draw(CAMERA, identity(), ROOM), draw(CAMERA, moved((0.0, 0.0, 0.0), (0.0, 0.0, 0.6)), Sphere(0.3))
        result = register_multi_start(problem(seen, view), MOTION)
        assert result.status is PoseStatus.LOST
        np.testing.assert_array_equal(result.T_camera_object, MOTION)

    def test_features_find_a_large_motion(self, rng: np.random.Generator) -> None:
        camera = CAMERA.resized(320, 240)
        true = moved((0.0, 0.0, 0.3), (0.1, 0.0, 0.0))
        view, seen = (self.speckled(camera, pose) for pose in (identity(), true))
        found = pose_from_features(sample_of(seen), view)
        assert found is not None
        shift, turn = errors(found, true, (0.0, 0.0, 1.5))
        assert shift < 20
        assert turn < 1.0

    def speckled(self, camera: Camera, pose: Pose) -> ModelView:
        """Draw the wall with squares of random brightness on it."""
        view = draw(camera, pose, WALL)
        rays = np.concatenate([camera.rays(), np.ones((camera.height, camera.width, 1))], axis=-1)
        points = (rays * view.depth[..., None]) @ pose[:3, :3] - pose[:3, 3] @ pose[:3, :3]
        cells = np.floor(points[..., :2] / 0.06).astype(int)
        shades = np.random.default_rng(3).uniform(0, 255, (64, 64))
        return replace(view, intensity=shades[cells[..., 1] % 64, cells[..., 0] % 64].astype(np.float32))

    def test_features_need_texture(self) -> None:
        view = draw(CAMERA, identity(), WALL, plain=True)
        assert pose_from_features(sample_of(view), view) is None

    def test_nothing_to_start_from(self) -> None:
        view = draw(CAMERA, MOTION, WALL)
        empty = replace(view, depth=np.zeros_like(view.depth))
        starts = list(initial_poses(sample_of(empty), view))
        assert len(starts) == 1
        np.testing.assert_array_equal(starts[0], MOTION)


class TestFrameView:
    @pytest.mark.parametrize("camera", [CAMERA, LENS], ids=["pinhole", "lens"])
    def test_normals_are_those_of_the_scene(self, camera: Camera) -> None:
        exact = draw(camera, MOTION, ROOM)
        view = view_of_frame(sample_of(exact), MOTION)
        cosines = np.sum(view.normals * exact.normals, axis=2)[view.depth > 0]
        assert np.mean(cosines > 0.999) > 0.95

    def test_shows_the_object_alone(self) -> None:
        exact = draw(CAMERA, identity(), ROOM)
        mask = np.zeros(exact.depth.shape, dtype=bool)
        mask[20:60, 30:90] = True
        view = view_of_frame(sample_of(exact, mask), identity())
        assert not view.depth[~mask].any()
        assert np.isnan(view.intensity[~mask]).all()
        np.testing.assert_array_equal(np.any(view.normals != 0, axis=2), view.depth > 0)
