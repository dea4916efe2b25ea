# SPDX-License-Identifier: MIT
"""Where each object is in each frame: known poses, or registration against the model so far (sec. 2.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray

from threedvc.config import Motion
from threedvc.encoder.tracking.alignment import Alignment
from threedvc.encoder.tracking.initial_poses import predict, register_from_starts
from threedvc.encoder.tracking.model_view import FrameViews, cast_view, shown_and_measured
from threedvc.encoder.tracking.pose_fusion import PoseWitness, joint_pose
from threedvc.encoder.tracking.registration import ModelView, Registration, RegistrationConfig, Status, register, rests
from threedvc.encoder.tracking.registration_types import camera_rays
from threedvc.encoder.tracking.relocalisation import Keyframes
from threedvc.errors import ConfigError
from threedvc.frames.frame import NANOSECONDS, Frame, SequenceInfo
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, identity, interpolated, inverse, make_pose, orthonormalised, rotation_angle
from threedvc.model.decoded_model import EvidenceModel

__all__ = [
    "PART_CELLS",
    "UNSEEN",
    "Located",
    "Script",
    "Sight",
    "Tracker",
    "along_with_the_room",
    "bridged",
    "joined_parts",
    "known_pose",
    "motion_of",
    "pose_between",
    "refined",
    "refound",
]

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
SAME_TURN_RAD, SAME_SHIFT = 0.1, 0.1
"""Poses that sensors find at one moment differ by less than this turn, and this shift in parts of the distance."""
SLOWED = 0.5
"""Share of its motion with which an object is thought to go on if nothing determined some direction of it: else what
noise made of it would go on for ever."""
SAME_PLACE = 0.015
LEAST_ALIKE, MOST_ALIKE = 20, 0.7
"""An object rests where so many pixels at least, and this part of them, differ by less than that of their depth."""
COAST_FRAMES = 5
"""A lost object goes on as it went for so many frames, then stays."""
SAME_REST = 1e-9
UNSEEN = "unseen"
"""Status of an object that is not in sight, at the pose it is taken to have."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Located:
    """An object's pose in a frame, and how it was found: known, tracked, relocalised, weak, lost or unseen.

    With several sensors T_camera_object is that before the base, which all of them are mounted on. The part is that of
    the model which it was found by, see `Tracker`.
    """

    T_camera_object: Pose
    status: str
    part: int = 0

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
    """Return T_camera_object, before the sensor that took the frame, as the input gives it, or None where it does not.

    With `only_label` an object whose number names no pose takes the only one there is: a depth threshold
    finds one object, whatever its label.
    """
    if number == 0:
        return identity() if frame.T_world_camera is None else inverse(frame.T_world_camera)
    poses: Mapping[int, Pose] = frame.T_camera_object
    if number in poses:
        return poses[number]
    return next(iter(poses.values())) if only_label and len(poses) == 1 else None


_Seen: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], Camera]
"""Depth, luma and mask (h, w) of a thinned frame, and its camera."""


class _Options(TypedDict):
    """What every call of the registration is given."""

    sigma_m: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    threads: int
    config: RegistrationConfig


class Sight(NamedTuple):
    """What one sensor sees of an object: the forms of its frame, and the object's pixels (h, w) in the depth camera."""

    views: FrameViews
    mask: NDArray[np.bool_]


class _Registered(NamedTuple):
    """The registration of one frame: what was found before its sensor, and what it was found with."""

    found: Registration
    seen: _Seen
    view: ModelView
    options: _Options
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

    def _options(self, views: FrameViews) -> _Options:
        """Return what registration of a frame is given."""
        sensor = self._sensor if self._sensor_of is None else self._sensor_of(views.frame.sensor)
        return _Options(sigma_m=sensor.sigma_m, threads=self._threads, config=self._config)

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
            seen, options, rig = _seen(frame_views, mask), self._options(frame_views), frame_views.rig
            search = register if near else register_from_starts
            found = search(*seen, view, rig.at_sensor(guess), **options)
            witnesses.append(_Registered(found, seen, view, options, rig))
        return _joined(witnesses)

    def _rests(self, sights: Sequence[Sight], views: Sequence[ModelView], last: Pose, found: Registration) -> bool:
        """Tell whether the object still has its last pose as far as all frames of a moment can tell."""
        for (frame_views, mask), view in zip(sights, views, strict=True):
            there = frame_views.rig.at_sensor
            here = replace(found, T_camera_object=there(found.T_camera_object))
            options = self._options(frame_views)
            if not rests(*_seen(frame_views, mask), view, there(last), here, resting=self._resting, **options):
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
            seen, options = _seen(views, mask), self._options(views)
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


def joined_parts(found: Sequence[Located | None], bridges: Mapping[int, tuple[Pose, int]]) -> list[Located | None]:
    """Return located frames with parts of the model brought to where those that were recognised from them are.

    Parameters
    ----------
    found
        Where an object is in every frame.
    bridges
        As of `Tracker.bridges`.
    """
    motions = {}
    for part in bridges:
        T, at, seen = identity(), part, set[int]()
        while at in bridges and at not in seen:
            seen.add(at)
            T, at = T @ bridges[at][0], bridges[at][1]
        motions[part] = T, at
    result: list[Located | None] = []
    for at_frame in found:
        if at_frame is not None and at_frame.part in motions:
            T, part = motions[at_frame.part]
            at_frame = replace(at_frame, T_camera_object=at_frame.T_camera_object @ T, part=part)
        result.append(at_frame)
    return result


def _joined(witnesses: Sequence[_Registered]) -> Registration:
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


def _shows(sight: Sight, view: ModelView) -> bool:
    """Tell whether a view of the model shows enough where a frame shows something that they can be compared."""
    form = sight.views.form(sight.mask)
    seen = form.thin(sight.mask) & (form.thin(sight.views.frame.depth) > 0)
    return bool(np.count_nonzero(view.depth[seen] > 0) >= LEAST_KNOWN * np.count_nonzero(seen))


def _agree(one: Pose, other: Pose, distance_m: float) -> bool:
    """Tell whether two poses of an object are so near that they can be the same with some noise."""
    change = one @ inverse(other)
    return rotation_angle(change) < SAME_TURN_RAD and float(np.linalg.norm(change[:3, 3])) < SAME_SHIFT * distance_m


def _seen(views: FrameViews, mask: NDArray[np.bool_]) -> _Seen:
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
        T_camera_object, seen = views.rig.at_sensor(at.T_camera_object), _seen(views, mask)
        view = cast_view(model, views.form(mask), T_camera_object, threads, exact=True)
        options = _Options(sigma_m=sensor.sigma_m, threads=threads, config=config or RegistrationConfig())
        found = register(*seen, view, T_camera_object, **options)
        if found.status is Status.TRACKED:
            moved |= not rests(*seen, view, T_camera_object, found, resting=True, **options)
        witnesses.append(_Registered(found, seen, view, options, views.rig))
    if not moved:
        return at
    return replace(at, T_camera_object=_joined(witnesses).T_camera_object)


def along_with_the_room(script: Mapping[int, Sequence[Located | None]], before: Script) -> Script:
    """Let tracked objects that rested in the background rest there in a new script, too.

    Parameters
    ----------
    script
        Where everything is in every frame; the background may have other poses than before.
    before
        The same as of the pass before.
    """
    result: Script = {number: list(found) for number, found in script.items()}
    old, new = before.get(0, []), result.get(0, [])
    for number in result.keys() & before.keys() - {0}:
        found, earlier = result[number], before[number]
        for frame in range(1, min(len(found), len(earlier), len(old), len(new))):
            was, then = _moved(old, frame), _moved(new, frame)
            at, last, then_last = earlier[frame], earlier[frame - 1], found[frame - 1]
            here = found[frame]
            if was is None or then is None or at is None or last is None or here is None or then_last is None:
                continue
            if at.status != "known" and np.abs(was @ last.T_camera_object - at.T_camera_object).max() < SAME_REST:
                found[frame] = replace(here, T_camera_object=then @ then_last.T_camera_object)
    return result


def _moved(found: Sequence[Located | None], frame: int) -> Pose | None:
    """Return how an object moved to a frame from the one before; None where that is not known."""
    last, now = found[frame - 1], found[frame]
    if last is None or now is None:
        return None
    if np.array_equal(last.T_camera_object, now.T_camera_object):
        return identity()
    return now.T_camera_object @ inverse(last.T_camera_object)


def pose_between(found: Sequence[Located | None], frame: int) -> Pose:
    """Return where a lost object was on its way between the frames nearest to it in which it was found.

    Between parts of a model there is no way: then it was where it was before.
    """
    usable = [(k, at) for k, at in enumerate(found) if at is not None and at.usable]
    before = max((each for each in usable if each[0] < frame), default=None, key=lambda each: each[0])
    after = min((each for each in usable if each[0] > frame), default=None, key=lambda each: each[0])
    if before is None or after is None or before[1].part != after[1].part:
        nearest = before or after
        at = nearest[1] if nearest is not None else found[frame]
        assert at is not None
        return at.T_camera_object
    share = (frame - before[0]) / (after[0] - before[0])
    return interpolated(before[1].T_camera_object, after[1].T_camera_object, share)


def bridged(found: Sequence[Located | None], blind: Sequence[bool], most: int) -> list[Located | None]:
    """Return located frames with short runs of those without depth on the way between the frames about them.

    What the picture alone says of a pose is worth less than that, but for long ways.

    Parameters
    ----------
    found
        Where an object is in every frame.
    blind
        Whether a frame has no depth.
    most
        Frames of a run at most.
    """
    result, start = list(found), 0
    for stop in range(len(result) + 1):
        if stop < len(result) and blind[stop]:
            continue
        before, after = (found[start - 1] if start else None), (found[stop] if stop < len(result) else None)
        if 0 < stop - start <= most and before is not None and after is not None and _same_part(before, after):
            ends = before.T_camera_object, after.T_camera_object
            for frame in range(start, stop):
                at = found[frame]
                if at is not None and at.status == Status.WEAK:
                    pose = interpolated(*ends, (frame - start + 1) / (stop - start + 1))
                    result[frame] = replace(at, T_camera_object=pose, part=before.part)
        start = stop + 1
    return result


def _same_part(before: Located, after: Located) -> bool:
    return before.usable and after.usable and before.part == after.part


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
        T_camera_object, seen = views.rig.at_sensor(T_guess), _seen(views, mask)
        view = cast_view(model, views.form(mask), T_camera_object, threads, exact=True)
        options = _Options(sigma_m=sensor.sigma_m, threads=threads, config=RegistrationConfig())
        found = register_from_starts(*seen, view, T_camera_object, **options)
        witnesses.append(_Registered(found, seen, view, options, views.rig))
    together = _joined(witnesses)
    if together.status is not Status.TRACKED:
        return replace(at, T_camera_object=T_guess)
    return replace(at, T_camera_object=together.T_camera_object, status=Status.RELOCALISED)
