# SPDX-License-Identifier: MIT
"""Poses and shifts of the colour camera that make a coloured model meet the pictures."""

from __future__ import annotations

import cv2
import numpy as np

from threedvc.arrays import Doubles
from threedvc.frames.frame import Frame
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, inverse, make_pose, rotation_from_vector
from threedvc.kernels.encoder.appearance import (
    add_depth_equations,
    add_luma_equations,
)

__all__ = ["MIN_POINTS", "aligned_pose", "aligned_shift"]

BLURS_PX = (2.0, 1.0)
POSE_STEPS = 5
LUMA_OUTLIER = 12.0
LUMA_NOISE = 3.0
DEPTH_LIMIT = 0.03
SAMPLES_PER_WITNESS = 30
"""Neighbouring samples are not independent; so many of them count as one against the prior."""
STEP_PRIOR = np.array([0.01, 0.01, 0.01, 0.003, 0.003, 0.003, np.inf, np.inf])
"""Deviation of one step of the shift (m), the turn (rad), gain and offset."""
SHIFT_PRIOR = np.array([0.01, 0.01, 0.01, 0.01, 0.01, 0.01])
"""Deviation of the colour picture's shift (m) and turn (rad)."""
GAIN_DAMPING = np.array([0, 0, 0, 0, 0, 0, 1e-6, 1e-6])
CONVERGED = 1e-4
MIN_POINTS = 100


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
        (n, 3) points of the object in metres, and (n,) their luma.
    sensor
        Noise of the depth.

    Returns
    -------
    Pose
        The start where there are too few points.
    """
    return _aligned(frame, rig, T_camera_object, points, luma, sensor, None)


def aligned_shift(
    frame: Frame, rig: CameraRig, T_camera_object: Pose, points: Doubles, luma: Doubles, T_shifted_camera: Pose
) -> Pose:
    """Return the shift of the depth camera with which points fit the picture alone; see `aligned_pose`."""
    start = compose(T_shifted_camera, T_camera_object)
    end = _aligned(frame, rig, start, points, luma, None, T_camera_object)
    return compose(end, inverse(T_camera_object))


def _aligned(
    frame: Frame,
    rig: CameraRig,
    pose: Pose,
    points: Doubles,
    luma: Doubles,
    sensor: SensorModel | None,
    anchor: Pose | None,
) -> Pose:
    """Take Gauss-Newton steps; without `sensor` the depth does not count, with an `anchor` the pose keeps near it."""
    if len(points) < MIN_POINTS:
        return pose
    picture = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY).astype(np.float32)
    gain, offset = 1.0, 0.0
    for blur in BLURS_PX:
        smooth = cv2.GaussianBlur(picture, (0, 0), blur)
        slopes = [np.asarray(cv2.Sobel(smooth, cv2.CV_32F, *axes, ksize=3, scale=0.125)) for axes in ((1, 0), (0, 1))]
        for _ in range(POSE_STEPS):
            matrix, side = np.zeros((8, 8)), np.zeros(8)
            total, count = add_luma_equations(
                points, luma, pose, rig.T_color_depth, rig.color.parameters(), smooth, slopes[0], slopes[1], gain,
                offset, LUMA_OUTLIER, matrix, side,
            )  # fmt: skip
            share = 1 / (SAMPLES_PER_WITNESS * max(total / max(count, 1.0), LUMA_NOISE**2))
            matrix, side = matrix * share, side * share
            if sensor is not None:
                depth_matrix, depth_side = _depth_equations(frame, rig, sensor, pose, points)
                matrix, side = matrix + depth_matrix, side + depth_side
            if anchor is not None:
                matrix[range(6), range(6)] += SHIFT_PRIOR**-2
                side[:6] += SHIFT_PRIOR**-2 * _twist(compose(pose, inverse(anchor)))
            full = matrix + np.triu(matrix, 1).T + np.diag(STEP_PRIOR**-2 + GAIN_DAMPING)
            step = -np.linalg.solve(full, side)
            pose = compose(make_pose(rotation_from_vector(step[3:6]), step[:3]), pose)
            gain, offset = gain + step[6], offset + step[7]
            if np.abs(step[:6]).max() < CONVERGED:
                break
    return pose


def _depth_equations(
    frame: Frame, rig: CameraRig, sensor: SensorModel, pose: Pose, points: Doubles
) -> tuple[Doubles, Doubles]:
    noise = np.array([sensor.s0_m, sensor.s1, sensor.s2_per_m, sensor.quantum_per_m])
    matrix, side = np.zeros((8, 8)), np.zeros(8)
    total, count = add_depth_equations(
        points, pose, rig.depth.parameters(), frame.depth, noise, DEPTH_LIMIT, matrix, side
    )
    share = 1 / (SAMPLES_PER_WITNESS * max(total / max(count, 1.0), 1.0))
    return matrix * share, side * share


def _twist(T: Pose) -> Doubles:
    """Return shift and turn (6,) of a small motion."""
    turn = [T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]]
    return np.concatenate([T[:3, 3], 0.5 * np.array(turn)])
