# SPDX-License-Identifier: MIT
"""Pictures of known scenes for tests of registration, and what was found in them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference.registration import Box
from threedvc.encoder.registration.registration import (
    DepthSample,
    ModelView,
    Registration,
    RegistrationConfig,
    RegistrationProblem,
    register,
)
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse, make_pose, rotation_angle, rotation_from_vector
from threedvc.kernels.encoder import registration as kernels
from threedvc.stream.pose_status import PoseStatus

CAMERA = Camera(width=160, height=120, fx=130.0, fy=132.0, cx=80.3, cy=59.2)
LENS = replace(CAMERA, distortion=(0.25, -0.9, -0.005, 0.003, 1.1))
BOX = Box(np.array([0.17, 0.11, 0.14]))
T_CAMERA_BOX = make_pose(rotation_from_vector(np.array([0.5, 0.6, 0.1])), np.array([0.02, -0.01, 0.9]))
MOTION = make_pose(rotation_from_vector(np.array([0.01, -0.02, 0.015])), np.array([0.02, -0.012, 0.015]))


def noise(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.001 * depth**2


def moved(rotation: tuple[float, float, float], translation: tuple[float, float, float]) -> Pose:
    return make_pose(rotation_from_vector(np.array(rotation)), np.array(translation))


def sample_of(seen: ModelView, mask: NDArray[np.bool_] | None = None) -> DepthSample:
    return DepthSample(depth=seen.depth, luma=seen.intensity, mask=mask, camera=seen.camera)


def problem(
    seen: ModelView, view: ModelView, mask: NDArray[np.bool_] | None = None, **options: Any
) -> RegistrationProblem:
    config = RegistrationConfig(**options)
    return RegistrationProblem(sample=sample_of(seen, mask), view=view, sigma_m=noise, config=config)


def view_pictures(view: ModelView, camera: Camera) -> kernels.ViewPictures:
    """Return a view as the kernels take it, at full size."""
    return kernels.ViewPictures(view.depth, view.normals, view.intensity, 1.0, camera.rays(), camera.parameters())


def run(
    seen: ModelView, view: ModelView, guess: Pose, mask: NDArray[np.bool_] | None = None, **options: Any
) -> Registration:
    return register(problem(seen, view, mask, **options), guess)


def errors(found: Pose, true: Pose, center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[float, float]:
    """Displacement of a point of the object in millimeters, and angle in degrees."""
    point = np.array([*center, 1.0])
    turn = rotation_angle(found @ inverse(true))
    return 1000 * float(np.linalg.norm((found - true) @ point)), float(np.degrees(turn))


def assert_found(result: Registration, true: Pose, *, mm: float = 1.0, degrees: float = 0.1) -> None:
    shift, turn = errors(result.T_camera_object, true, (0.0, 0.0, 1.5) if true[2, 3] < 0.5 else (0.0, 0.0, 0.0))
    assert result.status is PoseStatus.TRACKED
    assert shift < mm
    assert turn < degrees


def noisy(view: ModelView, rng: np.random.Generator) -> ModelView:
    depth = view.depth + np.where(view.depth > 0, rng.normal(size=view.depth.shape) * noise(view.depth), 0)
    luma = view.intensity + rng.normal(size=view.depth.shape) * 2
    return replace(view, depth=depth.astype(np.float32), intensity=luma.astype(np.float32))
