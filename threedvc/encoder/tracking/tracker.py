# SPDX-License-Identifier: MIT
"""A tracker follows one object by registration against the model so far (sec. 2.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from threedvc.arrays import Doubles
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.registration.frame_resolutions import FrameResolutions, ObjectView
from threedvc.encoder.registration.initial_poses import register_multi_start
from threedvc.encoder.registration.registration import (
    ModelView,
    Registration,
    RegistrationConfig,
    is_stationary,
    register,
)
from threedvc.encoder.registration.registration_types import camera_rays
from threedvc.encoder.tracking import recovery
from threedvc.encoder.tracking.joint_registration import RegistrationSettings, SensorRegistration, joint_registration
from threedvc.encoder.tracking.pose_track import SubmapLink, TrackedPose
from threedvc.encoder.tracking.relocalization import Keyframes
from threedvc.encoder.tracking.stopwatch import Stopwatch
from threedvc.encoder.tracking.track_state import TrackState
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, identity, make_pose
from threedvc.stream.pose_status import PoseStatus

__all__ = ["Tracker"]

DOUBTFUL = 0.75
"""A fit that falls to this part of the usual one may be a wrong place: the picture is asked."""
UNDETERMINED_SHARE = 0.5
"""Share of its motion with which an object is thought to go on if nothing determined some direction of it: else what
noise made of it would go on for ever (decision 0017)."""


class Tracker:
    """Follows one object by registration; remembers its last two poses, how it looked last, and its keyframes.

    Depth is registered with the model, luma with the frame before: the model's colors are as coarse as its
    cells, and mix the shades that a turning object shows under a fixed light. Where that fails, the object is found
    again by keyframes, and what they say is registered.

    Where it is not found again in time, a new submap of its model begins, from where the object is thought to be but
    moved far away in the object's own frame, so that nothing wrong is fused. When an earlier submap is recognized, the
    object is followed there again, and `submap_links` tells how the submaps lie to each other.

    Frames that several sensors took at the same moment are registered each, and what they say is joined. Poses are
    those before the rig; see `threedvc.geometry.camera.CameraRig`.

    Parameters
    ----------
    sensor
        Noise of the depth.
    threads
        Number of threads; poses do not depend on it.
    sensor_of
        Noise of the depth by the number of the sensor, where there are several; None: all are as `sensor`.
    lit_evenly
        Whether shading goes with the surface, as that of a room that only the camera moves in: then luma counts as it
        is, else against its local mean; and directions count that frame and view agree on.
    luma_weight
        Weight of luma against depth.
    patience
        Frames in which an object may be lost before a new submap of its model begins; 0: for ever.
    recovers
        Whether a lost object is looked for and goes on for a moment as it went; else it waits where it was.

    Attributes
    ----------
    stopwatch
        Time spent on finding the object, for benchmarks.
    """

    def __init__(
        self,
        sensor: SensorModel,
        threads: int,
        *,
        sensor_of: Callable[[int], SensorModel] | None = None,
        lit_evenly: bool = False,
        luma_weight: float = 1.0,
        patience: int = 0,
        recovers: bool = True,
    ) -> None:
        config = RegistrationConfig(luma_weight=luma_weight, agreement=lit_evenly)
        if lit_evenly:
            config = replace(config, detail_pixels=0)
        noise = sensor_of or (lambda _number: sensor)
        self._settings = RegistrationSettings(sensor_of=noise, threads=threads, config=config)
        self._patience, self._recovers = patience, recovers
        self._state = TrackState()
        self.stopwatch = Stopwatch()

    @property
    def submap_links(self) -> Mapping[int, SubmapLink]:
        """By submap, the motion of its frame to where the one recognized from it has it, and the number of that."""
        return self._state.submaps.links

    def start(self, seen: ObjectView, number: int, *rigs: CameraRig) -> TrackedPose:
        """Place the object's own frame: the camera's for the background, else the middle of what is seen.

        `rigs` are the cameras of every sensor.
        """
        with self.stopwatch:
            pose = seen.rig.at_rig(make_pose(np.eye(3), _middle(seen))) if number else identity()
            self._state.begin(pose, seen, Keyframes(*rigs) if self._recovers else None)
            return TrackedPose(T_camera_object=pose, status=PoseStatus.TRACKED)

    def locate(self, seen: Sequence[ObjectView], model: EvidenceModel, *, near: bool = False) -> TrackedPose:
        """Register the frames of one moment, at least one; where that fails, find the object again, or it is lost.

        With `near` only poses near the expected one count: that is quick where most objects will turn out to be none.
        """
        with self.stopwatch:
            state, settings, frame = self._state, self._settings, seen[0].frame
            in_background = state.take_background_motion()
            T_guess = state.predicted(frame.timestamp_ns)
            views = [state.model_view(each, model, settings.threads) for each in seen]
            found = self._registered(seen, views, T_guess, near=near)
            if found.status is PoseStatus.LOST:
                known = recovery.pose_without_registration(
                    state, seen, views, model, threads=settings.threads, in_background=in_background
                )
                if known is not None:
                    return known
            if self._is_doubtful(found):
                found = recovery.relocalize(state, found, seen, model, settings)
            if found.status is PoseStatus.LOST:
                waits = not self._patience or state.lost_frames < self._patience
                return recovery.coast(state, frame) if waits else recovery.begin_submap(state, seen, model)
            found = recovery.recognize_submap(state, found, seen, model, settings)
            return self._remember(seen, views, found)

    def locate_by_picture(self, views: FrameResolutions) -> TrackedPose:
        """Find the object in a frame without depth by the color picture alone."""
        with self.stopwatch:
            state = self._state
            hypotheses = [] if state.keyframes is None else state.keyframes.query(views.frame)
            if not hypotheses:
                return recovery.coast(state, views.frame)
            pose = hypotheses[0].T_camera_object
            state.interrupt()
            state.jump_to(pose, views.frame)
            state.submaps.current = state.submaps.containing(pose)
            return TrackedPose(T_camera_object=pose, status=PoseStatus.WEAK, submap=state.submaps.current)

    def resume(self, T_camera_object: Pose) -> None:
        """Go on from a pose: the object was out of sight, or was found by other means."""
        self._state.resume(T_camera_object)

    def apply_background_motion(self, motion: Pose) -> None:
        """Take the object along as the background moved before the rig: it is thought to stay, or to go on, there."""
        self._state.move_with_background(motion)

    def _registered(
        self, seen: Sequence[ObjectView], views: Sequence[ModelView], T_guess: Pose, *, near: bool
    ) -> Registration:
        """Register the frames of a moment with their views; return what they say together, before the rig."""
        search, results = register if near else register_multi_start, []
        for each, view in zip(seen, views, strict=True):
            problem = self._settings.problem(each, view)
            results.append(SensorRegistration(problem, search(problem, each.rig.at_sensor(T_guess)), each.rig))
        return joint_registration(results)

    def _is_doubtful(self, found: Registration) -> bool:
        """Tell whether keyframes are to be asked: the object was not found, or fits worse than usual."""
        worse = found.agreement < DOUBTFUL * self._state.usual_agreement
        return found.status is PoseStatus.LOST or (found.status is PoseStatus.WEAK and worse)

    def _remember(self, seen: Sequence[ObjectView], views: Sequence[ModelView], found: Registration) -> TrackedPose:
        """Take over where the object was found and how it looks there."""
        state, config, frame = self._state, self._settings.config, seen[0].frame
        determined = not config.agreement or found.conditioning >= config.min_conditioning
        state.velocity_share = 1.0 if determined else UNDETERMINED_SHARE
        if found.status is PoseStatus.RELOCALIZED:
            state.submaps.current = state.submaps.containing(found.T_camera_object)
            state.stationary = False
            state.jump_to(found.T_camera_object, frame)
        else:
            state.stationary = self._is_stationary(seen, views, found)
            state.go_to(state.pose if state.stationary else found.T_camera_object, frame)
        state.note_agreement(found.agreement)
        state.lost_frames = 0
        for each in seen:
            state.remember_view(each)
            if found.status is not PoseStatus.WEAK:
                state.add_keyframe(each)
        state.note_found(frame, state.pose)
        return TrackedPose(T_camera_object=state.pose, status=found.status, submap=state.submaps.current)

    def _is_stationary(self, seen: Sequence[ObjectView], views: Sequence[ModelView], found: Registration) -> bool:
        """Tell whether the object still has its last pose as far as all frames of a moment can tell."""
        resting = self._state.stationary
        for each, view in zip(seen, views, strict=True):
            here = replace(found, T_camera_object=each.rig.at_sensor(found.T_camera_object))
            last = each.rig.at_sensor(self._state.pose)
            if not is_stationary(self._settings.problem(each, view), last, here, resting=resting):
                return False
        return True


def _middle(seen: ObjectView) -> Doubles:
    """Return the median (3,) of the points of an object before its sensor."""
    depth = seen.frame.depth
    shown = seen.mask & (depth > 0)
    z, slopes = depth[shown].astype(np.float64), camera_rays(seen.rig.depth)[shown]
    return np.array([np.median(slopes[:, 0] * z), np.median(slopes[:, 1] * z), np.median(z)])
