# SPDX-License-Identifier: MIT
"""Registration of one object in the frames that several sensors took at one moment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.tracking.alignment import Alignment
from threedvc.encoder.tracking.initial_poses import register_from_starts
from threedvc.encoder.tracking.model_view import FrameViews, cast_view
from threedvc.encoder.tracking.pose_fusion import PoseWitness, joint_pose
from threedvc.encoder.tracking.pose_track import Located
from threedvc.encoder.tracking.registration import ModelView, Registration, RegistrationConfig, Status, register, rests
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, inverse, rotation_angle

__all__ = ["JointResult", "RegistrationOptions", "Sight", "as_samples", "join_results", "refined", "refound"]

SAME_TURN_RAD, SAME_SHIFT = 0.1, 0.1
"""Poses that sensors find at one moment differ by less than this turn, and this shift in parts of the distance."""
_Seen: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], Camera]
"""Depth, luma and mask (h, w) of a thinned frame, and its camera."""


class RegistrationOptions(TypedDict):
    """What every call of the registration is given."""

    sigma_m: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    threads: int
    config: RegistrationConfig


class Sight(NamedTuple):
    """What one sensor sees of an object: the forms of its frame, and the object's pixels (h, w) in the depth camera."""

    views: FrameViews
    mask: NDArray[np.bool_]


class JointResult(NamedTuple):
    """The registration of one frame: what was found before its sensor, and what it was found with."""

    found: Registration
    seen: _Seen
    view: ModelView
    options: RegistrationOptions
    rig: CameraRig

    @property
    def at_base(self) -> Registration:
        """What was found, with the pose before the base."""
        return replace(self.found, T_camera_object=self.rig.at_base(self.found.T_camera_object))

    def witness(self) -> PoseWitness | None:
        """Return how surely the frame tells the pose; None where it hardly does."""
        options = self.options
        alignment = Alignment(*self.seen, self.view, options["sigma_m"], options["config"], options["threads"])
        information = alignment.information(self.found.T_camera_object)
        if information is None:
            return None
        return PoseWitness(self.at_base.T_camera_object, self.view.T_camera_object, information)


def join_results(witnesses: Sequence[JointResult]) -> Registration:
    """Return what the registrations of the frames of a moment, at least one, say together, before the base.

    Only those of the best status that agree with the one of most inliers count.
    """
    if len(witnesses) == 1:
        return witnesses[0].at_base
    best = next((s for s in (Status.TRACKED, Status.WEAK) if any(each.found.status is s for each in witnesses)), None)
    chosen = [each for each in witnesses if each.found.status is best]
    if not chosen:
        return witnesses[0].at_base
    chosen.sort(key=lambda each: -each.found.inliers)
    leading = chosen[0].at_base
    said = [witness for each in chosen if (witness := each.witness()) is not None]
    distance_m = float(np.median(chosen[0].view.depth[chosen[0].view.depth > 0]))
    agreeing = [each for each in said if _agree(each.T_base_object, leading.T_camera_object, distance_m)]
    if len(agreeing) < 2:
        return leading
    return replace(leading, T_camera_object=joint_pose(agreeing))


def _agree(one: Pose, other: Pose, distance_m: float) -> bool:
    """Tell whether two poses of an object are so near that they can be the same with some noise."""
    change = one @ inverse(other)
    return rotation_angle(change) < SAME_TURN_RAD and float(np.linalg.norm(change[:3, 3])) < SAME_SHIFT * distance_m


def as_samples(views: FrameViews, mask: NDArray[np.bool_]) -> _Seen:
    """Return what registration takes of a frame."""
    form = views.form(mask)
    return form.thin(views.frame.depth), views.luma(form), form.thin(mask), form.camera


def refined(
    at: Located,
    sights: Sequence[Sight],
    model: EvidenceModel,
    sensors: Sequence[SensorModel],
    threads: int,
    config: RegistrationConfig | None = None,
) -> Located:
    """Register the frames of a moment once more, against the finished model, from the pose that they were fused at.

    The pose stays as it is unless the other fits significantly better. `sensors` are the noise of every sight's depth.
    """
    witnesses, moved = [], False
    for (views, mask), sensor in zip(sights, sensors, strict=True):
        T_camera_object, seen = views.rig.at_sensor(at.T_camera_object), as_samples(views, mask)
        view = cast_view(model, views.form(mask), T_camera_object, threads, exact=True)
        options = RegistrationOptions(sigma_m=sensor.sigma_m, threads=threads, config=config or RegistrationConfig())
        found = register(*seen, view, T_camera_object, **options)
        if found.status is Status.TRACKED:
            moved |= not rests(*seen, view, T_camera_object, found, resting=True, **options)
        witnesses.append(JointResult(found, seen, view, options, views.rig))
    if not moved:
        return at
    return replace(at, T_camera_object=join_results(witnesses).T_camera_object)


def refound(
    at: Located,
    T_guess: Pose,
    sights: Sequence[Sight],
    model: EvidenceModel,
    sensors: Sequence[SensorModel],
    threads: int,
) -> Located:
    """Look for a lost object near a guess in the finished model; it stays lost, at the guess, if it is not there."""
    witnesses = []
    for (views, mask), sensor in zip(sights, sensors, strict=True):
        T_camera_object, seen = views.rig.at_sensor(T_guess), as_samples(views, mask)
        view = cast_view(model, views.form(mask), T_camera_object, threads, exact=True)
        options = RegistrationOptions(sigma_m=sensor.sigma_m, threads=threads, config=RegistrationConfig())
        found = register_from_starts(*seen, view, T_camera_object, **options)
        witnesses.append(JointResult(found, seen, view, options, views.rig))
    together = join_results(witnesses)
    if together.status is not Status.TRACKED:
        return replace(at, T_camera_object=T_guess)
    return replace(at, T_camera_object=together.T_camera_object, status=Status.RELOCALISED)
