# SPDX-License-Identifier: MIT
"""Poses and shifts of the color camera that make a colored model meet the pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from threedvc.arrays import Doubles, Floats
from threedvc.frames.frame import Frame
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, inverse, make_pose, rotation_from_vector
from threedvc.kernels.encoder.appearance import LumaPicture, add_depth_equations, add_luma_equations

__all__ = ["MIN_POINTS", "aligned_pose", "aligned_shift"]

BLURS_PX = (2.0, 1.0)
"""Widths to which the picture is blurred: first wide, that slopes lead from further away, then about as cells are."""
POSE_STEPS = 5
"""At most for each blur; poses begin near and are aligned in several rounds."""
LUMA_OUTLIER = 12.0
"""Levels at which the difference of a sample counts a quarter."""
LUMA_NOISE = 3.0
"""Levels; a picture that fits better is not trusted more than its noise allows."""
DEPTH_LIMIT = 0.03
"""Share of the depth by which a measurement may be off and still count: what is further off is another surface."""
SAMPLES_PER_WITNESS = 30
"""Neighboring samples are not independent; so many of them count as one against the prior."""
STEP_PRIOR = np.array([0.01, 0.01, 0.01, 0.003, 0.003, 0.003, np.inf, np.inf])
"""Deviation of one step of the displacement (m), the rotation (rad), gain and offset."""
SHIFT_PRIOR = np.array([0.01, 0.01, 0.01, 0.01, 0.01, 0.01])
"""Deviation of the color picture's displacement (m) and rotation (rad)."""
GAIN_DAMPING = np.array([0, 0, 0, 0, 0, 0, 1e-6, 1e-6])
"""Gain and offset have no prior; this keeps them from being singular on an even picture."""
CONVERGED = 1e-4
"""Meters and radians; a smaller step is far below a pixel."""
MIN_POINTS = 100
"""For eight unknowns."""


def aligned_pose(
    frame: Frame,
    rig: CameraRig,
    T_camera_object: Pose,
    points: Doubles,
    luma: Doubles,
    *,
    sensor: SensorModel,
) -> Pose:
    """Move an object so that its points fit the frame's picture and depth.

    Parameters
    ----------
    frame
        The frame.
    rig
        Cameras.
    T_camera_object
        The pose to start from.
    points, luma
        (n, 3) points of the object in meters, and (n,) their luma.
    sensor
        Noise of the depth.

    Returns
    -------
    Pose
        The start where there are too few points.
    """
    problem = _Problem(frame=frame, rig=rig, points=points, luma=luma, sensor=sensor)
    return _aligned(problem, T_camera_object)


def aligned_shift(
    frame: Frame, rig: CameraRig, T_camera_object: Pose, points: Doubles, luma: Doubles, T_shifted_camera: Pose
) -> Pose:
    """Return the shift of the depth camera with which points fit the picture alone; see `aligned_pose`."""
    problem = _Problem(frame=frame, rig=rig, points=points, luma=luma, anchor=T_camera_object)
    end = _aligned(problem, compose(T_shifted_camera, T_camera_object))
    return compose(end, inverse(T_camera_object))


class _Estimate(NamedTuple):
    """Where the object is before the depth camera, and how the picture's luma follows from the model's."""

    pose: Pose
    gain: float
    offset: float

    def moved(self, step: Doubles) -> _Estimate:
        """Return it after a step (8,): displacement, rotation, gain, offset."""
        motion = make_pose(rotation_from_vector(step[3:6]), step[:3])
        return _Estimate(compose(motion, self.pose), self.gain + step[6], self.offset + step[7])


class _BlurredLuma(NamedTuple):
    """A picture (h, w) and its slopes in levels a pixel."""

    luma: Floats
    slope_x: Floats
    slope_y: Floats

    @classmethod
    def of(cls, picture: Floats, blur_px: float) -> _BlurredLuma:
        """Blur a picture (h, w)."""
        smooth = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur_px), dtype=np.float32)
        slope_x, slope_y = (
            np.asarray(cv2.Sobel(smooth, cv2.CV_32F, *axes, ksize=3, scale=0.125), dtype=np.float32)
            for axes in ((1, 0), (0, 1))
        )
        return cls(smooth, slope_x, slope_y)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    """What a pose is to fit: a frame's picture, its depth if the `sensor` is told, and an `anchor` to keep near."""

    frame: Frame
    rig: CameraRig
    points: Doubles
    luma: Doubles
    sensor: SensorModel | None = None
    anchor: Pose | None = None

    def equations(self, estimate: _Estimate, picture: _BlurredLuma) -> tuple[Doubles, Doubles]:
        """Return matrix (8, 8), of which the upper half counts, and side (8,) of a Gauss-Newton step."""
        pose = estimate.pose
        matrix, side = self._luma_equations(estimate, picture)
        if self.sensor is not None:
            depth_matrix, depth_side = self._depth_equations(self.sensor, pose)
            matrix, side = matrix + depth_matrix, side + depth_side
        if self.anchor is not None:
            matrix[range(6), range(6)] += SHIFT_PRIOR**-2
            side[:6] += SHIFT_PRIOR**-2 * _small_twist(compose(pose, inverse(self.anchor)))
        return matrix, side

    def _luma_equations(self, estimate: _Estimate, picture: _BlurredLuma) -> tuple[Doubles, Doubles]:
        matrix, side = np.zeros((8, 8)), np.zeros(8)
        seen = LumaPicture(*picture, self.rig.color.parameters(), self.rig.T_color_depth)
        total, count = add_luma_equations(
            self.points, self.luma, estimate.pose, seen, estimate.gain, estimate.offset, LUMA_OUTLIER, matrix, side
        )
        share = 1 / (SAMPLES_PER_WITNESS * max(total / max(count, 1.0), LUMA_NOISE**2))
        return matrix * share, side * share

    def _depth_equations(self, sensor: SensorModel, pose: Pose) -> tuple[Doubles, Doubles]:
        noise = np.array([sensor.s0_m, sensor.s1, sensor.s2_per_m, sensor.quantum_per_m])
        matrix, side = np.zeros((8, 8)), np.zeros(8)
        total, count = add_depth_equations(
            self.points, pose, self.rig.depth.parameters(), self.frame.depth, noise, DEPTH_LIMIT, matrix, side
        )
        share = 1 / (SAMPLES_PER_WITNESS * max(total / max(count, 1.0), 1.0))
        return matrix * share, side * share


def _aligned(problem: _Problem, start: Pose) -> Pose:
    """Take Gauss-Newton steps from a pose."""
    if len(problem.points) < MIN_POINTS:
        return start
    luma = cv2.cvtColor(problem.frame.color, cv2.COLOR_RGB2GRAY).astype(np.float32)
    estimate = _Estimate(start, 1.0, 0.0)
    for blur_px in BLURS_PX:
        picture = _BlurredLuma.of(luma, blur_px)
        for _ in range(POSE_STEPS):
            matrix, side = problem.equations(estimate, picture)
            full = matrix + np.triu(matrix, 1).T + np.diag(STEP_PRIOR**-2 + GAIN_DAMPING)
            step = np.asarray(-np.linalg.solve(full, side), dtype=np.float64)
            estimate = estimate.moved(step)
            if np.abs(step[:6]).max() < CONVERGED:
                break
    return estimate.pose


def _small_twist(T: Pose) -> Doubles:
    """Return displacement and rotation (6,) of a small motion, to first order."""
    rotation = [T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]]
    return np.concatenate([T[:3, 3], 0.5 * np.array(rotation)])
