# SPDX-License-Identifier: MIT
"""Where each object is in each frame: known poses, or registration against the model so far (sec. 2.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray

from threedvc.camera import Camera, CameraRig
from threedvc.config import Motion
from threedvc.errors import ConfigError
from threedvc.evidence_view import FrameViews, Thinned, cast_view
from threedvc.frame import Frame, SequenceInfo
from threedvc.keyframes import Keyframes
from threedvc.object_model import EvidenceModel
from threedvc.pose import Pose, identity, interpolated, inverse, make_pose
from threedvc.registration import ModelView, Registration, RegistrationConfig, Status, register, rests
from threedvc.registration_starts import predict, register_from_starts
from threedvc.sensor_model import SensorModel

__all__ = [
    "UNSEEN",
    "Located",
    "Script",
    "Tracker",
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
COAST_FRAMES = 5
"""A lost object goes on as it went for so many frames, then stays."""
UNSEEN = "unseen"
"""Status of an object that is not in sight, at the pose it is taken to have."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Located:
    """An object's pose in a frame, and how it was found: known, tracked, relocalised, weak, lost or unseen.

    The part is that of the model which it was found by, see `Tracker`.
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


_Seen: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], Camera]
"""Depth, luma and mask (h, w) of a thinned frame, and its camera."""


class _Options(TypedDict):
    """What every call of the registration is given."""

    sigma_m: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    threads: int
    config: RegistrationConfig


class Tracker:
    """Follows one object by registration; remembers its last two poses, how it looked last, and its keyframes.

    Depth is registered with the model, luma with the frame before: the model's colours are as coarse as its
    cells, and mix the shades that a turning object shows under a fixed light. Where that fails, the object is found
    again by keyframes, and what they say is registered.

    Where it is not found again in time, a new part of its model begins, from where the object is thought to be but
    moved far away in the object's own frame, so that nothing wrong is fused. When an earlier part is recognised, the
    object is followed there again, and `bridges` tells how the parts lie to each other.

    Parameters
    ----------
    sensor
        Noise of the depth.
    threads
        Number of threads; poses do not depend on it.
    lit_evenly
        Whether shading goes with the surface, as that of a room that only the camera moves in: then luma counts as it
        is, else against its local mean.
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
        lit_evenly: bool = False,
        luma_weight: float = 1.0,
        patience: int = 0,
        recovers: bool = True,
    ) -> None:
        config = RegistrationConfig(luma_weight=luma_weight)
        if lit_evenly:
            config = replace(config, detail_pixels=0)
        self._options = _Options(sigma_m=sensor.sigma_m, threads=threads, config=config)
        self._poses: list[Pose] = []
        self._resting = False
        self._usual = 0.0
        self._patience, self._lost, self._recovers = patience, 0, recovers
        self._part, self._parts, self._since_check, self._apart_m = 0, 1, 0, 1.0
        self.bridges: dict[int, tuple[Pose, int]] = {}
        self._keyframes: Keyframes | None = None
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
        self._keyframes = Keyframes(rig) if self._recovers else None
        self._poses = [T]
        self._remember(views, mask)
        return Located(T_camera_object=T, status=Status.TRACKED)

    def locate(self, views: FrameViews, mask: NDArray[np.bool_], model: EvidenceModel) -> Located:
        """Register a frame against the evidence; where that fails, find the object again or say that it is lost."""
        last = self._poses[-1]
        guess = predict(*self._poses) if len(self._poses) > 1 else last
        seen = _seen(views, mask)
        view = self._view(views.form(mask), model, last)
        found = register_from_starts(*seen, view, guess, **self._options)
        status = found.status
        if status is Status.LOST or (status is Status.WEAK and found.agreement < DOUBTFUL * self._usual):
            again = self._found_again(views, mask, model)
            if again is not None and again.agreement > found.agreement * (status is not Status.LOST):
                found, status = again, Status.RELOCALISED
            elif self._lost:
                status = Status.LOST  # a poor fit elsewhere than expected is no find
        if status is Status.LOST:
            waits = not self._patience or self._lost < self._patience
            return self._missed() if waits else self._begin_part(views, mask, model)
        elsewhere = self._recognised(views, mask, model, found)
        if elsewhere is not None:
            found, status = elsewhere, Status.RELOCALISED
        jumped = status is Status.RELOCALISED
        if jumped:
            self._part = self._part_of(found.T_camera_object)
        self._resting = not jumped and rests(*seen, view, last, found, resting=self._resting, **self._options)
        pose = last if self._resting else found.T_camera_object
        self._poses = [pose] if jumped else [last, pose]
        self._usual += (1 - USUAL) * (found.agreement - self._usual) if self._usual else found.agreement
        self._lost = 0
        self._remember(views, mask)
        if status is not Status.WEAK:
            self._note(views, mask)
        return Located(T_camera_object=pose, status=status, part=self._part)

    def locate_by_picture(self, views: FrameViews) -> Located:
        """Find the object in a frame without depth by the colour picture alone."""
        sights = [] if self._keyframes is None else self._keyframes.find(views.frame)
        if not sights:
            return self._missed()
        pose = sights[0].T_camera_object
        self._poses, self._last, self._resting = [pose], None, False
        self._part = self._part_of(pose)
        return Located(T_camera_object=pose, status=Status.WEAK, part=self._part)

    def _missed(self) -> Located:
        """Let a lost object go on for a moment, then stay where it was."""
        if not self._recovers:
            return Located(T_camera_object=self._poses[-1], status=Status.LOST)
        self._lost += 1
        if len(self._poses) > 1 and self._lost <= COAST_FRAMES:
            self._poses = [self._poses[-1], predict(*self._poses)]
        else:
            self._poses = self._poses[-1:]
        self._last, self._resting = None, False
        return Located(T_camera_object=self._poses[-1], status=Status.LOST, part=self._part)

    def _begin_part(self, views: FrameViews, mask: NDArray[np.bool_], model: EvidenceModel) -> Located:
        """Begin a new part of the model with a frame, above the others as the first camera saw them."""
        self._apart_m = PART_CELLS * model.voxel_size_m
        on = np.array([0.0, (self._parts - self._part) * self._apart_m, 0.0])
        here = self._poses[-1] @ make_pose(np.eye(3), on)
        self._part, self._parts = self._parts, self._parts + 1
        self._poses, self._resting, self._usual, self._lost, self._since_check = [here], False, 0.0, 0, 0
        self._remember(views, mask)
        self._note(views, mask)
        return Located(T_camera_object=here, status=Status.WEAK, part=self._part)

    def _recognised(
        self, views: FrameViews, mask: NDArray[np.bool_], model: EvidenceModel, found: Registration
    ) -> Registration | None:
        """Look now and then whether a frame shows another part of the model, if the present one is not the first."""
        self._since_check += 1
        if not self._part or self._since_check < RETURN_FRAMES:
            return None
        self._since_check, last = 0, self._last
        elsewhere = self._found_again(views, mask, model, apart_from=found.T_camera_object)
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
        self,
        views: FrameViews,
        mask: NDArray[np.bool_],
        model: EvidenceModel,
        apart_from: Pose | None = None,
    ) -> Registration | None:
        """Return the best registration from poses that keyframes speak for, if it can be trusted.

        With a pose to be `apart_from`, only those in other parts of the model count.
        """
        if self._keyframes is None:
            return None
        self._last = None
        seen, form = _seen(views, mask), views.form(mask)
        poses = [sight.T_camera_object for sight in self._keyframes.find(views.frame, mask)]
        if apart_from is not None:
            here = self._part_of(apart_from)
            poses = [pose for pose in poses if self._part_of(pose) != here]
        tries = [register(*seen, self._view(form, model, pose), pose, **self._options) for pose in poses]
        trusted = [found for found in tries if found.status is Status.TRACKED]
        return max(trusted, key=lambda found: found.agreement, default=None)

    def _note(self, views: FrameViews, mask: NDArray[np.bool_]) -> None:
        if self._keyframes is not None:
            self._keyframes.note(views.frame, mask, self._poses[-1])

    def resume(self, T_camera_object: Pose) -> None:
        """Go on from a pose: the object was out of sight, or was found by other means."""
        self._poses, self._resting, self._last = [T_camera_object], False, None

    def _remember(self, views: FrameViews, mask: NDArray[np.bool_]) -> None:
        form = views.form(mask)
        depth = np.where(form.thin(mask), form.thin(views.frame.depth), np.float32(0))
        self._last = (form.stride, depth, views.luma(form))

    def _view(self, form: Thinned, model: EvidenceModel, pose: Pose) -> ModelView:
        """Cast the model, and give a view from the last pose the luma of the last frame on the same surface."""
        view = cast_view(model, form, pose, self._options["threads"])
        if self._last is None or self._last[0] != form.stride:
            return view
        _, depth, luma = self._last
        same = (view.depth > 0) & (np.abs(depth - view.depth) < SAME_SURFACE * view.depth)
        return replace(view, intensity=np.where(same, luma, np.float32(np.nan)))


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


def _seen(views: FrameViews, mask: NDArray[np.bool_]) -> _Seen:
    """Return what registration takes of a frame."""
    form = views.form(mask)
    return form.thin(views.frame.depth), views.luma(form), form.thin(mask), form.camera


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
    seen = _seen(views, mask)
    view = cast_view(model, views.form(mask), at.T_camera_object, threads, exact=True)
    options = _Options(sigma_m=sensor.sigma_m, threads=threads, config=config or RegistrationConfig())
    found = register(*seen, view, at.T_camera_object, **options)
    if found.status is not Status.TRACKED:
        return at
    if rests(*seen, view, at.T_camera_object, found, resting=True, **options):
        return at
    return replace(at, T_camera_object=found.T_camera_object)


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


def refound(
    at: Located,
    T_guess: Pose,
    views: FrameViews,
    mask: NDArray[np.bool_],
    model: EvidenceModel,
    sensor: SensorModel,
    threads: int,
) -> Located:
    """Look for a lost object near a guess in the finished model; it stays lost, at the guess, if it is not there."""
    view = cast_view(model, views.form(mask), T_guess, threads, exact=True)
    options = _Options(sigma_m=sensor.sigma_m, threads=threads, config=RegistrationConfig())
    found = register_from_starts(*_seen(views, mask), view, T_guess, **options)
    if found.status is not Status.TRACKED:
        return replace(at, T_camera_object=T_guess)
    return replace(at, T_camera_object=found.T_camera_object, status=Status.RELOCALISED)
