# SPDX-License-Identifier: MIT
"""One object of a scene: its evidence, its entropy, and where it was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.model_entropy import EntropyMeter
from threedvc.encoder.registration.frame_resolutions import ObjectView
from threedvc.encoder.tracking.given_poses import known_pose
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.encoder.tracking.tracker import Tracker
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, identity
from threedvc.stream.pose_status import PoseStatus

__all__ = ["MIN_PIXELS", "SceneObject"]

MIN_PIXELS = 30
"""With depth, fewer of which neither start an object nor locate it: half of what a registration asks for
(`RegistrationConfig.min_samples`)."""
VISIBLE_FRAMES = 5
"""Frames for which a block counts as in sight after it was last seen: about a sixth of a second, in which it may come
back."""


class SceneObject:
    """One object in the encoder.

    Attributes
    ----------
    number
        Its number; 0 is the background.
    evidence
        Its model.
    found
        Where it was found in every frame so far; None where it was not.
    poses
        T_camera_object before the rig in every frame so far: an unseen object keeps its last pose, at first its
        first one.
    born
        First frame in which it was found.
    sized_by
        Number of pixels of the frame that its cells were chosen by.
    passing
        Whether it stands for things that are there for a moment.
    """

    def __init__(
        self,
        number: int,
        voxel_size_m: float,
        tracker: Tracker | None,
        *,
        passing: bool = False,
        given_camera: bool = False,
    ) -> None:
        self.number, self.passing = number, passing
        self._given_camera = given_camera
        self.evidence = EvidenceModel(voxel_size_m)
        self.tracker = tracker
        self.entropy = EntropyMeter(self.evidence)
        self.found: list[TrackedPose | None] = []
        self.poses: list[Pose] = []
        self.born: int | None = None
        self.sized_by = 0
        self._stayed = 0, True
        self._last_visible = np.zeros(0, dtype=np.int64)

    def begin_anew(self, voxel_size_m: float, pixels: int) -> None:
        """Take other cells, chosen by a frame that shows `pixels` of the object, and forget what the old ones held."""
        self.evidence = EvidenceModel(voxel_size_m)
        self.entropy = EntropyMeter(self.evidence)
        self._last_visible = np.zeros(0, dtype=np.int64)
        self.sized_by = pixels

    def locate(self, seen: Sequence[ObjectView], rigs: Sequence[CameraRig], alone: bool) -> TrackedPose | None:
        """Find the object in the frames of a moment; None where it is not seen and its pose is not known."""
        if self.tracker is None:
            known = ((views.rig, known_pose(self.number, views.frame, alone)) for views, _ in seen)
            pose = next((rig.at_rig(pose) for rig, pose in known if pose is not None), None)
            return None if pose is None else TrackedPose(T_camera_object=pose, status=PoseStatus.KNOWN)
        seeing = [each for each in seen if np.count_nonzero(each.mask & (each.views.frame.depth > 0)) >= MIN_PIXELS]
        if not seeing:
            views = seen[0].views
            blind = self.number == 0 and self.born is not None and not views.frame.depth.any()
            return self.tracker.locate_by_picture(views) if blind else None
        if self.born is None:
            return self.tracker.start(seeing[0], self.number, *rigs)
        return self.tracker.locate(seeing, self.evidence)

    def note_visible(self, numbers: NDArray[np.int64], frame: int) -> None:
        """Note that blocks `numbers` (n,) of the evidence were in the field of view of a frame."""
        more = self.evidence.index.count - len(self._last_visible)
        self._last_visible = np.concatenate([self._last_visible, np.full(more, frame)])
        self._last_visible[numbers] = frame

    @property
    def in_sight(self) -> NDArray[np.bool_]:
        """Which blocks (n,) of the evidence were in the field of view in the last few frames."""
        return np.asarray(self._last_visible > self._last_visible.max(initial=0) - VISIBLE_FRAMES)

    @property
    def stayed(self) -> bool:
        """Whether it was found at one place only."""
        if self._stayed[0] != len(self.found):
            usable = [at.T_camera_object for at in self.found if at is not None and at.usable]
            self._stayed = len(self.found), all(np.array_equal(pose, usable[0]) for pose in usable)
        return self._stayed[1]

    def is_given(self, at: TrackedPose) -> bool:
        """Tell whether a pose is to be taken as it is.

        Poses of a hand-held camera are worth refining. Those of labeled objects are not: given ones are made
        on purpose, tracked ones would follow the shades of the model's colors. A background without camera
        poses stands still, and so does one that was tracked and never moved.
        """
        if self.number > 0 or (at.status is PoseStatus.KNOWN and not self._given_camera):
            return True
        return at.status is not PoseStatus.KNOWN and self.stayed

    @property
    def may_move(self) -> bool:
        """Whether its poses are worth refining in some frame."""
        return any(at is not None and at.usable and not self.is_given(at) for at in self.found)

    @property
    def at_rest(self) -> bool:
        """Whether it never moves before the camera, and is not going to be moved."""
        return not self.may_move and all(np.array_equal(pose, self.poses[0]) for pose in self.poses)

    @property
    def last_seen(self) -> int:
        """The last frame in which it was found."""
        return max(frame for frame, at in enumerate(self.found) if at is not None and at.usable)

    @property
    def out_of_sight(self) -> bool:
        """Whether it was not in sight in the last frame."""
        return bool(self.found) and self.found[-1] is not None and self.found[-1].status is PoseStatus.UNSEEN

    def record(self, frame: int, at: TrackedPose | None) -> None:
        """Keep where the object was found in a frame; frames before it appeared count as not found."""
        if at is not None and self.born is None:
            self.born = frame
            self.poses = [at.T_camera_object] * frame
        last = self.poses[-1] if self.poses else identity()
        self.poses += [last] * (frame - len(self.poses))
        self.poses.append(last if at is None else at.T_camera_object)
        self.found += [None] * (frame - len(self.found))
        self.found.append(at)
