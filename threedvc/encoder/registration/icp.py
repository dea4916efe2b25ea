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

from threedvc.arrays import Doubles
from threedvc.encoder.registration.associations import TUKEY_BOUND, Associations, measure_associations, median_of_known
from threedvc.encoder.registration.frame_samples import level_samples, luma_levels, sample_surface
from threedvc.encoder.registration.registration_types import (
    Registration,
    RegistrationConfig,
    RegistrationProblem,
    camera_rays,
)
from threedvc.geometry.pose import Pose, inverse, make_pose, orthonormalized, rotation_angle, rotation_from_vector
from threedvc.kernels.encoder import registration as kernels
from threedvc.parallel import for_ranges
from threedvc.stream.pose_status import PoseStatus

__all__ = ["Alignment"]

CHUNK = 512
"""Samples that are summed up in one go: sums are added chunk by chunk, so that they do not depend on threads."""
THREADED_SAMPLES = 32768
"""Below this, handing work to threads takes longer than the work."""
AGREEING_SAMPLES = 768
"""So many tell which directions are determined: the answer needs no more than the order of magnitude."""
MIN_ASSOCIATED = 12
"""Fewer samples leave the six unknowns of motion to chance, even at the coarsest level."""
GATE_SIGMAS = 6.0
"""Points are associated up to this distance in sigmas of their depth, where sensors are too noisy for the gates in
parts of the depth."""
STRONG_SLOPE = 32.0
"""Levels from one pixel to the next of a picture that tells motion as well as luma can: a sharp border of two shades,
blurred by the lens."""
GAIN_PRIOR = 100.0
"""Weight of the gain of luma against 1: without it, the gain of a plain picture is anything."""
OFFSET_PRIOR = 1e-9
"""That of the offset: next to none, only so that there is a solution without any luma."""
MAX_STEP_RAD = 0.3
"""A larger rotation is no small one any more: the step is shortened."""
COARSE_CONVERGENCE = 0.05
"""Pixels of the level's own picture below which no other step is taken; the next level refines the pose anyway."""
FINE_CONVERGENCE = 0.02
"""The same at the finest level: well below `RegistrationConfig.rest_pixels`."""
MIN_TEST_BLOCKS = 8
"""Fewer blocks of samples do not tell the scatter of their means."""
TINY = 1e-12
"""Keeps divisions by what may be 0 finite."""


@dataclass(frozen=True, eq=False)
class _Step:
    """A correction: a motion in the view's frame, its size on the picture, and the new exposure."""

    motion: Pose
    pixels: float
    exposure: Doubles
    conditioning: float


class Alignment:
    """One frame against one view: the samples and luma pictures of every level.

    `threedvc.encoder.registration.registration.register` is the usual way in; keep an alignment to try many poses.
    """

    def __init__(self, problem: RegistrationProblem) -> None:
        sample, config = problem.sample, problem.config
        self.camera, self.view, self.config, self.threads = sample.camera, problem.view, config, problem.threads
        self.rays, self.parameters = camera_rays(self.camera), self.camera.parameters()
        self.view_lumas = luma_levels(self.view.intensity, config)
        surface, sigma = sample_surface(sample, problem.sigma_m, config.samples)
        lumas = luma_levels(sample.masked_luma, config)
        self.samples = [level_samples(surface, sigma, luma, level) for level, luma in enumerate(lumas)]
        # Medians, because a few readings may be absurdly far.
        self.center = np.median(surface[:, :3], axis=0) if len(surface) else np.array([0.0, 0.0, 1.0])
        distances = np.linalg.norm(surface[:, :3] - self.center, axis=1)
        self.radius = median_of_known(distances, 1.0) + 1e-9

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
        shift = float(np.linalg.norm(change[:3, :3] @ self.center + change[:3, 3] - self.center))
        near = shift <= self.config.max_shift * self.center[2] and rotation_angle(change) <= self.config.max_turn_rad
        if near and found.status is not PoseStatus.LOST:
            return found
        return replace(found, status=PoseStatus.LOST, T_camera_object=T_guess)

    def displacement_pixels(self, T_a: Pose, T_b: Pose) -> float:
        """Return the RMS displacement of the samples between two poses of the object, in pixels at their depth."""
        points = self.samples[-1].surface[:, :3]
        if not len(points):
            return 0.0
        T_a_b = T_a @ inverse(T_b)
        displacements = points @ (T_a_b[:3, :3] - np.eye(3)).T + T_a_b[:3, 3]
        return float(np.sqrt(np.mean(np.sum(displacements**2, axis=1) / points[:, 2] ** 2))) * self.camera.fx

    def excess_cost(self, T_camera_object: Pose, T_best: Pose) -> float:
        """Return by how many standard errors a pose fits worse than the best one; infinite if it cannot be told."""
        best = self._associate(self._view_frame(T_best), 0, None)
        other = self._associate(self._view_frame(T_camera_object), 0, None)
        if best is None or other is None:
            return np.inf
        difference = other.costs(best.scales) - best.costs(best.scales)
        difference = difference[np.isfinite(difference)]
        blocks = np.array_split(difference, max(MIN_TEST_BLOCKS, round(np.sqrt(len(difference)))))
        means = np.array([block.mean() for block in blocks if len(block)])
        if len(means) < MIN_TEST_BLOCKS:
            return np.inf
        error = float(means.std(ddof=1) / np.sqrt(len(means)))
        return float(means.mean() / max(error, TINY))

    def information(self, T_camera_object: Pose) -> Doubles | None:
        """Return how surely the residuals determine a pose; None where too few samples meet the model.

        Returns
        -------
        numpy.ndarray
            (6, 6) inverse covariance of a small motion (rotation, translation) of the frame in the view's camera, as if
            all samples were independent.
        """
        T_view_frame = self._view_frame(T_camera_object)
        fit = self._associate(T_view_frame, 0, None)
        if fit is None:
            return None
        depth, luma = self._normal_equations(fit, np.zeros(3))
        coupling = np.linalg.solve(luma[6:, 6:8], luma[6:, :6])
        return np.asarray(depth[:6, :6] + luma[:6, :6] - luma[:6, 6:8] @ coupling)

    def _view_frame(self, T_camera_object: Pose) -> Pose:
        return self.view.T_camera_object @ inverse(T_camera_object)

    def _run(self, work: Callable[[int, int], object], chunks: int) -> None:
        threads = self.threads if chunks * CHUNK >= THREADED_SAMPLES else 1
        for_ranges(work, chunks, threads)

    def _gates(self, level: int) -> Doubles:
        """Return the gates (3,) of `kernels.associate` at a level, between those of the coarsest and the finest."""
        config, coarsest = self.config, len(self.samples) - 1
        part = level / coarsest if coarsest else 0.0
        distance = config.fine_gate + part * (config.coarse_gate - config.fine_gate)
        angle = config.fine_angle_rad + part * (config.coarse_angle_rad - config.fine_angle_rad)
        return np.array([distance, GATE_SIGMAS, np.cos(angle)])

    def _associate(self, T_view_frame: Pose, level: int, exposure: Doubles | None) -> Associations | None:
        """Associate the samples of a level at a pose; None where too few meet the model."""
        samples, view = self.samples[level], self.view
        rows, states = np.empty((len(samples), kernels.ROW)), np.empty(len(samples), dtype=np.uint8)
        gates = self._gates(level)
        pictures = kernels.ViewPictures(
            view.depth, view.normals, self.view_lumas[level], 0.5**level, self.rays, self.parameters
        )

        def work(start: int, stop: int) -> None:
            kernels.associate(
                samples.surface, samples.luma, samples.sigma, pictures, T_view_frame, gates, rows, states,
                start * CHUNK, min(stop * CHUNK, len(samples)),
            )  # fmt: skip

        self._run(work, -(-len(samples) // CHUNK))
        part = len(samples) / max(len(self.samples[0]), 1)
        if np.count_nonzero(states == kernels.FITTING) < max(MIN_ASSOCIATED, self.config.min_samples * part):
            return None
        return measure_associations(rows, states, samples, exposure, self.config)

    def _normal_equations(self, fit: Associations, center: Doubles) -> tuple[Doubles, Doubles]:
        """Return the equations (8, 9) of depth and of luma for a motion about a center, gain and offset."""
        samples = fit.samples
        sums = np.empty((-(-len(samples) // CHUNK), 2, kernels.UNKNOWNS, kernels.UNKNOWNS + 1))

        def work(start: int, stop: int) -> None:
            kernels.accumulate_normal_equations(
                fit.rows, samples.luma, samples.sigma, center, fit.exposure, fit.scales, TUKEY_BOUND, CHUNK, sums,
                start, stop,
            )  # fmt: skip

        self._run(work, len(sums))
        depth, luma = sums.sum(axis=0)
        luma[6, 6] += GAIN_PRIOR
        luma[6, 8] += GAIN_PRIOR * (fit.exposure[0] - 1)
        luma[7, 7] += OFFSET_PRIOR
        return depth, luma

    def _agreement(self, fit: Associations, T_view_frame: Pose, center: Doubles) -> tuple[Doubles, Doubles]:
        """Return what shape and picture tell of a rotation and translation as far as view and frame agree, (6, 6) each.

        Noise tilts the normals of both and has slopes in both pictures, but not alike: in products of the one with the
        other it cancels out, in those of either with itself a plain wall would seem to have a structure, and pictures
        of noise alone fit best half a pixel apart, where interpolation smooths it.
        """
        samples = fit.samples
        every = max(1, len(samples) // AGREEING_SAMPLES)
        shape, picture = np.zeros((6, 6)), np.zeros((kernels.UNKNOWNS, kernels.UNKNOWNS))
        kernels.accumulate_agreement(
            fit.rows, fit.states, samples.surface, samples.sigma, samples.slopes, samples.luma,
            np.ascontiguousarray(T_view_frame[:3, :3]), center, self.parameters[:2], every, shape, picture,
        )  # fmt: skip
        picture *= every * fit.scales[3] / fit.scales[1] ** 2
        both = 0.5 * (picture + picture.T)
        both[range(6, 8), range(6, 8)] += GAIN_PRIOR, OFFSET_PRIOR
        by_luma = both[:6, :6] - both[:6, 6:] @ np.linalg.solve(both[6:, 6:], both[6:, :6])
        return shape + shape.T, np.asarray(by_luma)

    def _step(self, fit: Associations, level: int, T_view_frame: Pose) -> _Step:
        """Solve for one Gauss-Newton step in the directions that the residuals determine."""
        center = T_view_frame[:3, :3] @ self.center + T_view_frame[:3, 3]
        depth, luma = self._normal_equations(fit, center)
        # Exposure is eliminated first: what it explains says nothing about motion.
        coupling = np.linalg.solve(luma[6:, 6:8], np.column_stack([luma[6:, :6], luma[6:, 8]]))
        unit = np.repeat([1 / self.radius, 1.0], 3)
        by_depth = unit[:, None] * depth[:6, :6] * unit
        by_luma = unit[:, None] * (luma[:6, :6] - luma[:6, 6:8] @ coupling[:, :6]) * unit
        slope = unit * (depth[:6, 8] + luma[:6, 8] - luma[:6, 6:8] @ coupling[:, 6])
        pixel = 0.5**level * self.camera.fx / max(center[2], 1e-6)
        full_luma = fit.count * fit.scales[3] / fit.scales[1] ** 2
        shape, agreeing = by_depth, by_luma
        if self.config.agreement:
            shape, agreeing = (
                _without_contradictions(unit[:, None] * each * unit)
                for each in self._agreement(fit, T_view_frame, center)
            )
        quality = shape / max(float(np.linalg.eigvalsh(shape)[-1]), TINY)
        quality += agreeing / max(full_luma * (STRONG_SLOPE * pixel) ** 2, TINY)
        grades, directions = np.linalg.eigh(quality)
        chosen = directions[:, grades > self.config.min_conditioning]
        correction = -chosen @ np.linalg.solve(chosen.T @ (by_depth + by_luma) @ chosen, chosen.T @ slope)
        step = unit * correction
        step *= min(1.0, MAX_STEP_RAD / max(float(np.linalg.norm(step[:3])), TINY))
        exposure = fit.exposure - coupling[:, 6] - coupling[:, :6] @ step
        rotation = rotation_from_vector(step[:3])
        motion = make_pose(rotation, center - rotation @ center + step[3:])
        return _Step(motion, float(np.linalg.norm(correction)) * pixel * 2**level, exposure, float(grades[0]))

    def _judge(self, T_view_frame: Pose, exposure: Doubles | None, conditioning: float, steps: int) -> Registration:
        """Return a pose that was found and how well all samples of the finest level fit there."""
        # Without this, rounding errors of predicted poses would more than double from frame to frame.
        T_camera_object = orthonormalized(inverse(T_view_frame) @ self.view.T_camera_object)
        fit = self._associate(T_view_frame, 0, exposure)
        if fit is None:
            return _lost(T_camera_object, steps)
        inliers = int(np.count_nonzero(fit.inliers))
        met = int(np.count_nonzero(fit.states != kernels.UNSEEN))
        fraction, overlap = inliers / met, met / len(fit.states)
        return Registration(
            T_camera_object=T_camera_object,
            status=_status(self.config, fraction, overlap, conditioning),
            inliers=inliers,
            inlier_fraction=fraction,
            overlap=overlap,
            residual_m=fit.residual_m,
            conditioning=conditioning,
            iterations=steps,
        )


def _status(config: RegistrationConfig, inlier_fraction: float, overlap: float, conditioning: float) -> PoseStatus:
    if inlier_fraction < config.min_inliers or overlap < config.min_overlap:
        return PoseStatus.LOST
    min_conditioning = config.weak_conditioning if config.agreement else config.min_conditioning
    trusted = inlier_fraction >= config.weak_inliers and overlap >= config.weak_overlap
    return PoseStatus.TRACKED if trusted and conditioning >= min_conditioning else PoseStatus.WEAK


def _lost(T_camera_object: Pose, steps: int) -> Registration:
    return Registration(
        T_camera_object=T_camera_object,
        status=PoseStatus.LOST,
        inliers=0,
        inlier_fraction=0.0,
        overlap=0.0,
        residual_m=np.inf,
        conditioning=0.0,
        iterations=steps,
    )


def _without_contradictions(information: Doubles) -> Doubles:
    """Return the nearest matrix without negative directions: where view and frame contradict, nothing is known."""
    values, directions = np.linalg.eigh(information)
    return np.asarray(directions * np.maximum(values, 0) @ directions.T)
