# SPDX-License-Identifier: MIT
"""Where each object is in each frame: known poses, or registration against the model so far (sec. 2.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray

from threedvc.camera import CameraRig
from threedvc.config import Motion
from threedvc.errors import ConfigError
from threedvc.evidence_view import FrameViews, cast_view
from threedvc.frame import Frame, SequenceInfo
from threedvc.object_model import EvidenceModel
from threedvc.pose import Pose, identity, inverse, make_pose
from threedvc.registration import ModelView, RegistrationConfig, Status, register, rests
from threedvc.registration_starts import predict, register_from_starts
from threedvc.sensor_model import SensorModel

__all__ = ["UNSEEN", "Located", "Script", "Tracker", "known_pose", "motion_of", "refined"]

SAME_SURFACE = 0.03
UNSEEN = "unseen"
"""Status of an object that is not in sight, at the pose it is taken to have."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Located:
    """An object's pose in a frame, and how it was found: known, tracked, relocalised, weak, lost or unseen."""

    T_camera_object: Pose
    status: str

    @property
    def usable(self) -> bool:
        """Whether the frame may be fused at this pose."""
        return self.status not in (Status.LOST, UNSEEN)


Script: TypeAlias = dict[int, list[Located | None]]
"""Where every object is in every frame, by number; None where it is not."""


def motion_of(number: int, info: SequenceInfo, motion: Motion) -> Motion:
    """Decide whether the poses of an object are taken from the input or tracked.

    The background of an input that knows poses of objects but none of the camera stands still.

    Raises
    ------
    ConfigError
        If poses are asked for that the input does not have.
    """
    known = info.has_camera_poses or (number == 0 and info.has_object_poses) if number == 0 else info.has_object_poses
    if motion is Motion.KNOWN and not known:
        raise ConfigError(
            f"{info.name} has no poses for object {number}; give poses.txt or object_poses.json, or use --motion track"
        )
    if motion is Motion.AUTO:
        return Motion.KNOWN if known else Motion.TRACK
    return motion


def known_pose(number: int, frame: Frame, only_label: bool) -> Pose | None:
    """Return T_camera_object as the input gives it, or None for a frame without.

    With `only_label` an object whose number names no pose takes the only one there is: a depth threshold
    finds one object, whatever its label.
    """
    if number == 0:
        return identity() if frame.T_world_camera is None else inverse(frame.T_world_camera)
    poses: Mapping[int, Pose] = frame.T_camera_object
    if number in poses:
        return poses[number]
    return next(iter(poses.values())) if only_label and len(poses) == 1 else None


class _Options(TypedDict):
    """What every call of the registration is given."""

    sigma_m: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    threads: int
    config: RegistrationConfig


class Tracker:
    """Follows one object by registration; remembers its last two poses and how it looked last.

    Depth is registered with the model, luma with the frame before: the model's colours are as coarse as its
    cells, and mix the shades that a turning object shows under a fixed light.

    Parameters
    ----------
    sensor
        Noise of the depth.
    threads
        Number of threads; poses do not depend on it.
    """

    def __init__(self, sensor: SensorModel, threads: int) -> None:
        self._sensor, self._threads = sensor, threads
        self._poses: list[Pose] = []
        self._resting = False
        self._last: tuple[int, NDArray[np.float32], NDArray[np.float32]] | None = None

    def start(self, views: FrameViews, mask: NDArray[np.bool_], number: int, rig: CameraRig) -> Located:
        """Place the object's own frame: the camera's for the background, else the middle of what is seen."""
        T, frame = identity(), views.frame
        if number:
            seen = mask & (frame.depth > 0)
            z = frame.depth[seen].astype(np.float64)
            slopes = rig.depth.rays()[seen]
            centre = np.array([np.median(slopes[:, 0] * z), np.median(slopes[:, 1] * z), np.median(z)])
            T = make_pose(np.eye(3), centre)
        self._poses = [T]
        self._remember(views, mask)
        return Located(T_camera_object=T, status=Status.TRACKED)

    def locate(self, views: FrameViews, mask: NDArray[np.bool_], model: EvidenceModel) -> Located:
        """Register a frame against the evidence; a lost object stays where it was."""
        thinned = views.form(mask)
        camera = thinned.camera
        whole = mask
        depth, luma, mask = thinned.thin(views.frame.depth), views.luma(thinned), thinned.thin(mask)
        last = self._poses[-1]
        guess = predict(*self._poses) if len(self._poses) > 1 else last
        view = self._as_last_seen(cast_view(model, thinned, last, self._threads), thinned.stride)
        options = _Options(sigma_m=self._sensor.sigma_m, threads=self._threads, config=RegistrationConfig())
        found = register_from_starts(depth, luma, mask, camera, view, guess, **options)
        if found.status is Status.LOST:
            return Located(T_camera_object=last, status=Status.LOST)
        self._resting = rests(depth, luma, mask, camera, view, last, found, resting=self._resting, **options)
        pose = last if self._resting else found.T_camera_object
        self._poses = [last, pose]
        self._remember(views, whole)
        return Located(T_camera_object=pose, status=found.status)

    def resume(self, T_camera_object: Pose) -> None:
        """Go on from a pose: the object was out of sight, or was found by other means."""
        self._poses, self._resting, self._last = [T_camera_object], False, None

    def _remember(self, views: FrameViews, mask: NDArray[np.bool_]) -> None:
        form = views.form(mask)
        depth = np.where(form.thin(mask), form.thin(views.frame.depth), np.float32(0))
        self._last = (form.stride, depth, views.luma(form))

    def _as_last_seen(self, view: ModelView, stride: int) -> ModelView:
        """Give a view from the last pose the luma that the last frame had where it showed the same surface."""
        if self._last is None or self._last[0] != stride:
            return view
        _, depth, luma = self._last
        same = (view.depth > 0) & (np.abs(depth - view.depth) < SAME_SURFACE * view.depth)
        return replace(view, intensity=np.where(same, luma, np.float32(np.nan)))


def refined(
    at: Located,
    views: FrameViews,
    mask: NDArray[np.bool_],
    model: EvidenceModel,
    sensor: SensorModel,
    threads: int,
    config: RegistrationConfig | None = None,
) -> Located:
    """Register a frame once more, against the finished model, from the pose that it was fused at.

    The pose stays as it is unless the other fits significantly better.
    """
    thinned = views.form(mask)
    depth, luma, mask, camera = thinned.thin(views.frame.depth), views.luma(thinned), thinned.thin(mask), thinned.camera
    view = cast_view(model, thinned, at.T_camera_object, threads)
    options = _Options(sigma_m=sensor.sigma_m, threads=threads, config=config or RegistrationConfig())
    found = register(depth, luma, mask, camera, view, at.T_camera_object, **options)
    if found.status is not Status.TRACKED:
        return at
    if rests(depth, luma, mask, camera, view, at.T_camera_object, found, resting=True, **options):
        return at
    return replace(at, T_camera_object=found.T_camera_object)
