# SPDX-License-Identifier: MIT
"""Registration of one object in the frames that several sensors took at one moment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.registration.frame_resolutions import ObjectView
from threedvc.encoder.registration.icp import Alignment
from threedvc.encoder.registration.initial_poses import register_multi_start
from threedvc.encoder.registration.model_view import raycast_model
from threedvc.encoder.registration.registration import (
    ModelView,
    Registration,
    RegistrationConfig,
    RegistrationProblem,
    is_stationary,
    register,
)
from threedvc.encoder.tracking.pose_fusion import PoseEstimate, fused_pose
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, inverse, rotation_angle
from threedvc.stream.pose_status import PoseStatus

__all__ = ["RegistrationSettings", "SensorRegistration", "joint_registration", "relocalize_near", "reregister"]

MAX_TURN_RAD, MAX_SHIFT = 0.1, 0.1
"""Poses that sensors find at one moment differ by less than this turn, and this shift in parts of the distance: more
than extrinsics are ever off by, less than from one symmetry of an object to the next."""


@dataclass(frozen=True, kw_only=True)
class RegistrationSettings:
    """What all registrations of one object have in common.

    Attributes
    ----------
    sensor_of
        Noise of the depth by the number of the sensor.
    threads
        Number of threads; poses do not depend on it.
    config
        Choices.
    """

    sensor_of: Callable[[int], SensorModel]
    threads: int
    config: RegistrationConfig

    def problem(self, seen: ObjectView, view: ModelView) -> RegistrationProblem:
        """Return the registration of what a sensor sees with a view of the model."""
        sigma_m = self.sensor_of(seen.frame.sensor).sigma_m
        return RegistrationProblem(
            sample=seen.sample, view=view, sigma_m=sigma_m, config=self.config, threads=self.threads
        )


@dataclass(frozen=True, eq=False)
class SensorRegistration:
    """The registration of one sensor's frame: what was found before the sensor, and what it was found with."""

    problem: RegistrationProblem
    found: Registration
    rig: CameraRig

    @property
    def in_rig(self) -> Registration:
        """What was found, with the pose before the rig."""
        return replace(self.found, T_camera_object=self.rig.at_rig(self.found.T_camera_object))

    def estimate(self) -> PoseEstimate | None:
        """Return how surely the frame tells the pose; None where it hardly does."""
        information = Alignment(self.problem).information(self.found.T_camera_object)
        if information is None:
            return None
        return PoseEstimate(self.in_rig.T_camera_object, self.problem.view.T_camera_object, information)


def joint_registration(results: Sequence[SensorRegistration]) -> Registration:
    """Return what the registrations of the frames of a moment, at least one, say together, before the rig.

    Only those of the best status that agree with the one of most inliers count.
    """
    if len(results) == 1:
        return results[0].in_rig
    statuses = [each.found.status for each in results]
    best = next((status for status in (PoseStatus.TRACKED, PoseStatus.WEAK) if status in statuses), None)
    chosen = [each for each in results if each.found.status is best]
    if not chosen:
        return results[0].in_rig
    chosen.sort(key=lambda each: -each.found.inliers)
    leading, depth = chosen[0].in_rig, chosen[0].problem.view.depth
    estimates = [estimate for each in chosen if (estimate := each.estimate()) is not None]
    distance_m = float(np.median(depth[depth > 0]))
    agreeing = [each for each in estimates if _agree(each.T_rig_object, leading.T_camera_object, distance_m)]
    if len(agreeing) < 2:
        return leading
    return replace(leading, T_camera_object=fused_pose(agreeing))


def _agree(one: Pose, other: Pose, distance_m: float) -> bool:
    """Tell whether two poses of an object are so near that they can be the same with some noise."""
    change = one @ inverse(other)
    return rotation_angle(change) < MAX_TURN_RAD and float(np.linalg.norm(change[:3, 3])) < MAX_SHIFT * distance_m


def reregister(
    at: TrackedPose, seen: Sequence[ObjectView], model: EvidenceModel, settings: RegistrationSettings
) -> TrackedPose:
    """Register the frames of a moment once more, against the finished model, from the pose that they were fused at.

    The pose stays as it is unless the other fits significantly better.
    """
    results, moved = [], False
    for each in seen:
        T_camera_object, problem = _against_model(each, model, at.T_camera_object, settings)
        found = register(problem, T_camera_object)
        if found.status is PoseStatus.TRACKED:
            moved |= not is_stationary(problem, T_camera_object, found, resting=True)
        results.append(SensorRegistration(problem, found, each.rig))
    if not moved:
        return at
    return replace(at, T_camera_object=joint_registration(results).T_camera_object)


def relocalize_near(
    at: TrackedPose, T_guess: Pose, seen: Sequence[ObjectView], model: EvidenceModel, settings: RegistrationSettings
) -> TrackedPose:
    """Look for a lost object near a guess in the finished model; it stays lost, at the guess, if it is not there."""
    results = []
    for each in seen:
        T_camera_object, problem = _against_model(each, model, T_guess, settings)
        results.append(SensorRegistration(problem, register_multi_start(problem, T_camera_object), each.rig))
    found = joint_registration(results)
    if found.status is not PoseStatus.TRACKED:
        return replace(at, T_camera_object=T_guess)
    return replace(at, T_camera_object=found.T_camera_object, status=PoseStatus.RELOCALIZED)


def _against_model(
    seen: ObjectView, model: EvidenceModel, T_rig_object: Pose, settings: RegistrationSettings
) -> tuple[Pose, RegistrationProblem]:
    """Return a pose before a sensor, and its frame's registration with the model as seen from there."""
    T_camera_object = seen.rig.at_sensor(T_rig_object)
    view = raycast_model(model, seen.resolution, T_camera_object, settings.threads, exact=True)
    return T_camera_object, settings.problem(seen, view)
