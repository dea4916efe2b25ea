# SPDX-License-Identifier: MIT
"""Where objects are placed in the frames of one moment: one rule for each kind of object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from threedvc.encoder.reconstruction.scene_object import SceneObject
from threedvc.encoder.registration.frame_resolutions import ObjectView
from threedvc.encoder.segmentation.motion.moving_body import MAX_LOST_FRAMES
from threedvc.encoder.segmentation.sequence_labels import SequenceLabels
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.encoder.tracking.track_state import SUBMAP_SPACING_CELLS
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, inverse, make_pose
from threedvc.stream.pose_status import PoseStatus

__all__ = ["ObjectPlacement"]

AWAY_M = 1000.0
"""Where an object is put that left: so far behind the camera that nobody will see it."""
AWAY = make_pose(np.eye(3), np.array([0.0, 0.0, -AWAY_M]))
"""That place, as a pose before the camera."""


class ObjectPlacement:
    """Places the objects of a scene.

    Parameters
    ----------
    objects
        Those of the scene; it grows as they appear.
    rigs
        Cameras of the sensors.
    labels
        Labels of the frames where these are divided by motion, or None.
    alone
        Whether one object was cut out by its depth.
    """

    def __init__(
        self,
        objects: Mapping[int, SceneObject],
        rigs: Sequence[CameraRig],
        labels: SequenceLabels | None,
        *,
        alone: bool,
    ) -> None:
        self._objects, self._rigs, self._labels, self._alone = objects, rigs, labels, alone

    def place(self, item: SceneObject, views: Sequence[ObjectView]) -> TrackedPose | None:
        """Find an object in the frames of a moment.

        It is looked for where it went on in the background, not before the camera.
        """
        motion = self._background_motion(views[0].views.frame.index) if item.number and item.born is not None else None
        if motion is not None and item.tracker is not None:
            item.tracker.apply_background_motion(motion)
        if self._labels is None or not item.number or (item.born is None and not item.passing):
            return self._labeled(item, views, motion)
        if item.passing:
            return self._transient(self._labels, item, views[0].views.frame)
        return self._found_by_motion(self._labels, item, views)

    def away_before(self, frame: int) -> list[Pose]:
        """Return the poses, in all frames before one, of a place far behind the first camera."""
        world = self._objects[0].poses[:frame]
        return [T_camera_world @ inverse(world[0]) @ AWAY for T_camera_world in world]

    def _labeled(self, item: SceneObject, views: Sequence[ObjectView], motion: Pose | None) -> TrackedPose | None:
        """Place the background, or an object that labels show: where it is found, else where it rested."""
        at = item.locate(views, self._rigs, self._alone)
        if at is not None or motion is None:
            return at
        return TrackedPose(T_camera_object=motion @ item.poses[-1], status=PoseStatus.UNSEEN)

    def _found_by_motion(self, labels: SequenceLabels, item: SceneObject, views: Sequence[ObjectView]) -> TrackedPose:
        """Place an object found by its motion: out of sight it stays in the background where it was, or is gone."""
        frame = views[0].views.frame
        at = self._registered_again(labels, item, views) if labels.is_seen(item.number, frame) else None
        gone = labels.is_gone(item.number, frame)
        if at is not None and not at.usable and frame.index - item.last_seen > MAX_LOST_FRAMES:
            at, gone = None, True  # better nothing than what may be elsewhere, or something else
        if at is not None:
            return at
        T_camera_object = self._at_rest_in_background(item)
        if gone and np.linalg.norm(T_camera_object[:3, 3]) < AWAY_M / 2:
            T_camera_object = make_pose(T_camera_object[:3, :3], np.array([0.0, 0.0, -AWAY_M]))
        return TrackedPose(T_camera_object=T_camera_object, status=PoseStatus.UNSEEN)

    def _registered_again(
        self, labels: SequenceLabels, item: SceneObject, views: Sequence[ObjectView]
    ) -> TrackedPose | None:
        """Register an object, from where its labels say that it went if it was out of sight."""
        if item.out_of_sight and item.tracker is not None:
            motion = labels.displacement(item.number, item.last_seen, views[0].views.frame.index)
            last = item.poses[item.last_seen]
            item.tracker.resume(last if motion is None else motion @ last)
        return item.locate(views, self._rigs, self._alone)

    def _at_rest_in_background(self, item: SceneObject) -> Pose:
        last, world = item.poses[-1], self._objects[0].poses
        return last if np.array_equal(world[-1], world[-2]) else world[-1] @ inverse(world[-2]) @ last

    def _transient(self, labels: SequenceLabels, item: SceneObject, frame: Frame) -> TrackedPose:
        """Place what is there for a moment, apart from what had its number before; away where there is nothing."""
        at = labels.transient(item.number, frame)
        if at is None:
            away = self.away_before(frame.index + 1)[-1] if self._objects[0].poses else AWAY
            return TrackedPose(T_camera_object=away, status=PoseStatus.UNSEEN)
        apart = np.array([0.0, -at.segment * SUBMAP_SPACING_CELLS * item.evidence.voxel_size_m, 0.0])
        return TrackedPose(T_camera_object=at.T_camera_object @ make_pose(np.eye(3), apart), status=PoseStatus.TRACKED)

    def _background_motion(self, frame: int) -> Pose | None:
        """Return how the background moved before the rig since the moment before a frame; None if it did not."""
        background = self._objects.get(0)
        if background is None or background.born is None or not 0 < frame < len(background.poses):
            return None
        before, now = background.poses[frame - 1], background.poses[frame]
        return None if np.array_equal(before, now) else now @ inverse(before)
