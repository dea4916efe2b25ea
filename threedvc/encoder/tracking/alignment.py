# SPDX-License-Identifier: MIT
"""Alignment of one frame with one view of the model: the mathematics of registration.

The unknowns of a step are a small rotation about the middle of what is seen and a translation, both in
the view's camera frame, and gain and offset of the frame's luma. Which directions of motion the
residuals determine is told by a quality matrix: the depth's information relative to its own best
direction, plus the luma's relative to a picture full of strong slopes, each if wanted only as far as model
and frame agree on it, for noise makes a little of both everywhere. Directions below a threshold are
left alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats, Mask
from threedvc.encoder.tracking.frame_samples import (
    MAX_JUMP,
    SMALLEST_SIDE,
    Samples,
    detail,
    halved,
    level_samples,
    masked_luma,
    normal_reach,
)
from threedvc.encoder.tracking.registration_types import (
    ModelView,
    Registration,
    RegistrationConfig,
    Sigma,
    Status,
    camera_rays,
    check_size,
)
from threedvc.errors import ConfigError
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse, make_pose, orthonormalised, rotation_angle, rotation_from_vector
from threedvc.kernels.encoder import registration as kernels
from threedvc.parallel import for_ranges

__all__ = ["Alignment"]

CHUNK = 512
THREADED_SAMPLES = 32768
MEDIAN_SAMPLES = 2048
AGREEING_SAMPLES = 768
MIN_ASSOCIATED = 12
MAD_TO_SIGMA = 1.4826
MIN_DEPTH_SCALE = 0.5
MAX_DEPTH_SCALE = 2.0
GATE_SIGMAS = 6.0
TUKEY_BOUND = 4.685
STRONG_SLOPE = 32.0
GAIN_PRIOR = 100.0
MAX_STEP_RAD = 0.3
COARSE_CONVERGENCE = 0.05
FINE_CONVERGENCE = 0.02
INLIER_SIGMAS = 3.0
INLIER_DEPTH = 0.01
INLIER_M = 0.005
"""Real sensors are wrong by some millimetres however smooth their depth and however near the surface."""
INLIER_LUMA = 30.0
MIN_TEST_BLOCKS = 8


@dataclass(frozen=True, eq=False)
class _Fit:
    """Samples associated at one pose, see `kernels.associate`, with measured scales and exposure."""

    rows: Doubles
    states: NDArray[np.uint8]
    scales: Doubles
    exposure: Doubles


@dataclass(frozen=True, eq=False)
class _Step:
    """A correction: a motion in the view's frame, its size on the picture, and the new exposure."""

    motion: Pose
    pixels: float
    exposure: Doubles
    conditioning: float


class Alignment:
    """One frame against one view: the samples and luma pictures of every level.

    Parameters are those of `register`, which is the usual way in; keep an alignment to try many poses.
    """

    def __init__(
        self,
        depth: Floats,
        intensity: Floats,
        mask: Mask | None,
        camera: Camera,
        view: ModelView,
        sigma_m: Sigma,
        config: RegistrationConfig,
        threads: int,
    ) -> None:
        size = (camera.height, camera.width)
        check_size("depth", depth, size)
        check_size("intensity", intensity, size)
        if mask is not None:
            check_size("mask", mask, size)
        if view.camera != camera:
            raise ConfigError("the view was cast with another camera than the frame's")
        self.camera, self.view, self.config, self.threads = camera, view, config, threads
        self.rays, self.parameters = camera_rays(camera), camera.parameters()
        self.view_lumas = self._luma_levels(view.intensity)
        surface, sigma = self._sample_surface(depth, mask, sigma_m)
        lumas = self._luma_levels(masked_luma(intensity, mask))
        self.samples = [level_samples(surface, sigma, luma, level) for level, luma in enumerate(lumas)]
        # Medians, because a few readings may be absurdly far.
        self.centre = np.median(surface[:, :3], axis=0) if len(surface) else np.array([0.0, 0.0, 1.0])
        ways = np.linalg.norm(surface[:, :3] - self.centre, axis=1)
        self.radius = _median(ways, 1.0) + 1e-9

    def solve(self, T_guess: Pose, *, finest: int = 0) -> Registration:
        """Refine a pose from the coarsest level to level `finest` and judge the result."""
        T_view_frame = self.view.T_camera_object @ inverse(T_guess)
        exposure: Doubles | None = None
        conditioning, steps = 0.0, 0
        for level in range(len(self.samples) - 1, min(finest, len(self.samples) - 1) - 1, -1):
            # The local mean taken off the finest level changes its offset.
            exposure = exposure if level else None
            limit = COARSE_CONVERGENCE * 2**level if level else FINE_CONVERGENCE
            for _ in range(self.config.iterations):
                fit = self._associate(T_view_frame, level, exposure)
                if fit is None:
                    return _lost(T_guess, steps)
                step = self._step(fit, level, T_view_frame)
                T_view_frame, exposure = step.motion @ T_view_frame, step.exposure
                conditioning, steps = max(conditioning, step.conditioning), steps + 1
                if step.pixels < limit:
                    break
        exposure = exposure if not finest else None
        return self._judge(T_view_frame, exposure, conditioning, steps)

    def solve_near(self, T_guess: Pose) -> Registration:
        """Refine a guess; lost, with the guess as its pose, if what is found is bad or implausibly far from it."""
        found = self.solve(T_guess)
        change = found.T_camera_object @ inverse(T_guess)
        shift = float(np.linalg.norm(change[:3, :3] @ self.centre + change[:3, 3] - self.centre))
        near = shift <= self.config.max_shift * self.centre[2] and rotation_angle(change) <= self.config.max_turn_rad
        if near and found.status is not Status.LOST:
            return found
        return replace(found, status=Status.LOST, T_camera_object=T_guess)

    def displacement_pixels(self, T_a: Pose, T_b: Pose) -> float:
        """Return the RMS way of the samples between two poses of the object, in pixels at their depth."""
        points = self.samples[-1].surface[:, :3]
        if not len(points):
            return 0.0
        T_a_b = T_a @ inverse(T_b)
        ways = points @ (T_a_b[:3, :3] - np.eye(3)).T + T_a_b[:3, 3]
        return float(np.sqrt(np.mean(np.sum(ways**2, axis=1) / points[:, 2] ** 2))) * self.camera.fx

    def excess_cost(self, T_camera_object: Pose, T_best: Pose) -> float:
        """Return by how many standard errors a pose fits worse than the best one; infinite if it cannot be told."""
        best = self._associate(self._view_frame(T_best), 0, None)
        other = self._associate(self._view_frame(T_camera_object), 0, None)
        if best is None or other is None:
            return np.inf
        samples = self.samples[0]
        difference = _costs(other, samples, best.scales) - _costs(best, samples, best.scales)
        difference = difference[np.isfinite(difference)]
        blocks = np.array_split(difference, max(MIN_TEST_BLOCKS, round(np.sqrt(len(difference)))))
        means = np.array([block.mean() for block in blocks if len(block)])
        if len(means) < MIN_TEST_BLOCKS:
            return np.inf
        error = float(means.std(ddof=1) / np.sqrt(len(means)))
        return float(means.mean() / max(error, 1e-12))

    def information(self, T_camera_object: Pose) -> Doubles | None:
        """Return how surely the residuals determine a pose; None where too few samples meet the model.

        Returns
        -------
        numpy.ndarray
            (6, 6) inverse covariance of a small motion (turn, shift) of the frame in the view's camera, as if all
            samples were independent.
        """
        T_view_frame = self._view_frame(T_camera_object)
        fit = self._associate(T_view_frame, 0, None)
        if fit is None:
            return None
        depth, luma = self._normal_equations(fit, self.samples[0], np.zeros(3))
        coupling = np.linalg.solve(luma[6:, 6:8], luma[6:, :6])
        return np.asarray(depth[:6, :6] + luma[:6, :6] - luma[:6, 6:8] @ coupling)

    def _view_frame(self, T_camera_object: Pose) -> Pose:
        return self.view.T_camera_object @ inverse(T_camera_object)

    def _luma_levels(self, luma: Floats) -> list[Floats]:
        """Return the luma of every level, the finest against its local mean."""
        config = self.config
        count = min(config.levels, 1 + int(np.log2(max(1.0, min(luma.shape) / SMALLEST_SIDE))))
        pictures = [np.ascontiguousarray(luma, dtype=np.float32)]
        for _ in range(count - 1):
            pictures.append(halved(pictures[-1]))
        if config.detail_pixels:
            pictures[0] = detail(pictures[0], config.detail_pixels)
        return pictures

    def _sample_surface(self, depth: Floats, mask: Mask | None, sigma_m: Sigma) -> tuple[Doubles, Doubles]:
        """Return the samples with surface and their depth noise."""
        inside = np.ones(depth.shape, dtype=np.bool_) if mask is None else np.ascontiguousarray(mask)
        depth = np.ascontiguousarray(depth)
        stride = max(1, round(np.sqrt(np.count_nonzero(inside & (depth > 0)) / self.config.samples)))
        height, width = depth.shape
        grid = np.zeros((max(1, height // stride), max(1, width // stride), 8))
        reach = normal_reach(self.camera)
        kernels.sample_frame(depth, inside, self.rays, stride, reach, MAX_JUMP, grid, 0, len(grid))
        surface = grid[grid[:, :, 2] > 0]
        if callable(sigma_m):
            return surface, np.ascontiguousarray(sigma_m(surface[:, 2]), dtype=np.float64)
        columns, rows = surface[:, 6].astype(np.intp), surface[:, 7].astype(np.intp)
        return surface, sigma_m[rows, columns].astype(np.float64)

    def _run(self, work: Callable[[int, int], object], chunks: int) -> None:
        # Below this, handing work to threads takes longer than the work.
        threads = self.threads if chunks * CHUNK >= THREADED_SAMPLES else 1
        for_ranges(work, chunks, threads)

    def _gates(self, level: int) -> Doubles:
        config, coarsest = self.config, len(self.samples) - 1
        part = level / coarsest if coarsest else 0.0
        distance = config.fine_gate + part * (config.coarse_gate - config.fine_gate)
        angle = config.fine_angle_rad + part * (config.coarse_angle_rad - config.fine_angle_rad)
        return np.array([distance, GATE_SIGMAS, np.cos(angle)])

    def _associate(self, T_view_frame: Pose, level: int, exposure: Doubles | None) -> _Fit | None:
        """Associate the samples of a level at a pose; None where too few meet the model."""
        samples, view, luma = self.samples[level], self.view, self.view_lumas[level]
        rows, states = np.empty((len(samples), kernels.ROW)), np.empty(len(samples), dtype=np.uint8)
        gates, scale = self._gates(level), 0.5**level

        def work(start: int, stop: int) -> None:
            kernels.associate(
                samples.surface, samples.luma, samples.sigma, view.depth, view.normals, luma, self.rays,
                self.parameters, T_view_frame, scale, gates, rows, states, start * CHUNK,
                min(stop * CHUNK, len(samples)),
            )  # fmt: skip

        self._run(work, -(-len(samples) // CHUNK))
        part = len(samples) / max(len(self.samples[0]), 1)
        if np.count_nonzero(states == kernels.FITTING) < max(MIN_ASSOCIATED, self.config.min_samples * part):
            return None
        return self._measured(rows, states, samples, exposure)

    def _measured(self, rows: Doubles, states: NDArray[np.uint8], samples: Samples, exposure: Doubles | None) -> _Fit:
        """Measure the exposure, if there is none yet, and the scales of both residuals."""
        some = slice(None, None, max(1, len(rows) // MEDIAN_SAMPLES))
        level, luma = samples.luma[some] - kernels.LUMA_CENTRE, rows[some, 10]
        if exposure is None:
            exposure = np.array([1.0, _median(luma - level, kernels.LUMA_CENTRE)])
        depth_scale = MAD_TO_SIGMA * _median(np.abs(rows[some, 6]) / samples.sigma[some], 1.0)
        luma_scale = MAD_TO_SIGMA * _median(np.abs(luma - exposure[0] * level - exposure[1]), 0.0)
        depth_scale, luma_scale = max(depth_scale, MIN_DEPTH_SCALE), max(luma_scale, self.config.luma_noise)
        # Depth that fits badly must not hand the pose over to luma, or the misfit would grow.
        depth_weight = max(1.0, depth_scale / MAX_DEPTH_SCALE) ** 2
        scales = np.array([depth_scale, luma_scale, depth_weight, self.config.luma_weight])
        return _Fit(rows, states, scales, exposure)

    def _normal_equations(self, fit: _Fit, samples: Samples, centre: Doubles) -> tuple[Doubles, Doubles]:
        sums = np.empty((-(-len(samples) // CHUNK), 2, kernels.UNKNOWNS, kernels.UNKNOWNS + 1))

        def work(start: int, stop: int) -> None:
            kernels.accumulate_normal_equations(
                fit.rows, samples.luma, samples.sigma, centre, fit.exposure, fit.scales, TUKEY_BOUND, CHUNK, sums,
                start, stop,
            )  # fmt: skip

        self._run(work, len(sums))
        depth, luma = sums.sum(axis=0)
        luma[6, 6] += GAIN_PRIOR
        luma[6, 8] += GAIN_PRIOR * (fit.exposure[0] - 1)
        luma[7, 7] += 1e-9
        return depth, luma

    def _agreement(self, fit: _Fit, samples: Samples, T_view_frame: Pose, centre: Doubles) -> tuple[Doubles, Doubles]:
        """Return what shape and picture say of a motion (turn, shift) as far as view and frame agree, (6, 6) each.

        Noise tilts the normals of both and has slopes in both pictures, but not alike: in products of the one with the
        other it cancels out, in those of either with itself a plain wall would seem to have a structure, and pictures
        of noise alone fit best half a pixel apart, where interpolation smooths it.
        """
        every = max(1, len(samples) // AGREEING_SAMPLES)
        shape, picture = np.zeros((6, 6)), np.zeros((kernels.UNKNOWNS, kernels.UNKNOWNS))
        kernels.accumulate_agreement(
            fit.rows, fit.states, samples.surface, samples.sigma, samples.slopes, samples.luma,
            np.ascontiguousarray(T_view_frame[:3, :3]), centre, self.parameters[:2], every, shape, picture,
        )  # fmt: skip
        picture *= every * fit.scales[3] / fit.scales[1] ** 2
        both = 0.5 * (picture + picture.T)
        both[range(6, 8), range(6, 8)] += GAIN_PRIOR, 1e-9
        by_luma = both[:6, :6] - both[:6, 6:] @ np.linalg.solve(both[6:, 6:], both[6:, :6])
        return shape + shape.T, np.asarray(by_luma)

    def _step(self, fit: _Fit, level: int, T_view_frame: Pose) -> _Step:
        """Solve for one Gauss-Newton step in the directions that the residuals determine."""
        centre = T_view_frame[:3, :3] @ self.centre + T_view_frame[:3, 3]
        depth, luma = self._normal_equations(fit, self.samples[level], centre)
        # Exposure is eliminated first: what it explains says nothing about motion.
        coupling = np.linalg.solve(luma[6:, 6:8], np.column_stack([luma[6:, :6], luma[6:, 8]]))
        unit = np.repeat([1 / self.radius, 1.0], 3)
        by_depth = unit[:, None] * depth[:6, :6] * unit
        by_luma = unit[:, None] * (luma[:6, :6] - luma[:6, 6:8] @ coupling[:, :6]) * unit
        slope = unit * (depth[:6, 8] + luma[:6, 8] - luma[:6, 6:8] @ coupling[:, 6])
        pixel = 0.5**level * self.camera.fx / max(centre[2], 1e-6)
        full_luma = np.count_nonzero(fit.states == kernels.FITTING) * fit.scales[3] / fit.scales[1] ** 2
        shape, agreeing = by_depth, by_luma
        if self.config.agreement:
            shape, agreeing = (
                _without_contradictions(unit[:, None] * each * unit)
                for each in self._agreement(fit, self.samples[level], T_view_frame, centre)
            )
        quality = shape / max(float(np.linalg.eigvalsh(shape)[-1]), 1e-12)
        quality += agreeing / max(full_luma * (STRONG_SLOPE * pixel) ** 2, 1e-12)
        grades, directions = np.linalg.eigh(quality)
        chosen = directions[:, grades > self.config.min_conditioning]
        way = -chosen @ np.linalg.solve(chosen.T @ (by_depth + by_luma) @ chosen, chosen.T @ slope)
        step = unit * way
        step *= min(1.0, MAX_STEP_RAD / max(float(np.linalg.norm(step[:3])), 1e-12))
        exposure = fit.exposure - coupling[:, 6] - coupling[:, :6] @ step
        turn = rotation_from_vector(step[:3])
        motion = make_pose(turn, centre - turn @ centre + step[3:])
        return _Step(motion, float(np.linalg.norm(way)) * pixel * 2**level, exposure, float(grades[0]))

    def _judge(self, T_view_frame: Pose, exposure: Doubles | None, conditioning: float, steps: int) -> Registration:
        # Without this, rounding errors of predicted poses would more than double from frame to frame.
        T_camera_object = orthonormalised(inverse(T_view_frame) @ self.view.T_camera_object)
        fit = self._associate(T_view_frame, 0, exposure)
        if fit is None:
            return _lost(T_camera_object, steps)
        samples = self.samples[0]
        inliers = int(np.count_nonzero(_fits(fit, samples)))
        met = int(np.count_nonzero(fit.states != kernels.UNSEEN))
        fraction, overlap = inliers / met, met / len(samples)
        return Registration(
            T_camera_object=T_camera_object,
            status=self._status(fraction, overlap, conditioning),
            inliers=inliers,
            inlier_fraction=fraction,
            overlap=overlap,
            residual_m=MAD_TO_SIGMA * _median(np.abs(fit.rows[:, 6]), np.inf),
            conditioning=conditioning,
            iterations=steps,
        )

    def _status(self, inlier_fraction: float, overlap: float, conditioning: float) -> Status:
        config = self.config
        if inlier_fraction < config.min_inliers or overlap < config.min_overlap:
            return Status.LOST
        least = config.weak_conditioning if config.agreement else config.min_conditioning
        trusted = inlier_fraction >= config.weak_inliers and overlap >= config.weak_overlap
        return Status.TRACKED if trusted and conditioning >= least else Status.WEAK


def _lost(T_camera_object: Pose, steps: int) -> Registration:
    return Registration(
        T_camera_object=T_camera_object,
        status=Status.LOST,
        inliers=0,
        inlier_fraction=0.0,
        overlap=0.0,
        residual_m=np.inf,
        conditioning=0.0,
        iterations=steps,
    )


def _median(values: Doubles, default: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else default


def _without_contradictions(information: Doubles) -> Doubles:
    """Return the nearest matrix without negative directions: where view and frame contradict, nothing is known."""
    values, directions = np.linalg.eigh(information)
    return np.asarray(directions * np.maximum(values, 0) @ directions.T)


def _luma_residuals(fit: _Fit, samples: Samples) -> Doubles:
    expected: Doubles = fit.exposure[0] * (samples.luma - kernels.LUMA_CENTRE) + fit.exposure[1]
    return fit.rows[:, 10] - expected


def _fits(fit: _Fit, samples: Samples) -> Mask:
    """Tell which samples lie on the view's surface and do not contradict its luma."""
    bound = np.maximum(np.maximum(INLIER_SIGMAS * samples.sigma, INLIER_DEPTH * samples.surface[:, 2]), INLIER_M)
    dark_or_bright = np.abs(_luma_residuals(fit, samples)) > INLIER_LUMA
    return (np.abs(fit.rows[:, 6]) <= bound) & ~dark_or_bright


def _tukey_cost(residuals: Doubles) -> Doubles:
    inside = np.clip(1 - (residuals / TUKEY_BOUND) ** 2, 0, 1)
    cost: Doubles = (1 - inside**3) * (TUKEY_BOUND**2 / 6)
    return cost


def _costs(fit: _Fit, samples: Samples, scales: Doubles) -> Doubles:
    """Return the robust cost of every sample, NaN where it does not meet the surface."""
    luma = np.nan_to_num(_tukey_cost(_luma_residuals(fit, samples) / scales[1]), nan=0.0)
    cost: Doubles = scales[2] * _tukey_cost(fit.rows[:, 6] / (scales[0] * samples.sigma)) + scales[3] * luma
    return cost
