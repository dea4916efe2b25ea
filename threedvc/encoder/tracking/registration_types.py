# SPDX-License-Identifier: MIT
"""What goes into registration and what comes out: choices, the model's view, the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats
from threedvc.errors import ConfigError
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose

__all__ = [
    "ModelView",
    "Registration",
    "RegistrationConfig",
    "Sigma",
    "Status",
    "camera_rays",
    "check_size",
]

Sigma = Callable[[Doubles], Doubles] | Floats


class Status(StrEnum):
    """How far a registration can be trusted."""

    TRACKED = "tracked"
    RELOCALISED = "relocalised"
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
    weak_conditioning
        With less in some direction a result is weak.
    agreement
        Whether that information is what frame and view agree on, so that noise on a plain wall does not count; else
        what the view alone says, which a small round object needs.
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
    agreement: bool = True
    weak_conditioning: float = 3e-3
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
        check_size("view depth", self.depth, size)
        check_size("view normals", self.normals, (*size, 3))
        check_size("view intensity", self.intensity, size)


def check_size(name: str, picture: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    """Raise ConfigError if a picture does not have the shape that the camera asks for."""
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


@lru_cache(maxsize=8)
def camera_rays(camera: Camera) -> Doubles:
    """Return the ray slopes (h, w, 2) of a camera's pixels; the last few cameras are remembered."""
    return camera.rays()
