# SPDX-License-Identifier: MIT
"""How well tasks are done: trajectories out of steps, surfaces near the true ones, matches that agree with geometry."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose
from threedvc.metrics.trajectory import trajectory_error

__all__ = [
    "GAP",
    "KEYPOINTS",
    "STRIDE",
    "SURFACE_M",
    "View",
    "agreeing_matches",
    "chained",
    "f_score",
    "trajectory_scores",
]

KEYPOINTS = 1000
"""ORB keypoints of a picture at most: twice the detector's default, so that its limit does not hide a difference."""
AGREES_PX = 3.0
"""Distance from where geometry says a point has gone: that of a usual test of matches (RANSAC in OpenCV)."""
HALF_PIXEL = 0.5
GAP, STRIDE = 10, 5
"""Frames between two pictures that are matched, and between one pair and the next."""
SURFACE_M = 0.01
"""Distance within which a point of a surface is right."""


def chained(steps: Iterable[Pose]) -> list[Pose]:
    """Return the poses T_first_k of frames, one more than steps T_k_next, beginning with the identity."""
    poses = [np.eye(4)]
    for T_this_next in steps:
        poses.append(poses[-1] @ T_this_next)
    return poses


def trajectory_scores(truth: Sequence[Pose], steps: Sequence[Pose]) -> dict[str, float]:
    """Return the errors of a trajectory that consists of steps from frame to frame.

    Parameters
    ----------
    truth
        T_world_camera of all frames.
    steps
        T_camera_next of all frames but the last.
    """
    error = trajectory_error(truth, chained(steps))
    return {
        "ate_mm": error.ate_rmse_mm,
        "rpe_mm": error.rpe_translation_mm,
        "rpe_deg": error.rpe_rotation_deg,
    }


def f_score(found_to_true: NDArray[np.float64], true_to_found: NDArray[np.float64], limit: float) -> float:
    """Return the harmonic mean of the shares of points within a limit of the other surface (Knapitsch et al. 2017).

    Parameters
    ----------
    found_to_true, true_to_found
        (n,) and (m,) distances of the points of one surface from the other; without any the score is 0.
    limit
        In their unit.
    """
    if not len(found_to_true) or not len(true_to_found):
        return 0.0
    precision, recall = (float(np.mean(distances <= limit)) for distances in (found_to_true, true_to_found))
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A picture whose geometry is known.

    Attributes
    ----------
    color
        (h, w, 3) uint8 RGB, in which keypoints are sought.
    depth
        (h, w) float32 meters, 0 = not known: that of the input, whatever the color has gone through.
    T_world_camera
        Where it was taken.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    T_world_camera: Pose


def agreeing_matches(first: View, second: View, camera: Camera) -> int:
    """Return how many mutual ORB matches of two pictures lead to where depth and poses say.

    A keypoint of the first picture without depth cannot be judged and does not count.
    """
    detector = cv2.ORB.create(nfeatures=KEYPOINTS)
    points, descriptors = [], []
    for view in (first, second):
        keypoints, described = detector.detectAndCompute(cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY), None)
        if described is None:
            return 0
        points.append(np.array([keypoint.pt for keypoint in keypoints], dtype=np.float64))
        descriptors.append(described)
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(*descriptors)
    if not matches:
        return 0
    pairs = np.array([(match.queryIdx, match.trainIdx) for match in matches])
    at, known = _moved(points[0][pairs[:, 0]], first, second, camera)
    distances = np.linalg.norm(at - points[1][pairs[:, 1]], axis=1)
    return int(np.count_nonzero(known & (distances <= AGREES_PX)))


def _moved(
    points: NDArray[np.float64], first: View, second: View, camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return where points (n, 2) of the first picture lie in the second, and which have a depth and lie before it."""
    columns, rows = np.floor(points + HALF_PIXEL).astype(np.int64).T
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    depth = np.where(inside, first.depth[np.where(inside, rows, 0), np.where(inside, columns, 0)], 0).astype(np.float64)
    rays = (points - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    T = np.linalg.inv(second.T_world_camera) @ first.T_world_camera
    places = np.column_stack([rays, np.ones(len(points))]) * depth[:, None] @ T[:3, :3].T + T[:3, 3]
    known = (depth > 0) & (places[:, 2] > 0)
    ahead = np.where(known, places[:, 2], 1.0)[:, None]
    return places[:, :2] / ahead * [camera.fx, camera.fy] + [camera.cx, camera.cy], known
