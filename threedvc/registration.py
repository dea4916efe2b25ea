# SPDX-License-Identifier: MIT
"""Registration of a depth map with the model as seen from a pose (sec. 2.2).

`register` refines a pose coarse to fine. At every step each sample of the frame is moved into the
view, is associated with what the view shows at its pixel, and gives two residuals: its distance to the
view's surface in sigmas of the sensor (point to plane), and the difference of luma, whose gain and
offset are unknowns too, so that exposure does not matter. Both are weighted by Tukey's function on
measured scales. At the finest level luma is taken against its local mean: an object that turns under
a fixed light changes its shading, not its texture. Where the model is unknown there is no residual, so
the model may be incomplete.

Directions that the residuals do not determine, such as along a plain wall, keep the prediction. The
result says how far it can be trusted. `rests` tells whether an object moved at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.camera import Camera
from threedvc.errors import ConfigError
from threedvc.kernels import registration as kernels
from threedvc.parallel import for_ranges
from threedvc.pose import Pose, inverse, make_pose, orthonormalised, rotation_angle, rotation_from_vector

__all__ = [
    "ModelView",
    "Problem",
    "Registration",
    "RegistrationConfig",
    "Sigma",
    "Status",
    "camera_rays",
    "frame_view",
    "register",
    "rests",
]

Sigma = Callable[[NDArray[np.float64]], NDArray[np.float64]] | NDArray[np.float32]
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Mask = NDArray[np.bool_]

CHUNK = 512
THREADED_SAMPLES = 32768
MEDIAN_SAMPLES = 2048
MIN_LEVEL_SAMPLES = 1500
MIN_ASSOCIATED = 12
SMALLEST_SIDE = 24
NORMAL_REACH_PARTS = 160
MAX_JUMP = 0.04
MAD_TO_SIGMA = 1.4826
MIN_DEPTH_SCALE = 0.5
GATE_SIGMAS = 6.0
TUKEY_BOUND = 4.685
STRONG_SLOPE = 32.0
GAIN_PRIOR = 100.0
MAX_STEP_RAD = 0.3
COARSE_CONVERGENCE = 0.05
FINE_CONVERGENCE = 0.02
INLIER_SIGMAS = 3.0
INLIER_DEPTH = 0.01
INLIER_LUMA = 30.0
MIN_TEST_BLOCKS = 8


class Status(StrEnum):
    """How far a registration can be trusted."""

    TRACKED = "tracked"
    WEAK = "weak"
    LOST = "lost"


@dataclass(frozen=True, kw_only=True)
class RegistrationConfig:
    """Choices of registration.

    Attributes
    ----------
    samples
        Number of pixels used at the finest level, about; a frame with fewer uses all.
    levels
        Largest number of levels; each has half the luma picture of the next finer one.
    iterations
        Largest number of steps per level.
    luma_weight
        Weight of the luma residuals against the depth residuals; 0 uses depth alone.
    luma_noise
        Smallest standard deviation of luma residuals, grey levels.
    detail_pixels
        Side of the window whose mean is taken off the luma at the finest level; 0 keeps it.
    coarse_gate, fine_gate
        Largest distance of associated points at the coarsest and finest level, relative to depth.
    coarse_angle_rad, fine_angle_rad
        Largest angle between their normals.
    min_conditioning
        Directions with less information than this part of the best one keep the prediction.
    min_samples
        Fewer associated samples are a loss.
    min_inliers, weak_inliers
        Parts of the samples that meet the model and fit, below which a result is lost or weak.
    min_overlap, weak_overlap
        Parts of all samples that meet known model, below which a result is lost or weak.
    max_shift, max_turn_rad
        Largest plausible correction of the guess, relative to depth and in radians.
    rest_pixels, move_pixels
        Displacement on the picture that is always rest below the first and always motion above the second.
    rest_significance, move_significance
        Standard errors by which the resting pose must fit worse, between these two displacements, to
        be left by an object that rests, or not to be taken by one that moves.
    """

    samples: int = 8000
    levels: int = 3
    iterations: int = 8
    luma_weight: float = 1.0
    luma_noise: float = 3.0
    detail_pixels: int = 11
    coarse_gate: float = 0.10
    fine_gate: float = 0.03
    coarse_angle_rad: float = 1.0
    fine_angle_rad: float = 0.7
    min_conditioning: float = 8e-3
    min_samples: int = 60
    min_inliers: float = 0.4
    weak_inliers: float = 0.6
    min_overlap: float = 0.15
    weak_overlap: float = 0.3
    max_shift: float = 0.25
    max_turn_rad: float = 0.5
    rest_pixels: float = 0.1
    move_pixels: float = 0.5
    rest_significance: float = 6.0
    move_significance: float = 2.0

    def __post_init__(self) -> None:
        if self.samples < 1 or self.levels < 1 or self.iterations < 1:
            raise ConfigError(
                f"samples {self.samples}, levels {self.levels} and iterations {self.iterations} must be at least 1"
            )
        if self.luma_weight < 0 or self.luma_noise <= 0 or self.detail_pixels < 0:
            raise ConfigError(
                f"luma weight {self.luma_weight} and detail window {self.detail_pixels} must not be negative, "
                f"luma noise {self.luma_noise} must be positive"
            )
        _check_order("gate", self.fine_gate, self.coarse_gate)
        _check_order("angle", self.fine_angle_rad, self.coarse_angle_rad)
        _check_order("inlier fraction", self.min_inliers, self.weak_inliers)
        _check_order("overlap", self.min_overlap, self.weak_overlap)
        _check_order("displacement", self.rest_pixels, self.move_pixels)


def _check_order(name: str, low: float, high: float) -> None:
    if not 0 < low <= high:
        raise ConfigError(f"{name} bounds of registration {low}, {high} must be positive and in ascending order")


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelView:
    """What is known of an object, seen from a pose.

    Attributes
    ----------
    camera
        The depth camera.
    T_camera_object
        Pose from which the view was cast.
    depth
        (h, w) float32 metres along z; 0 = unknown or nothing there.
    normals
        (h, w, 3) float32 unit normals in the camera's frame, towards the camera; 0 where unknown.
    intensity
        (h, w) float32 luma 0..255 as seen from there; NaN where unknown.

    Raises
    ------
    ConfigError
        If the pictures do not have the camera's size.
    """

    camera: Camera
    T_camera_object: Pose
    depth: Floats
    normals: Floats
    intensity: Floats

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        _check_size("view depth", self.depth, size)
        _check_size("view normals", self.normals, (*size, 3))
        _check_size("view intensity", self.intensity, size)


def _check_size(name: str, picture: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    if picture.shape != shape:
        raise ConfigError(f"{name} has shape {picture.shape}, the camera asks for {shape}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Registration:
    """A registered pose and how well it fits.

    Attributes
    ----------
    T_camera_object
        The pose of the object in the frame's depth camera; the guess where status is lost.
    status
        How far to trust it; a lost frame must not be fused.
    inliers
        Number of samples that fit the view in depth and luma.
    inlier_fraction
        Their part of the samples that met known model.
    overlap
        Part of all samples that met known model.
    residual_m
        Robust standard deviation of the distance to the view's surface, metres.
    conditioning
        Smallest over largest eigenvalue of the information, turns being measured by the way of a point
        at typical distance from the samples' centre.
    iterations
        Number of steps taken.
    """

    T_camera_object: Pose
    status: Status
    inliers: int
    inlier_fraction: float
    overlap: float
    residual_m: float
    conditioning: float
    iterations: int

    @property
    def agreement(self) -> float:
        """Part of all samples that fit, by which poses found for one frame can be compared."""
        return self.inlier_fraction * self.overlap


def register(
    depth: Floats,
    intensity: Floats,
    mask: Mask | None,
    camera: Camera,
    view: ModelView,
    T_guess: Pose,
    *,
    sigma_m: Sigma,
    config: RegistrationConfig | None = None,
    threads: int = 1,
) -> Registration:
    """Find the pose at which a frame fits the model's view, starting from a guess.

    Parameters
    ----------
    depth
        (h, w) float32 metres along z; 0 = no measurement.
    intensity
        (h, w) float32 luma 0..255 at the pixels of `depth`; NaN where unknown.
    mask
        (h, w) bool, the pixels of the object; None: all.
    camera
        The depth camera, which is also the view's.
    view
        The model from a pose near the frame's.
    T_guess
        Predicted ``T_camera_object`` of the frame.
    sigma_m
        Noise of the depth in metres: (h, w) float32, or a function of depths (n,) float64.
    config
        Choices; None: defaults.
    threads
        Number of threads; the result does not depend on it.

    Raises
    ------
    ConfigError
        If the sizes of the pictures, the camera and the view differ.
    """
    problem = Problem(depth, intensity, mask, camera, view, sigma_m, config or RegistrationConfig(), threads)
    return problem.solve_near(T_guess)


def rests(
    depth: Floats,
    intensity: Floats,
    mask: Mask | None,
    camera: Camera,
    view: ModelView,
    T_previous: Pose,
    found: Registration,
    *,
    sigma_m: Sigma,
    resting: bool,
    config: RegistrationConfig | None = None,
    threads: int = 1,
) -> bool:
    """Tell whether an object still has its previous pose, so that no pose needs to be sent.

    Below a small displacement it does, above a large one it does not. Between them the previous pose
    is kept unless it fits significantly worse than the found one: the difference of the robust costs
    is taken over blocks of neighbouring samples, whose scatter gives its standard error. An object at
    rest needs stronger evidence than a moving one. As poses are found against the model, slow motion
    adds up until it counts: the error stays below ``move_pixels``.

    Parameters
    ----------
    depth, intensity, mask, camera, view, sigma_m, config, threads
        As in `register`.
    T_previous
        The pose of the frame before.
    found
        The registration of this frame.
    resting
        Whether the object rested in the frame before.
    """
    config = config or RegistrationConfig()
    if found.status is Status.LOST:
        return False
    problem = Problem(depth, intensity, mask, camera, view, sigma_m, config, threads)
    displacement = problem.displacement_pixels(T_previous, found.T_camera_object)
    if displacement <= config.rest_pixels or displacement > config.move_pixels:
        return displacement <= config.rest_pixels
    limit = config.rest_significance if resting else config.move_significance
    return problem.excess_cost(T_previous, found.T_camera_object) < limit


def frame_view(
    depth: Floats,
    intensity: Floats,
    mask: Mask | None,
    camera: Camera,
    T_camera_object: Pose,
    *,
    reach: int | None = None,
    threads: int = 1,
) -> ModelView:
    """Make a view from one frame alone: what is known of an object before it has a model.

    Parameters
    ----------
    depth, intensity, mask, camera
        As in `register`.
    T_camera_object
        The object's pose in the frame.
    reach
        Normals are taken across this many pixels to each side; None: as fits the picture's size.
    """
    seen = depth if mask is None else np.where(mask, depth, np.float32(0))
    normals = np.empty((*seen.shape, 3), dtype=np.float32)
    rays, steps = camera_rays(camera), reach or _normal_reach(camera)

    def work(start: int, stop: int) -> None:
        kernels.estimate_normals(seen, rays, steps, MAX_JUMP, normals, start, stop)

    for_ranges(work, len(seen), threads)
    known = np.where(np.any(normals != 0, axis=2), seen, np.float32(0))
    return ModelView(
        camera=camera,
        T_camera_object=T_camera_object,
        depth=known,
        normals=normals,
        intensity=_masked(intensity, mask),
    )


@lru_cache(maxsize=8)
def camera_rays(camera: Camera) -> Doubles:
    """Return the ray slopes (h, w, 2) of a camera's pixels; the last few cameras are remembered."""
    return camera.rays()


def _normal_reach(camera: Camera) -> int:
    return max(1, round(camera.width / NORMAL_REACH_PARTS))


def _masked(intensity: Floats, mask: Mask | None) -> Floats:
    return intensity if mask is None else np.where(mask, intensity, np.float32(np.nan))


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples of a frame at one level: rows of `kernels.sample_frame`, luma, depth noise."""

    surface: Doubles
    luma: Doubles
    sigma: Doubles

    def __len__(self) -> int:
        return len(self.surface)


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


class Problem:
    """One frame against one view: the samples and luma pictures of every level.

    Parameters are those of `register`, which is the usual way in; keep a problem to try many poses.
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
        _check_size("depth", depth, size)
        _check_size("intensity", intensity, size)
        if mask is not None:
            _check_size("mask", mask, size)
        if view.camera != camera:
            raise ConfigError("the view was cast with another camera than the frame's")
        self.camera, self.view, self.config, self.threads = camera, view, config, threads
        self.rays, self.parameters = camera_rays(camera), camera.parameters()
        self.view_lumas = self._luma_levels(view.intensity)
        surface, sigma = self._sample_surface(depth, mask, sigma_m)
        lumas = self._luma_levels(_masked(intensity, mask))
        self.samples = [_level_samples(surface, sigma, luma, level) for level, luma in enumerate(lumas)]
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
        error = float(means.std(ddof=1)) / np.sqrt(len(means))
        return float(means.mean()) / max(error, 1e-12)

    def _view_frame(self, T_camera_object: Pose) -> Pose:
        return self.view.T_camera_object @ inverse(T_camera_object)

    def _luma_levels(self, luma: Floats) -> list[Floats]:
        """Return the luma of every level, the finest against its local mean."""
        config = self.config
        count = min(config.levels, 1 + int(np.log2(max(1.0, min(luma.shape) / SMALLEST_SIDE))))
        pictures = [np.ascontiguousarray(luma, dtype=np.float32)]
        for _ in range(count - 1):
            pictures.append(_halved(pictures[-1], self.threads))
        if config.detail_pixels:
            pictures[0] = _detail(pictures[0], config.detail_pixels)
        return pictures

    def _sample_surface(self, depth: Floats, mask: Mask | None, sigma_m: Sigma) -> tuple[Doubles, Doubles]:
        inside = np.ones(depth.shape, dtype=np.bool_) if mask is None else np.ascontiguousarray(mask)
        depth = np.ascontiguousarray(depth)
        stride = max(1, round(np.sqrt(np.count_nonzero(inside & (depth > 0)) / self.config.samples)))
        height, width = depth.shape
        grid = np.zeros((max(1, height // stride), max(1, width // stride), 8))
        reach = _normal_reach(self.camera)

        def work(start: int, stop: int) -> None:
            kernels.sample_frame(depth, inside, self.rays, stride, reach, MAX_JUMP, grid, start, stop)

        for_ranges(work, len(grid), self.threads)
        surface = grid[grid[:, :, 2] > 0]
        if callable(sigma_m):
            return surface, np.ascontiguousarray(sigma_m(surface[:, 2]), dtype=np.float64)
        columns, rows = surface[:, 6].astype(np.intp), surface[:, 7].astype(np.intp)
        return surface, sigma_m[rows, columns].astype(np.float64)

    def _run(self, work: Callable[[int, int], object], chunks: int) -> None:
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
                samples.surface,
                samples.luma,
                samples.sigma,
                view.depth,
                view.normals,
                luma,
                self.rays,
                self.parameters,
                T_view_frame,
                scale,
                gates,
                rows,
                states,
                start * CHUNK,
                min(stop * CHUNK, len(samples)),
            )

        self._run(work, -(-len(samples) // CHUNK))
        part = len(samples) / max(len(self.samples[0]), 1)
        if np.count_nonzero(states == kernels.FITTING) < max(MIN_ASSOCIATED, self.config.min_samples * part):
            return None
        return self._measured(rows, states, samples, exposure)

    def _measured(
        self, rows: Doubles, states: NDArray[np.uint8], samples: _Samples, exposure: Doubles | None
    ) -> _Fit:
        """Measure the exposure, if there is none yet, and the scales of both residuals."""
        some = slice(None, None, max(1, len(rows) // MEDIAN_SAMPLES))
        level, luma = samples.luma[some] - kernels.LUMA_CENTRE, rows[some, 10]
        if exposure is None:
            exposure = np.array([1.0, _median(luma - level, kernels.LUMA_CENTRE)])
        depth_scale = MAD_TO_SIGMA * _median(np.abs(rows[some, 6]) / samples.sigma[some], 1.0)
        luma_scale = MAD_TO_SIGMA * _median(np.abs(luma - exposure[0] * level - exposure[1]), 0.0)
        scales = np.array(
            [max(depth_scale, MIN_DEPTH_SCALE), max(luma_scale, self.config.luma_noise), self.config.luma_weight]
        )
        return _Fit(rows, states, scales, exposure)

    def _normal_equations(self, fit: _Fit, samples: _Samples, centre: Doubles) -> tuple[Doubles, Doubles]:
        sums = np.empty((-(-len(samples) // CHUNK), 2, kernels.UNKNOWNS, kernels.UNKNOWNS + 1))

        def work(start: int, stop: int) -> None:
            kernels.accumulate_normal_equations(
                fit.rows,
                samples.luma,
                samples.sigma,
                centre,
                fit.exposure,
                fit.scales,
                TUKEY_BOUND,
                CHUNK,
                sums,
                start,
                stop,
            )

        self._run(work, len(sums))
        depth, luma = sums.sum(axis=0)
        luma[6, 6] += GAIN_PRIOR
        luma[6, 8] += GAIN_PRIOR * (fit.exposure[0] - 1)
        luma[7, 7] += 1e-9
        return depth, luma

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
        quality = by_depth / max(float(np.linalg.eigvalsh(by_depth)[-1]), 1e-12)
        quality += by_luma / (luma[7, 7] * (STRONG_SLOPE * pixel) ** 2)
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
        trusted = inlier_fraction >= config.weak_inliers and overlap >= config.weak_overlap
        return Status.TRACKED if trusted and conditioning >= config.min_conditioning else Status.WEAK


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


def _halved(luma: Floats, threads: int) -> Floats:
    halved = np.empty((luma.shape[0] // 2, luma.shape[1] // 2), dtype=np.float32)

    def work(start: int, stop: int) -> None:
        kernels.halve_luma(luma, halved, start, stop)

    for_ranges(work, len(halved), threads)
    return halved


def _detail(luma: Floats, side: int) -> Floats:
    """Return luma against the mean of the known pixels around, about the same level as before."""
    known = np.isfinite(luma)
    window = {"ddepth": -1, "ksize": (side, side), "borderType": cv2.BORDER_REFLECT_101}
    if known.all():
        return luma - cv2.boxFilter(luma, **window) + np.float32(kernels.LUMA_CENTRE)
    part = np.maximum(cv2.boxFilter(known.astype(np.float32), **window), np.float32(1e-6))
    mean = cv2.boxFilter(np.where(known, luma, np.float32(0)), **window) / part
    return luma - mean + np.float32(kernels.LUMA_CENTRE)


def _level_samples(surface: Doubles, sigma: Doubles, luma: Floats, level: int) -> _Samples:
    """Thin out the samples for a level and look up its luma."""
    step = max(1, min(4**level, len(surface) // MIN_LEVEL_SAMPLES))
    chosen = np.ascontiguousarray(surface[::step])
    values = np.empty(len(chosen))
    kernels.sample_luma(luma, 0.5**level, chosen, values, 0, len(chosen))
    return _Samples(chosen, values, np.ascontiguousarray(sigma[::step]))


def _luma_residuals(fit: _Fit, samples: _Samples) -> Doubles:
    return fit.rows[:, 10] - fit.exposure[0] * (samples.luma - kernels.LUMA_CENTRE) - fit.exposure[1]


def _fits(fit: _Fit, samples: _Samples) -> Mask:
    """Tell which samples lie on the view's surface and do not contradict its luma."""
    bound = np.maximum(INLIER_SIGMAS * samples.sigma, INLIER_DEPTH * samples.surface[:, 2])
    dark_or_bright = np.abs(_luma_residuals(fit, samples)) > INLIER_LUMA
    return (np.abs(fit.rows[:, 6]) <= bound) & ~dark_or_bright


def _tukey_cost(residuals: Doubles) -> Doubles:
    inside = np.clip(1 - (residuals / TUKEY_BOUND) ** 2, 0, 1)
    return (1 - inside**3) * (TUKEY_BOUND**2 / 6)


def _costs(fit: _Fit, samples: _Samples, scales: Doubles) -> Doubles:
    """Return the robust cost of every sample, NaN where it does not meet the surface."""
    luma = np.nan_to_num(_tukey_cost(_luma_residuals(fit, samples) / scales[1]), nan=0.0)
    return _tukey_cost(fit.rows[:, 6] / (scales[0] * samples.sigma)) + scales[2] * luma
