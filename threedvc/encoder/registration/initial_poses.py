# SPDX-License-Identifier: MIT
"""Poses from which registration may start: the prediction, and what to try when it fails.

`register` refines a pose within about a tenth of the depth or some twenty degrees. Larger motions, as of
an object on a turntable or after dropped frames, need a better start. `register_multi_start` tries the
prediction and, only if that does not fit, the pose of the view, the pose of matched picture features, and
the view's pose moved to the middle of what is seen, as it is and turned about that middle. The best of them
at coarse levels are refined.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from threedvc.arrays import Doubles, Floats, Mask
from threedvc.encoder.registration.feature_matching import Descriptors, detect_features, match_features
from threedvc.encoder.registration.icp import Alignment
from threedvc.encoder.registration.registration_types import (
    DepthSample,
    ModelView,
    Registration,
    RegistrationProblem,
    camera_rays,
)
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse, make_pose, orthonormalized, rigid_fit, rotation_from_vector
from threedvc.stream.pose_status import PoseStatus

__all__ = ["initial_poses", "pose_from_features", "predict", "register_multi_start"]

ROTATIONS_RAD = (0.2, 0.4)
"""Rotations about each axis that are tried: registration finds what lies within some twenty degrees (0.35) of them."""
REFINED_STARTS = 3
"""Of the poses tried at coarse levels so many are refined: these do not tell the best from the next best."""
MIN_INLIERS = 0.7
"""Part of the samples that must fit where another start is to be trusted: more than for the prediction, which has
the frames before to speak for it."""
MAX_FEATURES = 800
"""Enough for a whole picture of common size; more take longer and are mostly the same corners."""
MIN_MATCHES = 6
"""Twice the three pairs of points that determine a motion."""
DRAWS = 200
"""Of three pairs each: with 0.3 of the pairs right, all three are in one of them with a chance of 0.995."""
MATCH_DISTANCE = 0.02
"""Parts of the depth by which a pair may miss a motion that it follows."""


def predict(T_before: Pose, T_previous: Pose) -> Pose:
    """Return the pose that follows two poses at constant velocity."""
    return orthonormalized(T_previous @ inverse(T_before) @ T_previous)


def register_multi_start(problem: RegistrationProblem, T_guess: Pose) -> Registration:
    """Register a frame from a guess and, if that does not fit, from other poses.

    Parameters are those of `threedvc.encoder.registration.registration.register`. A result from another start replaces
    the first only if it is tracked and agrees better.
    """
    alignment = Alignment(problem)
    first = alignment.solve_near(T_guess)
    if first.status is not PoseStatus.LOST and first.inlier_fraction >= alignment.config.weak_inliers:
        return first
    starts = initial_poses(problem.sample, problem.view)
    coarse = sorted((alignment.solve(start, finest=1) for start in starts), key=_agreement, reverse=True)
    refined = (alignment.solve(found.T_camera_object) for found in coarse[:REFINED_STARTS] if found.inliers)
    trusted = [
        found for found in refined if found.status is PoseStatus.TRACKED and found.inlier_fraction >= MIN_INLIERS
    ]
    return max([first, *trusted], key=_agreement)


def _agreement(found: Registration) -> float:
    return found.agreement if found.status is not PoseStatus.LOST else 0.0


def initial_poses(sample: DepthSample, view: ModelView) -> Iterator[Pose]:
    """Yield poses ``T_camera_object`` to try: the view's, features, middles brought together, rotations."""
    yield view.T_camera_object
    points, there = (
        _points(sample.depth, sample.measured, sample.camera),
        _points(view.depth, view.depth > 0, view.camera),
    )
    if not len(points) or not len(there):
        return
    matched = pose_from_features(sample, view)
    if matched is not None:
        yield matched
    middle, other = np.median(points, axis=0), np.median(there, axis=0)
    for rotation in _rotations():
        yield make_pose(rotation, middle - rotation @ other) @ view.T_camera_object


def _rotations() -> Iterator[Doubles]:
    yield np.eye(3)
    for angle in ROTATIONS_RAD:
        for axis in np.eye(3):
            yield rotation_from_vector(angle * axis)
            yield rotation_from_vector(-angle * axis)


def _points(depth: Floats, known: Mask, camera: Camera) -> Doubles:
    z = depth[known].astype(np.float64)
    return np.column_stack([camera_rays(camera)[known] * z[:, None], z])


def pose_from_features(sample: DepthSample, view: ModelView) -> Pose | None:
    """Find a pose from picture features that the frame and the view share; None where there are too few.

    Matched features with depth on both sides are pairs of points in space. Rigid motions through three
    pairs drawn at random (the same ones in every run) are tried, the one that most pairs follow is fitted to them.
    """
    frame, model = _features(sample.luma, sample.measured), _features(view.intensity, view.depth > 0)
    if frame is None or model is None:
        return None
    query, train = match_features(frame[1], model[1])
    if len(query) < MIN_MATCHES:
        return None
    here = _lifted(frame[0][query], sample.depth, sample.camera)
    there = _lifted(model[0][train], view.depth, sample.camera)
    motion = _common_motion(there, here)
    return None if motion is None else motion @ view.T_camera_object


def _features(luma: Floats, known: Mask) -> tuple[Doubles, Descriptors] | None:
    """Return features at known pixels; None where there are too few."""
    picture = np.clip(np.nan_to_num(luma, nan=0.0), 0, 255).astype(np.uint8)
    pixels, descriptors = detect_features(picture, MAX_FEATURES)
    if not len(pixels):
        return None
    columns, rows = np.rint(pixels).astype(np.intp).T
    inside = known[rows, columns]
    return (pixels[inside], descriptors[inside]) if np.count_nonzero(inside) >= MIN_MATCHES else None


def _lifted(pixels: Doubles, depth: Floats, camera: Camera) -> Doubles:
    columns, rows = np.rint(pixels).astype(np.intp).T
    z = depth[rows, columns].astype(np.float64)
    return np.column_stack([camera.unproject_pixels(pixels) * z[:, None], z])


def _common_motion(source: Doubles, target: Doubles) -> Pose | None:
    """Return the rigid motion that most pairs of points follow, or None where too few agree."""
    draw = np.random.default_rng(0)
    bound = MATCH_DISTANCE * target[:, 2]
    best = np.zeros(len(source), dtype=np.bool_)
    for _ in range(DRAWS):
        chosen = draw.choice(len(source), 3, replace=False)
        motion = rigid_fit(source[chosen], target[chosen])
        follows = np.linalg.norm(source @ motion[:3, :3].T + motion[:3, 3] - target, axis=1) < bound
        if np.count_nonzero(follows) > np.count_nonzero(best):
            best = follows
    if np.count_nonzero(best) < MIN_MATCHES:
        return None
    return rigid_fit(source[best], target[best])
