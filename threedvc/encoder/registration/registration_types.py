# SPDX-License-Identifier: MIT
"""What goes into registration and what comes out: the frame's sample, the model's view, choices, the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats, Mask
from threedvc.errors import ConfigError
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose
from threedvc.stream.pose_status import PoseStatus

__all__ = [
    "DepthSample",
    "ModelView",
    "Registration",
    "RegistrationConfig",
    "RegistrationProblem",
    "Sigma",
    "camera_rays",
]

Sigma = Callable[[Doubles], Doubles] | Floats
"""Noise of the depth in meters: (h, w) float32, or a function of depths (n,) float64."""


@dataclass(frozen=True, kw_only=True)
class RegistrationConfig:
    """Choices of registration.

    Attributes
    ----------
    samples
        Number of pixels used at the finest level, about; a frame with fewer uses all. A thousand for each unknown
        average the noise out.
    levels
        Largest number of levels; each has half the luma picture of the next finer one, and sees twice the motion.
    iterations
        Largest number of steps per level: Gauss-Newton that has not converged by then does not.
    luma_weight
        Weight of the luma residuals against the depth residuals; 0 uses depth alone.
    luma_noise
        Smallest standard deviation of luma residuals, gray levels: the noise of a common camera.
    detail_pixels
        Side of the window whose mean is taken off the luma at the finest level; 0 keeps it.
    coarse_gate, fine_gate
        Largest distance of associated points at the coarsest and finest level, relative to depth: at first as far
        as motions are to be found, at last what sensors may be wrong by.
    coarse_angle_rad, fine_angle_rad
        Largest angle between their normals: those of noisy depth scatter widely.
    min_conditioning
        Directions with less information than this part of the best one keep the prediction: their standard error
        would be more than eleven times that of the best one.
    weak_conditioning
        With less in some direction a result is weak: eighteen times the standard error.
    agreement
        Whether that information is what frame and view agree on, so that noise on a plain wall does not count; else
        what the view alone says, which a small round object needs.
    min_samples
        Fewer associated samples are a loss: ten for each unknown of the motion.
    min_inliers, weak_inliers
        Parts of the samples that meet the model and fit, below which a result is lost or weak; by hand: what moves
        or was not seen before may be half of a picture.
    min_overlap, weak_overlap
        Parts of all samples that meet known model, below which a result is lost or weak; by hand: at the start of a
        recording most of a picture may be new.
    max_shift, max_turn_rad
        Largest plausible correction of the guess, relative to depth and in radians; what is found beyond is another
        part of the model that looks alike.
    rest_pixels, move_pixels
        Displacement on the picture that is always rest below the first and always motion above the second: what is
        lost in the noise, and what is seen.
    rest_significance, move_significance
        Standard errors by which the resting pose must fit worse, between these two displacements, to
        be left by an object that rests, or not to be taken by one that moves: a wrong motion of what rests is seen,
        a missed step of what moves is not.
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


def _check_size(name: str, picture: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    if picture.shape != shape:
        raise ConfigError(f"{name} has shape {picture.shape}, the camera asks for {shape}")


@dataclass(frozen=True, eq=False)
class DepthSample:
    """What a frame shows of an object.

    Attributes
    ----------
    depth
        (h, w) float32 meters along z; 0 = no measurement.
    luma
        (h, w) float32 luma 0..255 at the pixels of `depth`; NaN where unknown.
    mask
        (h, w) bool, the pixels of the object; None: all.
    camera
        The depth camera.

    Raises
    ------
    ConfigError
        If the pictures do not have the camera's size.
    """

    depth: Floats
    luma: Floats
    mask: Mask | None
    camera: Camera

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        _check_size("depth", self.depth, size)
        _check_size("intensity", self.luma, size)
        if self.mask is not None:
            _check_size("mask", self.mask, size)

    @property
    def measured(self) -> Mask:
        """The pixels (h, w) of the object whose depth is known."""
        return self.depth > 0 if self.mask is None else self.mask & (self.depth > 0)

    @property
    def masked_luma(self) -> Floats:
        """The luma (h, w) with NaN outside the object's pixels."""
        return self.luma if self.mask is None else np.where(self.mask, self.luma, np.float32(np.nan))


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
        (h, w) float32 meters along z; 0 = unknown or nothing there.
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


@dataclass(frozen=True, kw_only=True, eq=False)
class RegistrationProblem:
    """A frame that is to be registered with a view of the model.

    Attributes
    ----------
    sample
        What the frame shows of the object.
    view
        The model from a pose near the frame's, in the same camera.
    sigma_m
        Noise of the depth.
    config
        Choices.
    threads
        Number of threads; the result does not depend on it.

    Raises
    ------
    ConfigError
        If the view was cast with another camera than the frame's.
    """

    sample: DepthSample
    view: ModelView
    sigma_m: Sigma
    config: RegistrationConfig = field(default_factory=RegistrationConfig)
    threads: int = 1

    def __post_init__(self) -> None:
        if self.view.camera != self.sample.camera:
            raise ConfigError("the view was cast with another camera than the frame's")


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
        Robust standard deviation of the distance to the view's surface, meters.
    conditioning
        Smallest over largest eigenvalue of the information, rotations being measured by the displacement of a point
        at typical distance from the samples' center.
    iterations
        Number of steps taken.
    """

    T_camera_object: Pose
    status: PoseStatus
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
