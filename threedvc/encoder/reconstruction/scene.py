# SPDX-License-Identifier: MIT
"""The encoder's view of a sequence: its objects, their evidence, and where they are in every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Mask
from threedvc.config import EncoderConfig, Motion, SegmentationMode
from threedvc.encoder.fusion.integration import fuse
from threedvc.encoder.reconstruction.cell_size import CellSizes
from threedvc.encoder.reconstruction.frame_intake import FrameIntake, FrameRecord, PreparedFrame
from threedvc.encoder.reconstruction.label_prediction import predicted_labels
from threedvc.encoder.reconstruction.object_placement import ObjectPlacement
from threedvc.encoder.reconstruction.pose_freedom import hardly_moves
from threedvc.encoder.reconstruction.scene_object import MIN_PIXELS, SceneObject
from threedvc.encoder.registration.frame_resolutions import FrameResolutions, ObjectView
from threedvc.encoder.registration.initial_poses import predict
from threedvc.encoder.segmentation.masks import resolved_mode, segment
from threedvc.encoder.segmentation.motion.transient_numbers import TRANSIENT_NUMBERS
from threedvc.encoder.segmentation.sequence_labels import VOID_LABEL, SequenceLabels
from threedvc.encoder.tracking.given_poses import motion_of
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.encoder.tracking.tracker import Tracker
from threedvc.errors import ConfigError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.pose import Pose
from threedvc.stream.pose_status import PoseStatus

__all__ = ["Scene"]

DOUBTED_LUMA = 0.1
"""Weight of luma against depth as long as nothing confirms that both cameras are registered as the input says: a color
camera with another focal length shows other motions (decisions 0017, 0040)."""
MIN_PATIENCE = 5
"""Frames, if a second has fewer, for which an object may be lost before a new part of its model begins."""


class Scene:
    """All objects; grows by the frames of one moment at a time.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.
    poses
        Where every object is in every frame, from an earlier pass; None: find out.
    sequence_labels
        Labels of the frames where these are divided by motion; None: find them as the frames come.
    luma_weight
        Weight of luma against depth where the background is tracked; of objects that are refined, no more than 1.
    in_color
        Whether colors are fused and entropy is counted; without, surfaces are gray, and a quarter of the time is saved.

    Attributes
    ----------
    objects
        By number; 0 is the background.

    Raises
    ------
    ConfigError
        If frames of several sensors are to be divided by motion.
    """

    def __init__(
        self,
        info: SequenceInfo,
        config: EncoderConfig,
        poses: Mapping[int, Sequence[TrackedPose | None]] | None = None,
        sequence_labels: SequenceLabels | None = None,
        *,
        luma_weight: float = DOUBTED_LUMA,
        in_color: bool = True,
    ) -> None:
        self.info, self.config = info, config
        self._in_color = in_color
        self._poses = poses
        self._luma_weight = luma_weight
        by_motion = config.segmentation.mode is SegmentationMode.MOTION
        if by_motion and info.sensors:
            raise ConfigError(
                "--segment motion divides the frames of one sensor; give masks or --segment depth:NEAR..FAR, or encode "
                "the sensors apart"
            )
        self.sequence_labels = (
            SequenceLabels(info, config) if sequence_labels is None and by_motion else sequence_labels
        )
        self.objects: dict[int, SceneObject] = {}
        self._intake = FrameIntake(info, config)
        self._cells = CellSizes(info, config)
        self._placement = ObjectPlacement(self.objects, info.rigs, self.sequence_labels, alone=self._one_object)

    @property
    def records(self) -> list[FrameRecord]:
        """What is kept of each frame so far."""
        return self._intake.records

    @property
    def distance_m(self) -> float:
        """Median depth of the first frame that has enough of it, or any."""
        return self._intake.distance_m

    @property
    def entropy_bits(self) -> float:
        """Entropy of all models."""
        return sum(item.entropy.bits for item in self.objects.values())

    def with_config(self, config: EncoderConfig) -> Scene:
        """Return the same scene, its objects shared, under other choices for what is still to come."""
        scene = copy(self)
        scene.config = config
        return scene

    def add(self, *frames: Frame) -> PoseStatus:
        """Take in the frames of one moment: segment, locate, fuse. Return the worst status of their objects.

        Raises
        ------
        SequenceError
            If a frame does not fit the sequence.
        """
        prepared = [self._prepared(frame) for frame in frames]
        worst = PoseStatus.KNOWN
        for number in self._numbers_in(prepared):
            views = [ObjectView(each.views, each.labels == number) for each in prepared]
            item = self._object(number, views)
            if item is None:
                continue
            at = self._placed(item, views)
            if at is not None and at.status is not PoseStatus.UNSEEN:
                worst = max(worst, at.status, key=lambda status: status.doubt)
            for each, view in zip(prepared, views, strict=True):
                self._record(item, each.seen.frame, at)
                if at is not None and at.usable and not self.records[each.seen.frame].repeated:
                    self._fuse(item, each, view.mask, view.views.rig.at_sensor(at.T_camera_object))
        return worst

    def _prepared(self, frame: Frame) -> PreparedFrame:
        """Check a frame, and take in what does not depend on where objects are."""
        frame = self._intake.take(frame)
        labels = self.labels(frame)
        if self._intake.settled:
            self._cells.observe(frame, labels)
        return self._intake.prepared(frame, labels)

    def _numbers_in(self, frames: Sequence[PreparedFrame]) -> list[int]:
        """Return the objects there are so far or in these frames, the background first."""
        numbers = {0, *self.objects}.union(*(np.unique(frame.labels).tolist() for frame in frames))
        return sorted(numbers - {VOID_LABEL} if self.sequence_labels else numbers)

    def _placed(self, item: SceneObject, views: Sequence[ObjectView]) -> TrackedPose | None:
        if self._poses is not None:
            return self._poses[item.number][views[0].views.frame.index]
        return self._placement.place(item, views)

    def _record(self, item: SceneObject, frame: int, at: TrackedPose | None) -> None:
        item.record(frame, at)
        if self.sequence_labels is not None and item.number and item.born == frame:
            # Before, it was not there, or was taken for the background.
            item.poses[:-1] = self._placement.away_before(frame)

    def _fuse(self, item: SceneObject, frame: PreparedFrame, mask: Mask, T_camera_object: Pose) -> None:
        if item.number == 0 and self.config.causal:
            self._intake.meter_noise(frame, item.evidence, mask, T_camera_object)
            self._intake.take_out_gain(frame, item.evidence, mask, T_camera_object)
        sensor, threads = self.sensor_of(frame.views.frame.sensor), self.config.threads
        numbers = fuse(
            item.evidence,
            frame.seen,
            mask,
            T_camera_object,
            sensor,
            self.config.fusion,
            threads,
            in_color=self._in_color,
        )
        if self._in_color:
            item.entropy.update(numbers, threads)
        item.note_visible(numbers, frame.seen.frame)

    def frame_before(self, frame: int) -> int | None:
        """Return the frame before one of the frames so far that the same sensor took; None for its first."""
        return self._intake.frame_before(frame)

    def labels(self, frame: Frame) -> NDArray[np.uint8]:
        """Return the objects' numbers (h, w) at the pixels of a frame's depth picture."""
        if self.sequence_labels is not None:
            return self.sequence_labels.labels(frame)
        by_masks = resolved_mode(self.config.segmentation, self.info) is SegmentationMode.MASKS
        if by_masks and frame.mask is None and self.objects:
            return self._predicted_labels(frame)
        return segment(frame, self.config.segmentation, self.info)

    def _predicted_labels(self, frame: Frame) -> NDArray[np.uint8]:
        """Label a frame that has no mask by what the models show at the poses that are known or come next."""
        items = [item for item in self.objects.values() if item.number and item.born is not None]
        models = ((item.number, item.evidence, self._expected(item, frame.index)) for item in items)
        resolution, sensor = self._intake.full[frame.sensor], self.sensor_of(frame.sensor)
        return predicted_labels(frame.depth, resolution, sensor, models, self.config.threads)

    def _expected(self, item: SceneObject, frame: int) -> Pose:
        """Return the pose of an object in a frame as far as it is known, else at constant velocity."""
        if frame < len(item.poses):
            return item.poses[frame]
        found = self._poses[item.number][frame] if self._poses is not None else None
        if found is not None:
            return found.T_camera_object
        return predict(*item.poses[-2:]) if len(item.poses) > 1 else item.poses[-1]

    def sensor_of(self, number: int) -> SensorModel:
        """Return the noise of a sensor's depth: the one asked for, or guessed from its first frame."""
        return self._intake.sensor_of(number)

    def views(self, frame: Frame) -> FrameResolutions:
        """Return the resolutions of a frame for registration."""
        return self._intake.views(frame)

    def with_depth_limit(self, frame: Frame) -> Frame:
        """Return a frame without what is no number, and without measurements beyond the largest depth."""
        return self._intake.with_depth_limit(frame)

    def hardly_moves(self, number: int) -> bool:
        """Tell whether all poses at which an object was tracked lie within half a pixel of the first one."""
        item = self.objects[number]
        return item.tracker is not None and hardly_moves(item.found, self.info.rigs, self.distance_m)

    @property
    def _one_object(self) -> bool:
        return self.config.segmentation.mode is SegmentationMode.DEPTH

    def _object(self, number: int, views: Sequence[ObjectView]) -> SceneObject | None:
        """Return an object, new where enough pixels of a frame show it for the first time."""
        shown = [int(np.count_nonzero(view.mask & (view.views.frame.depth > 0))) for view in views]
        best = views[int(np.argmax(shown))]
        tracked = not self._stands_still(number) and self._is_tracked(number)
        if number in self.objects:
            item = self.objects[number]
            if not number and self._cells.outgrown(item, max(shown), best.views.frame):
                item.begin_anew(self._cells.size_for(number, *best, tracked=tracked), max(shown))
            return item
        if number and max(shown) < MIN_PIXELS:
            return None
        transient = self.sequence_labels is not None and number in TRANSIENT_NUMBERS
        item = SceneObject(
            number,
            self._cells.size_for(number, *best, tracked=tracked, transient=transient),
            self._new_tracker(number, best.views.frame.sensor) if tracked and not transient else None,
            passing=transient,
            given_camera=self.info.has_camera_poses,
        )
        item.sized_by = max(shown)
        self.objects[number] = item
        return item

    def _new_tracker(self, number: int, sensor: int) -> Tracker:
        return Tracker(
            self.sensor_of(sensor),
            self.config.threads,
            sensor_of=self.sensor_of,
            lit_evenly=number == 0,
            luma_weight=self._luma_weight_of(number),
            patience=max(MIN_PATIENCE, round(self.info.fps)),
        )

    def _luma_weight_of(self, number: int) -> float:
        """Return the weight of luma for an object: the full one, unless all is going to be tracked again."""
        if number == 0:
            return self._luma_weight
        return min(self._luma_weight, 1.0) if self.config.refine else 1.0

    def _is_tracked(self, number: int) -> bool:
        """Objects found by their motion bear no relation to the poses that the input may have."""
        by_motion = number > 0 and self.sequence_labels is not None
        return by_motion or motion_of(number, self.info, self.config.motion) is Motion.TRACK

    def _stands_still(self, number: int) -> bool:
        """The background stands still before a camera that does, unless the camera's poses are known.

        That of a depth threshold does by definition.
        """
        by_motion = self.sequence_labels is not None and self.sequence_labels.camera_rests
        rests = self._one_object or self.info.camera_rests or by_motion
        return number == 0 and rests and not self.info.has_camera_poses
