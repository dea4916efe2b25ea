# SPDX-License-Identifier: MIT
"""Loops of registration against slow references."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.registration_scene import CAMERA, LENS, MOTION, moved, problem, view_pictures
from reference import registration as reference
from reference.registration import ROOM, WALL, draw
from threedvc.encoder.registration.icp import Alignment
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, identity, inverse, make_pose
from threedvc.kernels.encoder import registration as kernels


class TestKernels:
    def test_halved_luma(self, rng: np.random.Generator) -> None:
        luma = rng.uniform(0, 255, (11, 14)).astype(np.float32)
        luma[rng.random(luma.shape) < 0.3] = np.nan
        halved = np.empty((5, 7), dtype=np.float32)
        kernels.halve_luma(luma, halved, 0, 5)
        np.testing.assert_array_equal(halved, reference.halved(luma))

    def test_sampled_luma(self, rng: np.random.Generator) -> None:
        luma = rng.uniform(0, 255, (6, 8)).astype(np.float32)
        samples = np.zeros((50, 8))
        samples[:, 6:] = rng.uniform(0, [15, 11], (50, 2))
        values = np.empty(50)
        kernels.sample_luma(luma, 0.5, samples, values, 0, 50)
        expected = [reference.bilinear(luma, (u + 0.5) / 2 - 0.5, (v + 0.5) / 2 - 0.5) for u, v in samples[:, 6:]]
        np.testing.assert_allclose(values, expected, rtol=1e-6)

    def test_projection_and_its_derivative(self, rng: np.random.Generator) -> None:
        parameters = LENS.parameters()
        for x, y in rng.uniform(-0.5, 0.5, (20, 2)):
            u, v, ux, uy, vx, vy = kernels.project(parameters, x, y)
            np.testing.assert_allclose([u, v], LENS.project(np.array([x, y, 1.0])), rtol=1e-12)
            h = 1e-6
            by_x = (LENS.project(np.array([x + h, y, 1.0])) - LENS.project(np.array([x - h, y, 1.0]))) / (2 * h)
            by_y = (LENS.project(np.array([x, y + h, 1.0])) - LENS.project(np.array([x, y - h, 1.0]))) / (2 * h)
            np.testing.assert_allclose([ux, vx, uy, vy], [*by_x, *by_y], atol=1e-5)

    @pytest.mark.parametrize("camera", [CAMERA, LENS], ids=["pinhole", "lens"])
    def test_association(self, camera: Camera, rng: np.random.Generator) -> None:
        camera = camera.resized(40, 30)
        view, seen = draw(camera, identity(), ROOM), draw(camera, MOTION, ROOM)
        view.depth[rng.random(view.depth.shape) < 0.2] = 0
        view.intensity[rng.random(view.depth.shape) < 0.1] = np.nan
        seen.depth[rng.random(seen.depth.shape) < 0.2] *= np.float32(1.2)
        alignment = Alignment(problem(seen, view, levels=1, detail_pixels=0))
        samples, gates = alignment.samples[0], np.array([0.05, 6.0, 0.7])
        rows, states = np.empty((len(samples), kernels.ROW)), np.empty(len(samples), dtype=np.uint8)
        T_view_frame = inverse(MOTION) @ moved((0, 0.01, 0), (0.01, 0, 0))
        pictures = view_pictures(view, camera)
        kernels.associate(
            samples.surface, samples.luma, samples.sigma, pictures, T_view_frame, gates, rows, states, 0, len(samples)
        )
        expected = [
            reference.associated(sample, sigma, view, T_view_frame, gates)
            for sample, sigma in zip(samples.surface, samples.sigma, strict=True)
        ]
        np.testing.assert_array_equal(states, [state for state, _, _ in expected])
        assert set(states) == {kernels.UNSEEN, kernels.BEHIND, kernels.FITTING}
        np.testing.assert_allclose(rows[:, 6], [distance for _, distance, _ in expected], atol=1e-9)
        np.testing.assert_allclose(rows[:, 10], [luma for _, _, luma in expected], rtol=1e-5)

    def test_luma_slope_is_the_derivative_by_position(self) -> None:
        view, seen = draw(LENS, identity(), WALL), draw(LENS, identity(), WALL)
        samples = Alignment(problem(seen, view, levels=1, detail_pixels=0)).samples[0]

        def rows_at(pose: Pose) -> NDArray[np.float64]:
            rows, states = np.empty((len(samples), kernels.ROW)), np.empty(len(samples), dtype=np.uint8)
            pictures, gates = view_pictures(view, LENS), np.array([0.1, 6.0, 0.0])
            kernels.associate(
                samples.surface, samples.luma, samples.sigma, pictures, pose, gates, rows, states, 0, len(samples)
            )
            return rows

        base = moved((0, 0, 0), (0.004, 0.003, 0.0))
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = 1e-5
            change = (rows_at(make_pose(np.eye(3), step) @ base)[:, 10] - rows_at(base)[:, 10]) / 1e-5
            slopes = rows_at(base)[:, 7 + axis]
            known = np.isfinite(change)
            agree = np.isclose(change[known], slopes[known], rtol=0.02, atol=1.0)
            assert agree.mean() > 0.98

    def test_normal_equations(self, rng: np.random.Generator) -> None:
        count, chunk = 1100, 256
        rows, lumas = rng.normal(size=(count, kernels.ROW)), rng.uniform(0, 255, count)
        rows[:, 6] *= 0.005
        rows[:, 10] = lumas + rng.normal(size=count) * 20
        rows[rng.random(count) < 0.2, 6] = np.nan
        rows[rng.random(count) < 0.2, 10] = np.nan
        sigmas, center = rng.uniform(0.001, 0.003, count), np.array([0.1, -0.2, 1.0])
        exposure, scales = np.array([1.1, 120.0]), np.array([1.3, 8.0, 1.7, 0.7])
        chunks = -(-count // chunk)
        sums = np.empty((chunks, 2, kernels.UNKNOWNS, kernels.UNKNOWNS + 1))
        given = rows, lumas, sigmas, center, exposure, scales, 4.685
        kernels.accumulate_normal_equations(*given, chunk, sums, 0, chunks)
        matrix, side = reference.normal_equations(*given)
        total = sums.sum(axis=(0, 1))
        np.testing.assert_allclose(total[:, :-1], matrix, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(total[:, -1], side, rtol=1e-9, atol=1e-6)


def test_agreement_is_the_product_of_both_accounts() -> None:
    rng, count, every = np.random.default_rng(0), 500, 3
    rows, surface = rng.normal(size=(count, kernels.ROW)), rng.normal(size=(count, 8))
    rows[::7, 10], surface[:, 2] = np.nan, 1 + np.abs(surface[:, 2])
    states, sigma = rng.integers(0, 3, count).astype(np.uint8), rng.uniform(0.001, 0.01, count)
    slopes, luma = rng.normal(size=(count, 2)), rng.uniform(0, 255, count)
    slopes[::11] = np.nan
    rotation, center = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    focal, shape, picture = np.array([500.0, 510.0]), np.zeros((6, 6)), np.zeros((8, 8))
    kernels.accumulate_agreement(
        rows, states, surface, sigma, slopes, luma, rotation, center, focal, every, shape, picture
    )

    def product(chosen: NDArray[np.bool_], *accounts: NDArray[np.float64]) -> NDArray[np.float64]:
        arms = rows[chosen, :3] - center
        left, right = (np.hstack([np.cross(arms, each[:, :3]), each]) for each in accounts)
        return np.asarray(left.T @ right)

    some = np.arange(count) % every == 0
    fitting = some & (states == kernels.FITTING)
    normals = surface[fitting, 3:6] @ rotation.T
    np.testing.assert_allclose(shape, product(fitting, rows[fitting, 3:6] / sigma[fitting, None] ** 2, normals))
    good = some & np.isfinite(rows[:, 10]) & np.isfinite(slopes[:, 0])
    across = slopes[good] * focal / surface[good, 2:3]
    along = -np.sum(across * surface[good, :2], axis=1) / surface[good, 2]
    seen = np.column_stack([across, along]) @ rotation.T
    rest = np.column_stack([kernels.LUMA_CENTER - luma[good], np.full(len(seen), -1.0)])
    expected = product(good, np.hstack([rows[good, 7:10], rest]), np.hstack([seen, rest]))
    np.testing.assert_allclose(picture, expected)
