# SPDX-License-Identifier: MIT
"""Where each object is in each frame: known poses, or registration against the model so far (sec. 2.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from threedvc.config import Motion
from threedvc.errors import ConfigError
from threedvc.evidence_view import Thinned, cast_view
from threedvc.frame import Frame, SequenceInfo
from threedvc.object_model import EvidenceModel
from threedvc.pose import Pose, identity, inverse, make_pose
from threedvc.registration import Status, register, rests
from threedvc.registration_starts import predict, register_from_starts
from threedvc.sensor_model import SensorModel

__all__ = ["Located", "Tracker", "known_pose", "motion_of", "refined"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Located:
    """An object's pose in a frame, and how it was found: known, tracked, weak or lost."""

    T_camera_object: Pose
    status: str

    @property
    def usable(self) -> bool:
        """Whether the frame may be fused at this pose."""
        return self.status != Status.LOST


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


class Tracker:
    """Follows one object by registration; remembers its last two poses.

    Parameters
    ----------
    thinned
        Reduces frames for registration.
    sensor
        Noise of the depth.
    threads
        Number of threads; poses do not depend on it.
    """

    def __init__(self, thinned: Thinned, sensor: SensorModel, threads: int) -> None:
        self._thinned, self._sensor, self._threads = thinned, sensor, threads
        self._poses: list[Pose] = []
        self._resting = False

    def start(self, frame: Frame, mask: NDArray[np.bool_], number: int) -> Located:
        """Place the object's own frame: the camera's for the background, else the middle of what is seen."""
        T = identity()
        if number:
            seen = mask & (frame.depth > 0)
            z = frame.depth[seen].astype(np.float64)
            slopes = self._thinned.rig.depth.rays()[seen]
            centre = np.array([np.median(slopes[:, 0] * z), np.median(slopes[:, 1] * z), np.median(z)])
            T = make_pose(np.eye(3), centre)
        self._poses = [T]
        return Located(T_camera_object=T, status=Status.TRACKED)

    def locate(self, frame: Frame, mask: NDArray[np.bool_], model: EvidenceModel, luma: NDArray[np.float32]) -> Located:
        """Register a frame against the evidence; a lost object stays where it was."""
        thinned, camera = self._thinned, self._thinned.camera
        depth, mask = thinned.thin(frame.depth), thinned.thin(mask)
        last = self._poses[-1]
        guess = predict(*self._poses) if len(self._poses) > 1 else last
        view = cast_view(model, thinned, guess, self._threads)
        options = _Options(sigma_m=self._sensor.sigma_m, threads=self._threads)
        found = register_from_starts(depth, luma, mask, camera, view, guess, **options)
        if found.status is Status.LOST:
            return Located(T_camera_object=last, status=Status.LOST)
        self._resting = rests(depth, luma, mask, camera, view, last, found, resting=self._resting, **options)
        pose = last if self._resting else found.T_camera_object
        self._poses = [last, pose]
        return Located(T_camera_object=pose, status=found.status)


def refined(
    at: Located,
    frame: Frame,
    mask: NDArray[np.bool_],
    luma: NDArray[np.float32],
    model: EvidenceModel,
    thinned: Thinned,
    sensor: SensorModel,
    threads: int,
) -> Located:
    """Register a frame once more, against the finished model, from the pose that it was fused at.

    The pose stays as it is unless the other fits significantly better.
    """
    depth, mask, camera = thinned.thin(frame.depth), thinned.thin(mask), thinned.camera
    view = cast_view(model, thinned, at.T_camera_object, threads)
    options = _Options(sigma_m=sensor.sigma_m, threads=threads)
    found = register(depth, luma, mask, camera, view, at.T_camera_object, **options)
    if found.status is not Status.TRACKED:
        return at
    if rests(depth, luma, mask, camera, view, at.T_camera_object, found, resting=True, **options):
        return at
    return replace(at, T_camera_object=found.T_camera_object)
