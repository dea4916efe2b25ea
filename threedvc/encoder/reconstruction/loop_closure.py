# SPDX-License-Identifier: MIT
"""Correct the drift of a camera that was tracked: register keyframes with each other, and make all agree.

A camera is tracked against the model so far, which holds the errors of the poses that it was fused at. Afterwards some
of the frames, spread over its path, are registered with earlier ones that saw the same place a while before, depth and
luma against depth and luma. A pose graph (`threedvc.encoder.reconstruction.pose_graph`) reconciles that with the motion
from each to the next, which is known from tracking but for a little drift; frames between are corrected as those about
them are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from threedvc.encoder.reconstruction.pose_graph import Link, optimized
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.registration.frame_resolutions import FrameResolutions, ObjectView
from threedvc.encoder.registration.icp import Alignment
from threedvc.encoder.registration.initial_poses import register_multi_start
from threedvc.encoder.registration.registration import (
    DepthSample,
    ModelView,
    RegistrationConfig,
    RegistrationProblem,
    view_of_frame,
)
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import Pose, compose, identity, interpolated, inverse, rotation_angle
from threedvc.stream.pose_status import PoseStatus

__all__ = ["close_loops", "corrected", "key_numbers"]

STEP_RAD, STEP = 0.05, 0.035
"""The next keyframe comes after this rotation, or this displacement in parts of the distance of what is seen: then
about a twentieth of the picture is new."""
MAX_KEYFRAMES = 160
"""Of a longer path they are further apart: the time for pairs and the pose graph grows with their number (decision
0029)."""
REACH_RAD, REACH = 0.5, 0.5
"""Rotation, and displacement in parts of the distance, up to which frames are registered with each other: beyond, too
little is seen in both."""
MAX_LINKS = 12
"""To earlier keyframes, spread over them: one costs a registration (decision 0029)."""
MIN_OVERLAP, MIN_INLIERS = 0.35, 0.6
"""Parts of the samples that must meet the other frame, and fit: more than where a model is tracked, as a wrong link
bends the path."""
WITNESS = 100.0
"""Neighboring samples are not independent; so many of them count as one."""
BEST_RAD, BEST = 1e-3, 1e-3
"""A link is no surer than this rotation, and this displacement in parts of the distance: sensors bend, shutters roll
(decision 0029)."""
DRIFT_RAD, DRIFT = 1.5e-3, 1.5e-3
"""What tracking drifts from one keyframe to the next, in rotation and in displacement in parts of the distance; by
hand."""
MIN_CORRECTION = 1e-3
"""Corrections below this rotation, and this displacement in parts of the distance, are not worth another pass: links
are no surer (decision 0029)."""
LOOP_KEYFRAMES = 6
"""Earlier keyframes than the last so many are worth a link: the model so far has bound the others together."""
PAIRWISE = RegistrationConfig(detail_pixels=0, min_overlap=0.2, min_inliers=0.5)
"""Registration of single frames, with luma as it is, as gain and offset are found anyway; its bounds are lower than
those that a link must meet."""


class _View:
    """A keyframe: its number, its views, and where it was found."""

    def __init__(self, number: int, views: FrameResolutions, mask: np.ndarray, at: TrackedPose) -> None:
        seen = ObjectView(views, mask)
        self.number, self.T_world_camera, self.submap = number, inverse(at.T_camera_object), at.submap
        depth, luma = seen.object_depth, views.luma(seen.resolution)
        self.sample = DepthSample(depth, luma, None, seen.resolution.camera)
        known = depth[depth > 0]
        self.distance_m = float(np.median(known)) if len(known) else 1.0
        self._view: ModelView | None = None

    @property
    def view(self) -> ModelView:
        """The keyframe as something to register with; the object's frame is its camera's."""
        if self._view is None:
            self._view = view_of_frame(self.sample, identity())
        return self._view


def key_numbers(poses: Sequence[Pose | None], distance_m: float) -> list[int]:
    """Return the numbers of frames spread evenly over the path of ``T_camera_world``; None where it is not known."""
    widest = 1.0
    while True:
        chosen: list[int] = []
        for number, pose in enumerate(poses):
            if pose is None:
                continue
            last = poses[chosen[-1]] if chosen else None
            if last is None or _apart(pose @ inverse(last), distance_m, widest * STEP_RAD, widest * STEP):
                chosen.append(number)
        if len(chosen) <= MAX_KEYFRAMES:
            return chosen
        widest *= 1.3


def close_loops(scene: Scene, frames: FrameSequence) -> list[TrackedPose | None] | None:
    """Return where the background is in every frame when its keyframes have been made to agree with each other.

    None where no place is seen again after a while, or poses agree already.
    """
    found = scene.objects[0].found
    # Of several sensors the first one closes loops; all are mounted together.
    usable = [
        at.T_camera_object if at is not None and at.usable and not sensor else None
        for at, sensor in zip(found, (record.sensor for record in scene.records), strict=True)
    ]
    keys = []
    for number in key_numbers(usable, scene.distance_m):
        frame, at = scene.with_depth_limit(frames[number]), found[number]
        if at is not None and frame.depth.any():
            keys.append(_View(number, scene.views(frame), scene.labels(frame) == 0, at))
    links = _links(keys, scene)
    before = [key.T_world_camera for key in keys]
    after = zip(keys, optimized(before, links), strict=True)
    corrections = {key.number: compose(pose, inverse(key.T_world_camera)) for key, pose in after}
    if not any(_apart(motion, scene.distance_m, MIN_CORRECTION, MIN_CORRECTION) for motion in corrections.values()):
        return None
    return corrected(found, corrections)


def corrected(found: Sequence[TrackedPose | None], corrections: dict[int, Pose]) -> list[TrackedPose | None]:
    """Return located frames moved as the corrections of the world say, between two of them by a share of both.

    Parameters
    ----------
    found
        Where the background is in every frame.
    corrections
        By frame, motions of the camera in the world; at least one.
    """
    numbers = sorted(corrections)
    result: list[TrackedPose | None] = []
    for frame, at in enumerate(found):
        after = next((k for k in numbers if k >= frame), numbers[-1])
        before = next((k for k in reversed(numbers) if k <= frame), numbers[0])
        share = (frame - before) / (after - before) if after != before else 0.0
        motion = interpolated(corrections[before], corrections[after], min(max(share, 0.0), 1.0))
        result.append(at and replace(at, T_camera_object=at.T_camera_object @ inverse(motion)))
    return result


def _links(keys: Sequence[_View], scene: Scene) -> list[Link]:
    """Return the motion from each keyframe to the next, and what registration with earlier ones finds."""
    links = []
    for second in range(1, len(keys)):
        if keys[second].submap == keys[second - 1].submap:  # how parts lie to each other is not known
            links.append(_step(keys, second))
        for first in _partners(keys, second):
            link = _link(keys, first, second, scene)
            if link is not None:
                links.append(link)
    return links


def _partners(keys: Sequence[_View], second: int) -> list[int]:
    """Return the keyframes before one that see about the same, spread over time."""
    here = keys[second]
    near = []
    for first in range(second - LOOP_KEYFRAMES):
        T = inverse(keys[first].T_world_camera) @ here.T_world_camera
        if not _apart(T, here.distance_m, REACH_RAD, REACH):
            near.append(first)
    return near[:: -(-len(near) // MAX_LINKS)] if near else []


def _step(keys: Sequence[_View], second: int) -> Link:
    """Return the motion from a keyframe to the next as tracking has found it."""
    a, b = keys[second - 1], keys[second]
    information = np.diag(np.repeat([DRIFT_RAD**-2, (DRIFT * b.distance_m) ** -2], 3))
    T = inverse(a.T_world_camera) @ b.T_world_camera
    return Link(first=second - 1, second=second, T_first_second=T, information=information)


def _link(keys: Sequence[_View], first: int, second: int, scene: Scene) -> Link | None:
    a, b = keys[first], keys[second]
    sigma_m, threads = scene.sensor_of(0).sigma_m, scene.config.threads
    problem = RegistrationProblem(sample=b.sample, view=a.view, sigma_m=sigma_m, config=PAIRWISE, threads=threads)
    guess = inverse(b.T_world_camera) @ a.T_world_camera
    found = register_multi_start(problem, guess)
    if found.status is PoseStatus.LOST or found.overlap < MIN_OVERLAP or found.inlier_fraction < MIN_INLIERS:
        return None
    information = Alignment(problem).information(found.T_camera_object)
    if information is None:
        return None
    return Link(
        first=first,
        second=second,
        T_first_second=inverse(found.T_camera_object),
        information=_tempered(information / WITNESS, b.distance_m),
    )


def _tempered(information: np.ndarray, distance_m: float) -> np.ndarray:
    """Return an information (6, 6) that is no surer than `BEST_RAD` and `BEST`."""
    floor = np.repeat([BEST_RAD**-2, (BEST * distance_m) ** -2], 3)
    # (A^-1 + B^-1)^-1 without inverting A, which may be singular.
    return np.asarray(np.diag(floor) - np.diag(floor) @ np.linalg.solve(information + np.diag(floor), np.diag(floor)))


def _apart(T: Pose, distance_m: float, rotation_rad: float, displacement: float) -> bool:
    """Tell whether a motion of the camera rotates, or displaces what is seen at a distance, by more than this."""
    return rotation_angle(T) > rotation_rad or float(np.linalg.norm(T[:3, 3])) > displacement * distance_m
