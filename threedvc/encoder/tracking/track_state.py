# SPDX-License-Identifier: MIT
"""What a tracker knows of its object: its last poses, how it looked last, its keyframes, its submaps."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from threedvc.arrays import Floats
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.registration.frame_resolutions import ObjectView
from threedvc.encoder.registration.initial_poses import predict
from threedvc.encoder.registration.model_view import raycast_model
from threedvc.encoder.registration.registration_types import ModelView
from threedvc.encoder.tracking.pose_track import SubmapLink
from threedvc.encoder.tracking.relocalization import Keyframes
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import Pose, interpolated, inverse, make_pose, orthonormalized
from threedvc.units import NANOSECONDS

__all__ = ["RECENT_NS", "SUBMAP_SPACING_CELLS", "Submaps", "TrackState"]

SUBMAP_SPACING_CELLS = 4096
"""Submaps lie so far apart: many times as far as cameras see, for cells are some pixels wide."""
CHECK_FRAMES = 10
"""In a new submap, every so many frames are held against the others (decision 0017)."""
MAX_UNEVENNESS = 0.2
"""Steps of time that differ by more than this part are taken into account when a pose is predicted; less is jitter of
the clock."""
MAX_STEPS_AHEAD = 3.0
"""A motion is extrapolated over no more of its steps: after a longer gap it is not the same motion any more."""
RECENT_NS = NANOSECONDS // 5
"""In a fifth of a second motion hardly changes: so long what one sensor has found holds for the others, too."""
MAX_SURFACE_DIFFERENCE = 0.03
"""Part of its depth by which what a frame measured may differ from the model, to lend its luma to that surface."""
USUAL_MEMORY = 0.9
"""Weight of the frames before in the usual agreement: a mean over about ten."""


class LastView(NamedTuple):
    """How an object looked last to a sensor: stride of the resolution, depth and luma (h, w), pose before the rig."""

    stride: int
    depth: Floats
    luma: Floats
    T_rig_object: Pose


class Submaps:
    """Parts of one model, in one frame but far apart: each begins where the object was lost for long.

    Attributes
    ----------
    current
        Number of the one that the object is followed in; 0 is the first.
    links
        By submap, how it lies to the one that was recognized from it.
    """

    def __init__(self) -> None:
        self.current = 0
        self.links: dict[int, SubmapLink] = {}
        self._count, self._spacing_m, self._frames_since_check = 1, 1.0, 0

    def begin(self, voxel_size_m: float) -> Pose:
        """Go on in a new submap, above the others as the first camera saw them; return the motion to it."""
        self._spacing_m = SUBMAP_SPACING_CELLS * voxel_size_m
        up = np.array([0.0, (self._count - self.current) * self._spacing_m, 0.0])
        self.current, self._count, self._frames_since_check = self._count, self._count + 1, 0
        return make_pose(np.eye(3), up)

    def containing(self, T_camera_object: Pose) -> int:
        """Return the submap in which a pose places the camera."""
        height = -float(inverse(T_camera_object)[1, 3])
        return min(max(round(height / self._spacing_m), 0), self._count - 1)

    def check_is_due(self) -> bool:
        """Count a frame; tell whether it is to be held against the other submaps."""
        self._frames_since_check += 1
        if not self.current or self._frames_since_check < CHECK_FRAMES:
            return False
        self._frames_since_check = 0
        return True

    def link(self, T_here: Pose, T_there: Pose) -> None:
        """Keep that a frame shows the same at a pose in the current submap and at one in another."""
        self.links[self.current] = inverse(T_here) @ T_there, self.containing(T_there)


class TrackState:
    """What is known of a tracked object so far, from `begin` on. Poses are those before the rig.

    Attributes
    ----------
    keyframes
        To find the object again by; None: it is not looked for.
    submaps
        Parts of its model.
    stationary
        Whether it rested in the last frame.
    velocity_share
        Part of its velocity with which it is thought to go on.
    lost_frames
        Number of frames since it was found.
    usual_agreement
        What registrations agree by as a rule; 0: there was none yet.
    """

    def __init__(self) -> None:
        self.keyframes: Keyframes | None = None
        self.submaps = Submaps()
        self.stationary = False
        self.velocity_share = 1.0
        self.lost_frames = 0
        self.usual_agreement = 0.0
        self._poses: list[Pose] = []
        self._times: list[int] = []
        self._last_views: dict[int, LastView] = {}
        self._found_ns: dict[int, int] = {}
        self._recent: list[tuple[int, Pose]] = []
        self._background_moved = False

    def begin(self, pose: Pose, seen: ObjectView, keyframes: Keyframes | None) -> None:
        """Take over where a frame first shows the object, and how."""
        self.keyframes = keyframes
        self.jump_to(pose, seen.frame)
        self.remember_view(seen)
        self.note_found(seen.frame, pose)

    @property
    def pose(self) -> Pose:
        """The last pose."""
        return self._poses[-1]

    @property
    def moves(self) -> bool:
        """Whether two poses tell how it moves."""
        return len(self._poses) > 1

    def predicted(self, timestamp_ns: int) -> Pose:
        """Return the pose at a time at constant velocity, or at a share of it where not all of it was determined."""
        if not self.moves:
            return self.pose
        ahead, step = timestamp_ns - self._times[-1], self._times[-1] - self._times[0]
        steps = min(ahead / step, MAX_STEPS_AHEAD) if ahead > 0 and step > 0 else 1.0
        following = predict(*self._poses)
        if abs(steps - 1) <= MAX_UNEVENNESS and self.velocity_share == 1:
            return following
        return orthonormalized(interpolated(self.pose, following, steps * self.velocity_share))

    def go_to(self, pose: Pose, frame: Frame) -> None:
        """Take over the pose in a frame, to which the object moved from the one before."""
        self._set_poses([self.pose, pose], frame)

    def jump_to(self, pose: Pose, frame: Frame) -> None:
        """Take over the pose in a frame, which tells nothing of how the object moves."""
        self._set_poses([pose], frame)

    def _set_poses(self, poses: list[Pose], frame: Frame) -> None:
        self._poses = poses
        self._times = [*self._times, frame.timestamp_ns][-len(poses) :]

    def resume(self, T_camera_object: Pose) -> None:
        """Go on from a pose: the object was out of sight, or was found by other means."""
        self._poses, self._times = [T_camera_object], self._times[-1:]
        self.interrupt()

    def interrupt(self) -> None:
        """Forget that the object rested, and how it looked."""
        self.stationary = False
        self.forget_views()

    def move_with_background(self, motion: Pose) -> None:
        """Take the object along as the background moved before the rig: it is thought to stay, or to go on, there."""
        self._background_moved = True
        self._poses = [motion @ pose for pose in self._poses]
        self._recent = [(time, motion @ pose) for time, pose in self._recent]

    def take_background_motion(self) -> bool:
        """Tell whether the object was taken along with the background since this was last asked."""
        moved, self._background_moved = self._background_moved, False
        return moved

    def note_agreement(self, agreement: float) -> None:
        """Take the agreement of a registration into the usual one."""
        change = (1 - USUAL_MEMORY) * (agreement - self.usual_agreement)
        self.usual_agreement += change if self.usual_agreement else agreement

    def note_found(self, frame: Frame, pose: Pose) -> None:
        """Keep when a sensor found the object, and its poses in the last moments."""
        self._found_ns[frame.sensor] = frame.timestamp_ns
        self._recent = [(time, at) for time, at in self._recent if frame.timestamp_ns - time <= RECENT_NS]
        self._recent.append((frame.timestamp_ns, pose))

    def found_by_others(self, frame: Frame) -> bool:
        """Tell whether the object was found a moment ago by another sensor, so that its pose is known anyway."""
        times = (time for sensor, time in self._found_ns.items() if sensor != frame.sensor)
        return not self.lost_frames and any(0 <= frame.timestamp_ns - time <= RECENT_NS for time in times)

    def extrapolated(self, timestamp_ns: int) -> Pose:
        """Return where the object goes on to as it went in the last moments."""
        (start, first), (end, last) = self._recent[0], self._recent[-1]
        return last if end == start else interpolated(first, last, 1 + (timestamp_ns - end) / (end - start))

    def remember_view(self, seen: ObjectView, pose: Pose | None = None) -> None:
        """Keep how the object looks to a sensor at a pose, by default the present one."""
        resolution, at = seen.resolution, self.pose if pose is None else pose
        last = LastView(resolution.stride, seen.object_depth, seen.views.luma(resolution), at)
        self._last_views[seen.frame.sensor] = last

    def forget_views(self) -> None:
        """Forget how the object looked: it may have been something else."""
        self._last_views = {}

    def add_keyframe(self, seen: ObjectView) -> None:
        """Keep how the object looks at the present pose, to find it again by."""
        if self.keyframes is not None:
            self.keyframes.add(seen.frame, seen.mask, self.pose)

    def model_view(self, seen: ObjectView, model: EvidenceModel, threads: int) -> ModelView:
        """Cast the model from where a sensor saw the object last, with the luma of that frame on the same surface.

        What the sensor has not seen of late is cast from the last pose, with the luma of the model.
        """
        resolution, last = seen.resolution, self._last_views.get(seen.frame.sensor)
        if last is None or last.stride != resolution.stride:
            return raycast_model(model, resolution, seen.rig.at_sensor(self.pose), threads)
        view = raycast_model(model, resolution, seen.rig.at_sensor(last.T_rig_object), threads)
        same = (view.depth > 0) & (np.abs(last.depth - view.depth) < MAX_SURFACE_DIFFERENCE * view.depth)
        return replace(view, intensity=np.where(same, last.luma, np.float32(np.nan)))
