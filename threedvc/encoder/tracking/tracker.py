# SPDX-License-Identifier: MIT
"""Where each object is in each frame: known poses, or registration against the model so far (sec. 2.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.tracking.initial_poses import predict, register_from_starts
from threedvc.encoder.tracking.joint_registration import (
    JointResult,
    RegistrationOptions,
    Sight,
    as_samples,
    join_results,
)
from threedvc.encoder.tracking.model_view import FrameViews, cast_view, shown_and_measured
from threedvc.encoder.tracking.pose_track import Located
from threedvc.encoder.tracking.registration import ModelView, Registration, RegistrationConfig, Status, register, rests
from threedvc.encoder.tracking.registration_types import camera_rays
from threedvc.encoder.tracking.relocalisation import Keyframes
from threedvc.frames.frame import Frame
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, identity, interpolated, inverse, make_pose, orthonormalised
from threedvc.units import NANOSECONDS

__all__ = ["PART_CELLS", "Tracker"]

SAME_SURFACE = 0.03
DOUBTFUL = 0.75
"""A fit that falls to this part of the usual one may be a wrong place: the picture is asked."""
USUAL = 0.9
PART_CELLS = 4096
"""Parts of a model lie so far apart: many times as far as cameras see, for cells are some pixels wide."""
RETURN_FRAMES = 10
"""In a new part, every so many frames are held against the others."""
UNEVEN = 0.2
"""Steps of time that differ by more than this part are taken into account when a pose is predicted."""
MAX_AHEAD = 3.0
CARRY_NS = NANOSECONDS // 5
LEAST_KNOWN = 0.3
"""Where a view of the model has less than this part of a frame's pixels, the frame shows something new."""
SLOWED = 0.5
"""Share of its motion with which an object is thought to go on if nothing determined some direction of it: else what
noise made of it would go on for ever."""
SAME_PLACE = 0.015
LEAST_ALIKE, MOST_ALIKE = 20, 0.7
"""An object rests where so many pixels at least, and this part of them, differ by less than that of their depth."""
COAST_FRAMES = 5
"""A lost object goes on as it went for so many frames, then stays."""


class _Remembered(NamedTuple):
    """How an object looked last to a sensor: stride of the form, depth and luma (h, w), pose before the base."""

    stride: int
    depth: NDArray[np.float32]
    luma: NDArray[np.float32]
    T_base_object: Pose


class Tracker:
    """Follows one object by registration; remembers its last two poses, how it looked last, and its keyframes.

    Depth is registered with the model, luma with the frame before: the model's colours are as coarse as its
    cells, and mix the shades that a turning object shows under a fixed light. Where that fails, the object is found
    again by keyframes, and what they say is registered.

    Where it is not found again in time, a new part of its model begins, from where the object is thought to be but
    moved far away in the object's own frame, so that nothing wrong is fused. When an earlier part is recognised, the
    object is followed there again, and `bridges` tells how the parts lie to each other.

    Frames that several sensors took at the same moment are registered each, and what they say is joined. Poses are
    those before the base; see `threedvc.geometry.camera.CameraRig`.

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
        Frames in which an object may be lost before a new part of its model begins; 0: for ever.
    recovers
        Whether a lost object is looked for and goes on for a moment as it went; else it waits where it was.

    Attributes
    ----------
    bridges
        By part, the motion of its frame ``T_part_other`` to where the part recognised from it has it, and that part.
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
        self._sensor, self._sensor_of, self._threads, self._config = sensor, sensor_of, threads, config
        self._poses: list[Pose] = []
        self._times: list[int] = []
        self._resting = False
        self._carries = 1.0
        self._usual = 0.0
        self._patience, self._lost, self._recovers = patience, 0, recovers
        self._part, self._parts, self._since_check, self._apart_m = 0, 1, 0, 1.0
        self.bridges: dict[int, tuple[Pose, int]] = {}
        self._keyframes: Keyframes | None = None
        self._last: dict[int, _Remembered] = {}
        self._sensors: dict[int, int] = {}
        self._way: list[tuple[int, Pose]] = []
        self._in_room = False

    def start(self, views: FrameViews, mask: NDArray[np.bool_], number: int, *rigs: CameraRig) -> Located:
        """Place the object's own frame: the camera's for the background, else the middle of what is seen.

        `rigs` are the cameras of every sensor.
        """
        T, frame = identity(), views.frame
        if number:
            seen = mask & (frame.depth > 0)
            z = frame.depth[seen].astype(np.float64)
            slopes = camera_rays(views.rig.depth)[seen]
            centre = np.array([np.median(slopes[:, 0] * z), np.median(slopes[:, 1] * z), np.median(z)])
            T = make_pose(np.eye(3), centre)
        if number:
            T = views.rig.at_base(T)
        self._keyframes = Keyframes(*rigs) if self._recovers else None
        self._go([T], frame)
        self._remember(views, mask)
        self._found(frame, T)
        return Located(T_camera_object=T, status=Status.TRACKED)

    def locate(
        self, views: FrameViews, mask: NDArray[np.bool_], model: EvidenceModel, *, near: bool = False
    ) -> Located:
        """Register a frame against the evidence; where that fails, find the object again or say that it is lost.

        With `near` only poses near the expected one count: that is quick where most objects will turn out to be none.
        """
        return self.locate_together([Sight(views, mask)], model, near=near)

    def locate_together(self, sights: Sequence[Sight], model: EvidenceModel, *, near: bool = False) -> Located:
        """Register the frames of one moment, at least one, as `locate` does."""
        last, frame = self._poses[-1], sights[0].views.frame
        carried, self._in_room = self._in_room, False
        guess = self._guess(frame)
        views = [self._view(sight, model, last) for sight in sights]
        found = self._registered(sights, views, guess, near=near)
        status = found.status
        if status is Status.LOST and self._carried(frame) and not any(map(_shows, sights, views)):
            return self._along(sights)
        if status is Status.LOST and carried and self._stays(sights, model, last):
            return self._stay(sights, last)
        if status is Status.LOST or (status is Status.WEAK and found.agreement < DOUBTFUL * self._usual):
            again = self._found_again(sights, model)
            if again is not None and again.agreement > found.agreement * (status is not Status.LOST):
                found, status = again, Status.RELOCALISED
            elif self._lost:
                status = Status.LOST  # a poor fit elsewhere than expected is no find
        if status is Status.LOST:
            waits = not self._patience or self._lost < self._patience
            return self._missed(frame) if waits else self._begin_part(sights, model)
        elsewhere = self._recognised(sights, model, found)
        if elsewhere is not None:
            found, status = elsewhere, Status.RELOCALISED
        determined = not self._config.agreement or found.conditioning >= self._config.min_conditioning
        self._carries = 1.0 if determined else SLOWED
        jumped = status is Status.RELOCALISED
        if jumped:
            self._part = self._part_of(found.T_camera_object)
        self._resting = not jumped and self._rests(sights, views, last, found)
        pose = last if self._resting else found.T_camera_object
        self._go([pose] if jumped else [last, pose], frame)
        self._usual += (1 - USUAL) * (found.agreement - self._usual) if self._usual else found.agreement
        self._lost = 0
        for sight in sights:
            self._remember(*sight)
            if status is not Status.WEAK:
                self._note(*sight)
        self._found(frame, pose)
        return Located(T_camera_object=pose, status=status, part=self._part)

    def _found(self, frame: Frame, pose: Pose) -> None:
        """Keep when a sensor found the object, and its way in the last moments."""
        self._sensors[frame.sensor] = frame.timestamp_ns
        self._way = [(time, at) for time, at in self._way if frame.timestamp_ns - time <= CARRY_NS]
        self._way.append((frame.timestamp_ns, pose))

    def _carried(self, frame: Frame) -> bool:
        """Tell whether the object was found a moment ago by another sensor, so that its pose is known anyway."""
        times = (time for sensor, time in self._sensors.items() if sensor != frame.sensor)
        return not self._lost and any(0 <= frame.timestamp_ns - time <= CARRY_NS for time in times)

    def _along(self, sights: Sequence[Sight]) -> Located:
        """Take the object to have gone on as other sensors saw it: the model knows nothing of what a frame shows."""
        (start, first), (end, last) = self._way[0], self._way[-1]
        ahead = sights[0].views.frame.timestamp_ns - end
        pose = last if end == start else interpolated(first, last, 1 + ahead / (end - start))
        for views, mask in sights:
            self._remember(views, mask, pose)
        return Located(T_camera_object=pose, status=Status.WEAK, part=self._part)

    def _stays(self, sights: Sequence[Sight], model: EvidenceModel, pose: Pose) -> bool:
        """Tell whether nothing speaks against a place: the depth is as shown there, or the model knows little."""
        seen = known = alike = 0
        for frame_views, mask in sights:
            there = frame_views.rig.at_sensor(pose)
            shown, measured = shown_and_measured(model, frame_views, mask, there, self._threads)
            both = (shown > 0) & (measured > 0)
            seen, known = seen + int(np.count_nonzero(measured)), known + int(np.count_nonzero(both))
            alike += int(np.count_nonzero(np.abs(shown - measured)[both] < SAME_PLACE * measured[both]))
        if known < LEAST_KNOWN * seen:
            return not self._lost
        return known >= LEAST_ALIKE and alike >= MOST_ALIKE * known

    def _stay(self, sights: Sequence[Sight], pose: Pose) -> Located:
        """Take the object to rest in the room, although its frames alone do not tell where it is."""
        self._lost = 0
        self._go([pose], sights[0].views.frame)
        for sight in sights:
            self._remember(*sight)
        self._found(sights[0].views.frame, pose)
        return Located(T_camera_object=pose, status=Status.WEAK, part=self._part)

    def locate_by_picture(self, views: FrameViews) -> Located:
        """Find the object in a frame without depth by the colour picture alone."""
        sights = [] if self._keyframes is None else self._keyframes.find(views.frame)
        if not sights:
            return self._missed(views.frame)
        pose = sights[0].T_camera_object
        self._last, self._resting = {}, False
        self._go([pose], views.frame)
        self._part = self._part_of(pose)
        return Located(T_camera_object=pose, status=Status.WEAK, part=self._part)

    def _options(self, views: FrameViews) -> RegistrationOptions:
        """Return what registration of a frame is given."""
        sensor = self._sensor if self._sensor_of is None else self._sensor_of(views.frame.sensor)
        return RegistrationOptions(sigma_m=sensor.sigma_m, threads=self._threads, config=self._config)

    def _go(self, poses: list[Pose], frame: Frame) -> None:
        """Take over the pose in a frame, after that of the frame before if they are to be two."""
        self._poses = poses
        self._times = [*self._times, frame.timestamp_ns][-len(poses) :]

    def _guess(self, frame: Frame) -> Pose:
        """Return the pose in a frame at constant velocity, or at half of it where not all of it was determined."""
        if len(self._poses) < 2:
            return self._poses[-1]
        ahead, step = frame.timestamp_ns - self._times[-1], self._times[-1] - self._times[0]
        steps = min(ahead / step, MAX_AHEAD) if ahead > 0 and step > 0 else 1.0
        following = predict(*self._poses)
        if abs(steps - 1) <= UNEVEN and self._carries == 1:
            return following
        return orthonormalised(interpolated(self._poses[-1], following, steps * self._carries))

    def _registered(
        self, sights: Sequence[Sight], views: Sequence[ModelView], guess: Pose, *, near: bool = False
    ) -> Registration:
        """Register the frames of a moment with their views; return what they say together, before the base."""
        witnesses = []
        for (frame_views, mask), view in zip(sights, views, strict=True):
            seen, options, rig = as_samples(frame_views, mask), self._options(frame_views), frame_views.rig
            search = register if near else register_from_starts
            found = search(*seen, view, rig.at_sensor(guess), **options)
            witnesses.append(JointResult(found, seen, view, options, rig))
        return join_results(witnesses)

    def _rests(self, sights: Sequence[Sight], views: Sequence[ModelView], last: Pose, found: Registration) -> bool:
        """Tell whether the object still has its last pose as far as all frames of a moment can tell."""
        for (frame_views, mask), view in zip(sights, views, strict=True):
            there = frame_views.rig.at_sensor
            here = replace(found, T_camera_object=there(found.T_camera_object))
            options = self._options(frame_views)
            if not rests(*as_samples(frame_views, mask), view, there(last), here, resting=self._resting, **options):
                return False
        return True

    def _missed(self, frame: Frame) -> Located:
        """Let a lost object go on for a moment, then stay where it was."""
        if not self._recovers:
            return Located(T_camera_object=self._poses[-1], status=Status.LOST)
        self._lost += 1
        coasts = len(self._poses) > 1 and self._lost <= COAST_FRAMES
        self._go([self._poses[-1], self._guess(frame)] if coasts else self._poses[-1:], frame)
        self._last, self._resting = {}, False
        return Located(T_camera_object=self._poses[-1], status=Status.LOST, part=self._part)

    def _begin_part(self, sights: Sequence[Sight], model: EvidenceModel) -> Located:
        """Begin a new part of the model with a moment, above the others as the first camera saw them."""
        self._apart_m = PART_CELLS * model.voxel_size_m
        on = np.array([0.0, (self._parts - self._part) * self._apart_m, 0.0])
        here = self._poses[-1] @ make_pose(np.eye(3), on)
        self._part, self._parts = self._parts, self._parts + 1
        self._resting, self._usual, self._lost, self._since_check = False, 0.0, 0, 0
        self._go([here], sights[0].views.frame)
        for sight in sights:
            self._remember(*sight)
            self._note(*sight)
        return Located(T_camera_object=here, status=Status.WEAK, part=self._part)

    def _recognised(self, sights: Sequence[Sight], model: EvidenceModel, found: Registration) -> Registration | None:
        """Look now and then whether a frame shows another part of the model, if the present one is not the first."""
        self._since_check += 1
        if not self._part or self._since_check < RETURN_FRAMES:
            return None
        self._since_check, last = 0, self._last
        elsewhere = self._found_again(sights, model, apart_from=found.T_camera_object)
        self._last = last
        if elsewhere is not None:
            other = self._part_of(elsewhere.T_camera_object)
            self.bridges[self._part] = (inverse(found.T_camera_object) @ elsewhere.T_camera_object, other)
        return elsewhere

    def _part_of(self, T_camera_object: Pose) -> int:
        """Return the part in which a pose places the camera."""
        height = -float(inverse(T_camera_object)[1, 3])
        return min(max(round(height / self._apart_m), 0), self._parts - 1)

    def _found_again(
        self, sights: Sequence[Sight], model: EvidenceModel, apart_from: Pose | None = None
    ) -> Registration | None:
        """Return the best registration of a moment's frames from poses that keyframes speak for, if it can be trusted.

        With a pose to be `apart_from`, only those in other parts of the model count.
        """
        if self._keyframes is None:
            return None
        self._last = {}
        trusted = []
        for sight in sights:
            views, mask = sight
            poses = [each.T_camera_object for each in self._keyframes.find(views.frame, mask)]
            if apart_from is not None:
                here = self._part_of(apart_from)
                poses = [pose for pose in poses if self._part_of(pose) != here]
            seen, options = as_samples(views, mask), self._options(views)
            for pose in poses:
                found = register(*seen, self._view(sight, model, pose), views.rig.at_sensor(pose), **options)
                if found.status is Status.TRACKED:
                    trusted.append(replace(found, T_camera_object=views.rig.at_base(found.T_camera_object)))
        return max(trusted, key=lambda found: found.agreement, default=None)

    def _note(self, views: FrameViews, mask: NDArray[np.bool_]) -> None:
        if self._keyframes is not None:
            self._keyframes.note(views.frame, mask, self._poses[-1])

    def resume(self, T_camera_object: Pose) -> None:
        """Go on from a pose: the object was out of sight, or was found by other means."""
        self._poses, self._resting, self._last = [T_camera_object], False, {}
        self._times = self._times[-1:]

    def carry(self, motion: Pose) -> None:
        """Take the object along as the room moved before the base: it is thought to stay, or to go on, there."""
        self._in_room = True
        self._poses = [motion @ pose for pose in self._poses]
        self._way = [(time, motion @ pose) for time, pose in self._way]

    def _remember(self, views: FrameViews, mask: NDArray[np.bool_], pose: Pose | None = None) -> None:
        """Keep how the object looks to a sensor at a pose, by default the present one."""
        form = views.form(mask)
        depth = np.where(form.thin(mask), form.thin(views.frame.depth), np.float32(0))
        at = self._poses[-1] if pose is None else pose
        self._last[views.frame.sensor] = _Remembered(form.stride, depth, views.luma(form), at)

    def _view(self, sight: Sight, model: EvidenceModel, pose: Pose) -> ModelView:
        """Cast the model from where a sensor saw the object last, with the luma of that frame on the same surface.

        What the sensor has not seen of late is cast from a pose before the base, with the luma of the model.
        """
        form, rig = sight.views.form(sight.mask), sight.views.rig
        last = self._last.get(sight.views.frame.sensor)
        if last is None or last.stride != form.stride:
            return cast_view(model, form, rig.at_sensor(pose), self._threads)
        view = cast_view(model, form, rig.at_sensor(last.T_base_object), self._threads)
        same = (view.depth > 0) & (np.abs(last.depth - view.depth) < SAME_SURFACE * view.depth)
        return replace(view, intensity=np.where(same, last.luma, np.float32(np.nan)))


def _shows(sight: Sight, view: ModelView) -> bool:
    """Tell whether a view of the model shows enough where a frame shows something that they can be compared."""
    form = sight.views.form(sight.mask)
    seen = form.thin(sight.mask) & (form.thin(sight.views.frame.depth) > 0)
    return bool(np.count_nonzero(view.depth[seen] > 0) >= LEAST_KNOWN * np.count_nonzero(seen))
