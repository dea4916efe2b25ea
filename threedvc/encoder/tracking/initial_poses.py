# SPDX-License-Identifier: MIT
"""Poses from which registration may start: the prediction, and what to try when it fails.

`register` refines a pose within about a tenth of the depth or some twenty degrees. Larger motions, as of
an object on a turntable or after dropped frames, need a better start. `register_from_starts` tries the
prediction and, only if that does not fit, the pose of the view, the pose of matched picture features, and
the view's pose moved to the middle of what is seen, as it is and turned about that middle. The best of them
at coarse levels are refined.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats, Mask
from threedvc.encoder.tracking.alignment import Alignment
from threedvc.encoder.tracking.registration_types import (
    ModelView,
    Registration,
    RegistrationConfig,
    Sigma,
    Status,
    camera_rays,
)
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse, make_pose, orthonormalised, rotation_from_vector

__all__ = ["feature_start", "other_starts", "predict", "register_from_starts"]

TURNS_RAD = (0.2, 0.4)
REFINED_STARTS = 3
MAX_FEATURES = 800
MAX_RATIO = 0.8
MIN_MATCHES = 6
DRAWS = 200
MATCH_DISTANCE = 0.02
MIN_INLIERS = 0.7


def predict(T_before: Pose, T_previous: Pose) -> Pose:
    """Return the pose that follows two poses at constant velocity."""
    return orthonormalised(T_previous @ inverse(T_before) @ T_previous)


def register_from_starts(
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
    """Register a frame from a guess and, if that does not fit, from other starts.

    Parameters are those of `threedvc.encoder.tracking.registration.register`. A result from another start replaces the
    first only if it is tracked and agrees better.
    """
    alignment = Alignment(depth, intensity, mask, camera, view, sigma_m, config or RegistrationConfig(), threads)
    first = alignment.solve_near(T_guess)
    if first.status is not Status.LOST and first.inlier_fraction >= alignment.config.weak_inliers:
        return first
    starts = other_starts(depth, intensity, mask, camera, view)
    coarse = sorted((alignment.solve(start, finest=1) for start in starts), key=_agreement, reverse=True)
    refined = (alignment.solve(found.T_camera_object) for found in coarse[:REFINED_STARTS] if found.inliers)
    trusted = [found for found in refined if found.status is Status.TRACKED and found.inlier_fraction >= MIN_INLIERS]
    return max([first, *trusted], key=_agreement)


def _agreement(found: Registration) -> float:
    return found.agreement if found.status is not Status.LOST else 0.0


def other_starts(
    depth: Floats, intensity: Floats, mask: Mask | None, camera: Camera, view: ModelView
) -> Iterator[Pose]:
    """Yield poses ``T_camera_object`` to try: the view's, middles brought together, features, turns."""
    yield view.T_camera_object
    points, there = _points(depth, mask, camera), _points(view.depth, None, camera)
    if not len(points) or not len(there):
        return
    matched = feature_start(depth, intensity, mask, camera, view)
    if matched is not None:
        yield matched
    middle, other = np.median(points, axis=0), np.median(there, axis=0)
    for turn in _turns():
        yield make_pose(turn, middle - turn @ other) @ view.T_camera_object


def _turns() -> Iterator[Doubles]:
    yield np.eye(3)
    for angle in TURNS_RAD:
        for axis in np.eye(3):
            yield rotation_from_vector(angle * axis)
            yield rotation_from_vector(-angle * axis)


def _points(depth: Floats, mask: Mask | None, camera: Camera) -> Doubles:
    known = depth > 0 if mask is None else mask & (depth > 0)
    z = depth[known].astype(np.float64)
    return np.column_stack([camera_rays(camera)[known] * z[:, None], z])


def feature_start(depth: Floats, intensity: Floats, mask: Mask | None, camera: Camera, view: ModelView) -> Pose | None:
    """Find a pose from picture features that the frame and the view share; None where there are too few.

    Matched features with depth on both sides are pairs of points in space. Rigid motions through three
    pairs drawn at random (always the same way) are tried, the one that most pairs follow is fitted to them.
    """
    frame = _features(intensity, depth > 0 if mask is None else mask & (depth > 0))
    model = _features(view.intensity, view.depth > 0)
    if frame is None or model is None:
        return None
    pairs = [pair for pair in cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(frame[1], model[1], k=2) if len(pair) == 2]
    clear = [best for best, second in pairs if best.distance < MAX_RATIO * second.distance]
    if len(clear) < MIN_MATCHES:
        return None
    here = _lifted(frame[0][[match.queryIdx for match in clear]], depth, camera)
    there = _lifted(model[0][[match.trainIdx for match in clear]], view.depth, camera)
    motion = _common_motion(there, here)
    return None if motion is None else motion @ view.T_camera_object


def _features(luma: Floats, known: Mask) -> tuple[Doubles, NDArray[np.uint8]] | None:
    picture = np.clip(np.nan_to_num(luma, nan=0.0), 0, 255).astype(np.uint8)
    points, descriptors = cv2.ORB.create(MAX_FEATURES, fastThreshold=7).detectAndCompute(picture, None)
    pixels = np.array([point.pt for point in points]).reshape(-1, 2)
    if not len(pixels):
        return None
    columns, rows = np.rint(pixels).astype(np.intp).T
    inside = known[rows, columns]
    return (pixels[inside], descriptors[inside]) if np.count_nonzero(inside) >= MIN_MATCHES else None


def _lifted(pixels: Doubles, depth: Floats, camera: Camera) -> Doubles:
    columns, rows = np.rint(pixels).astype(np.intp).T
    z = depth[rows, columns].astype(np.float64)
    return np.column_stack([camera.unproject_pixels(pixels) * z[:, None], z])


def _rigid_fit(source: Doubles, target: Doubles) -> Pose:
    """Return the rigid motion that brings points nearest to their partners (least squares)."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - b).T @ (source - a))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return make_pose(turn, b - turn @ a)


def _common_motion(source: Doubles, target: Doubles) -> Pose | None:
    """Return the rigid motion that most pairs of points follow, or None where too few agree."""
    draw = np.random.default_rng(0)
    bound = MATCH_DISTANCE * target[:, 2]
    best = np.zeros(len(source), dtype=np.bool_)
    for _ in range(DRAWS):
        chosen = draw.choice(len(source), 3, replace=False)
        motion = _rigid_fit(source[chosen], target[chosen])
        follows = np.linalg.norm(source @ motion[:3, :3].T + motion[:3, 3] - target, axis=1) < bound
        if np.count_nonzero(follows) > np.count_nonzero(best):
            best = follows
    if np.count_nonzero(best) < MIN_MATCHES:
        return None
    return _rigid_fit(source[best], target[best])
