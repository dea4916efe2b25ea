# SPDX-License-Identifier: MIT
"""The encoder's view of a sequence: its objects, their evidence, and where they are in every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from threedvc.camera import CameraRig
from threedvc.coding.gains import NEUTRAL
from threedvc.config import MIN_VOXEL_SIZE_M, EncoderConfig, Motion, SegmentationMode, Sensor
from threedvc.division import NOTHING, Division
from threedvc.evidence_view import FrameViews, Thinned, cast_view
from threedvc.exposure import camera_gain, with_gain
from threedvc.frame import Frame, SequenceInfo, check_frame
from threedvc.fusion import Observation, fuse, observe
from threedvc.motion import UNSEEN, Located, Tracker, known_pose, motion_of
from threedvc.object_model import EvidenceModel
from threedvc.pose import Pose, identity, inverse, make_pose
from threedvc.rate_control import live_cell_factor
from threedvc.registration_starts import predict
from threedvc.segmentation import resolved_mode, segment
from threedvc.sensor_model import SENSORS, SensorModel, chosen_sensor, within
from threedvc.uncertainty import EntropyMeter

__all__ = ["Scene", "SceneObject", "default_voxel_size"]

MIN_PIXELS = 30
MAX_DEPTH_M = 1e4
PIXELS_PER_CELL = 4.0
MIN_PIXELS_PER_CELL = 1.3
BACKDROP_CELLS = 1.1
"""A background at rest before a camera at rest is coloured by a picture: its cells may be a little wider."""
REFERENCE_PIXELS = 640 * 480
SIGHT_FRAMES = 5
MIN_PATIENCE = 5
"""Frames, if a second has fewer, for which an object may be lost before a new part of its model begins."""
PREDICTION_GATE = 0.03
AWAY_M = 1000.0
"""Where an object is put that left: so far behind the camera that nobody will see it."""
STATUS_ORDER = ("known", "tracked", "relocalised", "weak", "lost")


def default_voxel_size(depth: NDArray[np.float32], mask: NDArray[np.bool_], info: SequenceInfo) -> float:
    """Choose a cell that covers about 4 pixels of a 640x480 picture at the depth that 3/4 of an object do not exceed.

    Small pictures get finer cells against their pixels; the size is rounded to a millimetre.
    """
    seen = depth[mask & (depth > 0)]
    distance = float(np.percentile(seen, 75)) if len(seen) else 1.0
    pixels = max(PIXELS_PER_CELL * float(np.sqrt(depth.size / REFERENCE_PIXELS)), MIN_PIXELS_PER_CELL)
    return max(round(pixels * distance / info.rig.depth.fx, 3), 0.001)


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
        T_camera_object of every frame so far: an unseen object keeps its last pose, at first its first one.
    born
        First frame in which it was found.
    """

    def __init__(self, number: int, voxel_size_m: float, tracker: Tracker | None) -> None:
        self.number = number
        self.evidence = EvidenceModel(voxel_size_m)
        self.tracker = tracker
        self.entropy = EntropyMeter(self.evidence)
        self.found: list[Located | None] = []
        self.poses: list[Pose] = []
        self.born: int | None = None
        self._last_sight = np.zeros(0, dtype=np.int64)

    def locate(self, views: FrameViews, mask: NDArray[np.bool_], rig: CameraRig, alone: bool) -> Located | None:
        """Find the object in a frame; None where it is not seen and its pose is not known."""
        if self.tracker is None:
            pose = known_pose(self.number, views.frame, alone)
            return None if pose is None else Located(T_camera_object=pose, status="known")
        if np.count_nonzero(mask & (views.frame.depth > 0)) < MIN_PIXELS:
            blind = self.number == 0 and self.born is not None and not views.frame.depth.any()
            return self.tracker.locate_by_picture(views) if blind else None
        if self.born is None:
            return self.tracker.start(views, mask, self.number, rig)
        return self.tracker.locate(views, mask, self.evidence)

    def note_sight(self, numbers: NDArray[np.int64], frame: int) -> None:
        """Note that blocks `numbers` (n,) of the evidence were in the field of view of a frame."""
        more = self.evidence.index.count - len(self._last_sight)
        self._last_sight = np.concatenate([self._last_sight, np.full(more, frame)])
        self._last_sight[numbers] = frame

    @property
    def in_sight(self) -> NDArray[np.bool_]:
        """Which blocks (n,) of the evidence were in the field of view in the last few frames."""
        return np.asarray(self._last_sight > self._last_sight.max(initial=0) - SIGHT_FRAMES)

    @property
    def last_seen(self) -> int:
        """The last frame in which it was found."""
        return max(frame for frame, at in enumerate(self.found) if at is not None and at.status != UNSEEN)

    @property
    def out_of_sight(self) -> bool:
        """Whether it was not in sight in the last frame."""
        return bool(self.found) and self.found[-1] is not None and self.found[-1].status == UNSEEN

    def record(self, frame: int, at: Located | None) -> None:
        """Keep where the object was found in a frame; frames before it appeared count as not found."""
        if at is not None and self.born is None:
            self.born = frame
            self.poses = [at.T_camera_object] * frame
        last = self.poses[-1] if self.poses else identity()
        self.poses += [last] * (frame - len(self.poses))
        self.poses.append(last if at is None else at.T_camera_object)
        self.found += [None] * (frame - len(self.found))
        self.found.append(at)


class Scene:
    """All objects; grows by one frame at a time.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.
    script
        Where every object is in every frame, from an earlier pass; None: find out.
    division
        Labels of the frames where these are divided by motion; None: find them as the frames come.

    Attributes
    ----------
    distance_m
        Median depth of the first frame that has any.
    repeated
        For each frame, whether it is a copy of the one before: it tells nothing new, and is not fused.
    gains
        For each frame, units (3, 2) of the gain of the colour camera that its colours were freed of; neutral unless
        the encoder is causal, for others fit them later.
    luma_weight
        Weight of luma against depth where objects are tracked; to be set before the first frame.
    """

    def __init__(
        self,
        info: SequenceInfo,
        config: EncoderConfig,
        script: Mapping[int, Sequence[Located | None]] | None = None,
        division: Division | None = None,
    ) -> None:
        self.info, self.config = info, config
        self._script = script
        if division is None and config.segmentation.mode is SegmentationMode.MOTION:
            division = Division(info, config)
        self.division = division
        self.objects: dict[int, SceneObject] = {}
        self.timestamps: list[int] = []
        self.repeated: list[bool] = []
        self.gains: list[NDArray[np.int64]] = []
        self.luma_weight = 1.0
        self._before: Frame | None = None
        self._thinned, self._full = Thinned(info.rig), Thinned(info.rig, 1)
        self._rays = info.rig.depth.rays()
        self._sensor: SensorModel | None = None
        self._live_factor: float | None = None
        self.distance_m = 0.0

    @property
    def entropy_bits(self) -> float:
        """Entropy of all models."""
        return sum(item.entropy.bits for item in self.objects.values())

    def add(self, frame: Frame) -> str:
        """Take in one frame: segment, locate, fuse. Return the worst status of its objects.

        Raises
        ------
        SequenceError
            If the frame does not fit the sequence.
        """
        check_frame(frame, self.info)
        frame = self.limited(frame)
        if self._sensor is None:
            self._sensor = chosen_sensor(self.config.sensor, frame.depth)
            frame = self.limited(frame)
        self.repeated.append(self._before is not None and _same_pictures(frame, self._before))
        self._before = frame
        sensor = self._sensor
        if not self.distance_m and frame.depth.any():
            self.distance_m = float(np.median(frame.depth[frame.depth > 0]))
        labels = self.labels(frame)
        if self._live_factor is None:
            self._live_factor = self._rated_factor(frame, labels)
        seen = observe(frame, self.info.rig, self._rays)
        views = self.views(frame)
        worst = STATUS_ORDER[0]
        self.gains.append(self.gains[-1] if self.gains else NEUTRAL)
        numbers = {0, *np.unique(labels).tolist(), *self.objects}
        for number in sorted(numbers - {NOTHING} if self.division else numbers):
            mask = labels == number
            item = self._object(number, frame, mask, sensor)
            if item is None:
                continue
            script = self._script
            found = self._located(item, views, mask) if script is None else script[number][frame.index]
            item.record(frame.index, found)
            if found is not None:
                if found.status != UNSEEN:
                    worst = max(worst, str(found.status), key=STATUS_ORDER.index)
                if found.usable and not self.repeated[-1]:
                    if number == 0 and self.config.causal:
                        seen = self._exposed(item, seen, mask, found.T_camera_object)
                    self._fuse(item, seen, mask, found.T_camera_object, sensor)
        self.timestamps.append(frame.timestamp_ns)
        return worst

    def labels(self, frame: Frame) -> NDArray[np.uint8]:
        """Return the objects' numbers (h, w) at the pixels of a frame's depth picture."""
        if self.division is not None:
            return self.division.labels(frame)
        by_masks = resolved_mode(self.config.segmentation, self.info) is SegmentationMode.MASKS
        if by_masks and frame.mask is None and self.objects:
            return self._predicted_labels(frame)
        return segment(frame, self.config.segmentation, self.info)

    def _predicted_labels(self, frame: Frame) -> NDArray[np.uint8]:
        """Label a frame that has no mask by what the models show at the poses that are known or come next."""
        labels, depth = np.zeros(frame.depth.shape, dtype=np.uint8), frame.depth
        gate = 4 * self.sensor.sigma_m(depth.astype(np.float64)) + PREDICTION_GATE * depth
        nearest = np.full(depth.shape, np.inf)
        for number, item in self.objects.items():
            if not number or item.born is None:
                continue
            pose = self._expected(item, frame.index)
            view = cast_view(item.evidence, self._full, pose, self.config.threads).depth
            off = np.where(depth > 0, np.abs(depth - view), 0)
            mine = (view > 0) & (off <= gate) & (off < nearest)
            labels[mine], nearest[mine] = number, off[mine]
        return labels

    def _expected(self, item: SceneObject, frame: int) -> Pose:
        """Return the pose of an object in a frame as far as it is known, else at constant velocity."""
        if frame < len(item.poses):
            return item.poses[frame]
        found = self._script[item.number][frame] if self._script is not None else None
        if found is not None:
            return found.T_camera_object
        return predict(*item.poses[-2:]) if len(item.poses) > 1 else item.poses[-1]

    def _located(self, item: SceneObject, views: FrameViews, mask: NDArray[np.bool_]) -> Located | None:
        """Find an object in a frame; one that is out of sight stays in the background where it was, or is gone."""
        if self.division is None or not item.number or item.born is None:
            return item.locate(views, mask, self.info.rig, self._one_object)
        last, world = item.poses[-1], self.objects[0].poses
        T_camera_object = last if np.array_equal(world[-1], world[-2]) else world[-1] @ inverse(world[-2]) @ last
        at = None
        if self.division.is_seen(item.number, views.frame):
            if item.out_of_sight and item.tracker is not None:
                guess = self.division.way(item.number, item.last_seen, views.frame.index)
                item.tracker.resume(item.poses[item.last_seen] if guess is None else guess @ item.poses[item.last_seen])
            at = item.locate(views, mask, self.info.rig, self._one_object)
        if at is not None:
            return at
        if self.division.is_gone(item.number, views.frame) and np.linalg.norm(T_camera_object[:3, 3]) < AWAY_M / 2:
            T_camera_object = make_pose(T_camera_object[:3, :3], np.array([0.0, 0.0, -AWAY_M]))
        return Located(T_camera_object=T_camera_object, status=UNSEEN)

    @property
    def sensor(self) -> SensorModel:
        """Noise of the depth: the one asked for, or guessed from the first frame."""
        return self._sensor or SENSORS[Sensor.KINECT1]

    def views(self, frame: Frame) -> FrameViews:
        """Return the forms of a frame for registration."""
        return FrameViews(frame, self._full, self._thinned)

    def is_given(self, item: SceneObject, at: Located) -> bool:
        """Tell whether a pose is to be taken as it is.

        Poses of a hand-held camera are worth refining. Those of labelled objects are not: given ones are made
        on purpose, tracked ones would follow the shades of the model's colours. A background without camera
        poses stands still.
        """
        return item.number > 0 or (at.status == "known" and not self.info.has_camera_poses)

    def may_move(self, number: int) -> bool:
        """Tell whether the poses of an object are worth refining in some frame."""
        item = self.objects[number]
        return any(at is not None and at.usable and not self.is_given(item, at) for at in item.found)

    def at_rest(self, number: int) -> bool:
        """Tell whether an object never moves before the camera, and is not going to be moved."""
        poses = self.objects[number].poses
        return not self.may_move(number) and all(np.array_equal(pose, poses[0]) for pose in poses)

    @property
    def _one_object(self) -> bool:
        return self.config.segmentation.mode is SegmentationMode.DEPTH

    def limited(self, frame: Frame) -> Frame:
        """Return a frame without what is no number, and without measurements beyond the largest depth.

        That is the one asked for, or else where the sensor is no longer good to 0.1 m.
        """
        limit = self.config.max_depth_m or (self._sensor.reach_m if self._sensor else MAX_DEPTH_M)
        return replace(frame, depth=within(frame.depth, limit))

    def _object(self, number: int, frame: Frame, mask: NDArray[np.bool_], sensor: SensorModel) -> SceneObject | None:
        """Return an object, new where enough pixels show it for the first time."""
        if number in self.objects:
            return self.objects[number]
        if number and np.count_nonzero(mask & (frame.depth > 0)) < MIN_PIXELS:
            return None
        tracked = not self._stands_still(number) and self._is_tracked(number)
        size = self.config.voxel_size_m
        if size is None:
            size = default_voxel_size(frame.depth, mask, self.info)
            if number == 0 and not tracked and not self.info.has_camera_poses and not self.config.causal:
                size *= BACKDROP_CELLS
            size *= self.config.cell_factor * (self._live_factor or 1.0)
            size = max(round(size, 4), MIN_VOXEL_SIZE_M)
        tracker = None
        if tracked:
            tracker = Tracker(
                sensor,
                self.config.threads,
                lit_evenly=number == 0,
                luma_weight=self.luma_weight,
                patience=max(MIN_PATIENCE, round(self.info.fps)),
            )
        self.objects[number] = SceneObject(number, size, tracker)
        return self.objects[number]

    def _is_tracked(self, number: int) -> bool:
        """Objects found by their motion bear no relation to the poses that the input may have."""
        by_motion = number > 0 and self.division is not None
        return by_motion or motion_of(number, self.info, self.config.motion) is Motion.TRACK

    def _rated_factor(self, frame: Frame, labels: NDArray[np.uint8]) -> float:
        """Return by how much wider cells a live encoder takes for its rate, as it can tell from the first frame."""
        rate = self.config.bitrate_bps
        if rate is None or not self.config.causal or not frame.depth.any():
            return 1.0
        cells = 0.0
        for number in np.unique(labels).tolist():
            mask = labels == number
            pixel = frame.depth[mask] / self.info.rig.depth.fx
            area = float(np.square(pixel, dtype=np.float64).sum())
            cells += area / default_voxel_size(frame.depth, mask, self.info) ** 2
        return live_cell_factor(cells, rate / 8)

    def _stands_still(self, number: int) -> bool:
        """The background stands still before a camera that does, unless the camera's poses are known.

        That of a depth threshold does by definition.
        """
        rests = self._one_object or (self.division is not None and self.division.camera_rests)
        return number == 0 and rests and not self.info.has_camera_poses

    def _exposed(self, background: SceneObject, seen: Observation, mask: NDArray[np.bool_], pose: Pose) -> Observation:
        """Find the gain of a frame, and return the frame without it."""
        self.gains[-1] = camera_gain(seen, mask, pose, background.evidence, self.gains[-1], self.info.grey)
        return with_gain(seen, self.gains[-1])

    def _fuse(
        self, item: SceneObject, seen: Observation, mask: NDArray[np.bool_], pose: Pose, sensor: SensorModel
    ) -> None:
        numbers = fuse(item.evidence, seen, mask, pose, sensor, self.config.fusion, self.config.threads)
        item.entropy.update(numbers, self.config.threads)
        item.note_sight(numbers, seen.frame)


def _same_pictures(one: Frame, other: Frame) -> bool:
    """Tell whether two frames show the same, pixel by pixel."""
    if (one.mask is None) != (other.mask is None):
        return False
    if one.mask is not None and other.mask is not None and not np.array_equal(one.mask, other.mask):
        return False
    return np.array_equal(one.color, other.color) and np.array_equal(one.depth, other.depth)
