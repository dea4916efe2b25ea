# SPDX-License-Identifier: MIT
"""The encoder's view of a sequence: its objects, their evidence, and where they are in every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.gains import NEUTRAL
from threedvc.config import MIN_VOXEL_SIZE_M, EncoderConfig, Motion, SegmentationMode, Sensor
from threedvc.encoder.fusion.exposure import camera_gain, with_gain
from threedvc.encoder.fusion.integration import Observation, fuse, observe
from threedvc.encoder.fusion.noise_meter import NoiseMeter
from threedvc.encoder.rate.rate_control import live_cell_factor
from threedvc.encoder.reconstruction.cell_size import default_voxel_size
from threedvc.encoder.reconstruction.pose_freedom import REST_PIXELS, displacement
from threedvc.encoder.reconstruction.scene_object import MIN_PIXELS, SceneObject
from threedvc.encoder.segmentation.masks import resolved_mode, segment
from threedvc.encoder.segmentation.moving_body import LOST_FRAMES
from threedvc.encoder.segmentation.sequence_labels import NOTHING, PASSING_NUMBERS, Division
from threedvc.encoder.tracking.initial_poses import predict
from threedvc.encoder.tracking.joint_registration import Sight
from threedvc.encoder.tracking.model_view import FrameViews, Thinned, cast_view, shown_and_measured
from threedvc.encoder.tracking.pose_track import UNSEEN, Located, motion_of
from threedvc.encoder.tracking.registration import Status
from threedvc.encoder.tracking.tracker import PART_CELLS, Tracker
from threedvc.errors import ConfigError
from threedvc.frames.frame import Frame, SequenceInfo, check_frame
from threedvc.frames.sensor_model import SENSORS, SensorModel, chosen_sensor, within
from threedvc.geometry.pose import Pose, inverse, make_pose

__all__ = ["Scene"]

MAX_DEPTH_M = 1e4
BACKDROP_CELLS = 1.1
"""A background at rest before a camera at rest is coloured by a picture: its cells may be a little wider."""
MIN_PATIENCE = 5
"""Frames, if a second has fewer, for which an object may be lost before a new part of its model begins."""
PREDICTION_GATE = 0.03
AWAY_M = 1000.0
"""Where an object is put that left: so far behind the camera that nobody will see it."""
AWAY = make_pose(np.eye(3), np.array([0.0, 0.0, -AWAY_M]))
PASSING_CELLS = 2.0
"""By how much wider the cells are of what is there for a moment."""
SETTLING_SHARE = 0.01
"""Share of a frame's pixels with depth from which on it tells the sensor and the size of cells: cameras begin with
frames of none, or of specks, until their exposure has settled."""
RESIZED = 4
"""Cells of a background that no such frame has shown are chosen anew where another has so many times the depth."""
METERED_FRAMES = 12
"""Frames after which a live encoder settles what sensor it has."""
STATUS_ORDER = ("known", "tracked", "relocalised", "weak", "lost")


@dataclass(kw_only=True, eq=False)
class _Look:
    """A frame to be taken in: its forms, the objects' numbers (h, w), and what is fused."""

    views: FrameViews
    labels: NDArray[np.uint8]
    seen: Observation


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
    luma_weight
        Weight of luma against depth where objects are tracked, no more than 1 for others than the background.

    Attributes
    ----------
    distance_m
        Median depth of the first frame that has any.
    color_offsets
        For each frame, how many nanoseconds later than its depth picture its colour picture was taken.
    sensors, together
        For each frame, the sensor that took it, and whether it did so at the moment of the frame before.
    repeated
        For each frame, whether it is a copy of the sensor's one before: it tells nothing new, and is not fused.
    blind
        For each frame, whether it has no depth at all.
    gains
        For each frame, units (3, 2) of the gain of the colour camera that its colours were freed of; neutral unless
        the encoder is causal, for others fit them later.
    """

    def __init__(
        self,
        info: SequenceInfo,
        config: EncoderConfig,
        script: Mapping[int, Sequence[Located | None]] | None = None,
        division: Division | None = None,
        *,
        luma_weight: float = 1.0,
    ) -> None:
        self.info, self.config = info, config
        self._script = script
        if config.segmentation.mode is SegmentationMode.MOTION and info.sensors:
            raise ConfigError(
                "--segment motion divides the frames of one sensor; give masks or --segment depth:NEAR..FAR, or encode "
                "the sensors apart"
            )
        if division is None and config.segmentation.mode is SegmentationMode.MOTION:
            division = Division(info, config)
        self.division = division
        self.objects: dict[int, SceneObject] = {}
        self.timestamps: list[int] = []
        self.color_offsets: list[int] = []
        self.sensors: list[int] = []
        self.together: list[bool] = []
        self.repeated: list[bool] = []
        self.blind: list[bool] = []
        self.gains: list[NDArray[np.int64]] = []
        self._luma_weight = luma_weight
        self._before: dict[int, Frame] = {}
        self._thinned, self._full = [Thinned(rig) for rig in info.rigs], [Thinned(rig, 1) for rig in info.rigs]
        self._rays = [rig.depth.rays() for rig in info.rigs]
        self._noise: dict[int, SensorModel] = {}
        self._meters: dict[int, NoiseMeter] = {}
        self._live_factor: float | None = None
        self._settling = True
        self.distance_m = 0.0

    def with_config(self, config: EncoderConfig) -> Scene:
        """Return the same scene, its objects shared, under other choices for what is still to come."""
        scene = copy(self)
        scene.config = config
        return scene

    @property
    def entropy_bits(self) -> float:
        """Entropy of all models."""
        return sum(item.entropy.bits for item in self.objects.values())

    def add(self, *frames: Frame) -> str:
        """Take in the frames of one moment: segment, locate, fuse. Return the worst status of their objects.

        Raises
        ------
        SequenceError
            If a frame does not fit the sequence.
        """
        looks = [self._look(frame) for frame in frames]
        worst = STATUS_ORDER[0]
        numbers = {0, *self.objects}.union(*(np.unique(look.labels).tolist() for look in looks))
        for number in sorted(numbers - {NOTHING} if self.division else numbers):
            sights = [Sight(look.views, look.labels == number) for look in looks]
            item = self._object(number, sights)
            if item is None:
                continue
            script, first = self._script, looks[0].views.frame.index
            found = self._located(item, sights) if script is None else script[number][first]
            if found is not None and found.status != UNSEEN:
                worst = max(worst, str(found.status), key=STATUS_ORDER.index)
            for look, sight in zip(looks, sights, strict=True):
                frame = look.views.frame
                item.record(frame.index, found)
                if self.division is not None and number and item.born == frame.index:
                    # Before, it was not there, or was taken for the background.
                    item.poses[:-1] = self._away_before(frame.index)
                if found is not None and found.usable and not self.repeated[frame.index]:
                    T_camera_object = look.views.rig.at_sensor(found.T_camera_object)
                    if number == 0 and self.config.causal:
                        self._meter_noise(item, look, sight.mask, T_camera_object)
                        look.seen = self._exposed(item, look.seen, sight.mask, T_camera_object)
                    self._fuse(item, look.seen, sight.mask, T_camera_object, self.sensor_of(frame.sensor))
        self.timestamps += [frame.timestamp_ns for frame in frames]
        self.color_offsets += [
            0 if frame.color_timestamp_ns is None else frame.color_timestamp_ns - frame.timestamp_ns for frame in frames
        ]
        return worst

    def _look(self, frame: Frame) -> _Look:
        """Check a frame, and take in what does not depend on where objects are."""
        check_frame(frame, self.info)
        frame = self.limited(frame)
        settling = not _shows_much(frame)
        if frame.sensor not in self._noise and not settling:
            self._noise[frame.sensor] = chosen_sensor(self.config.sensor_of(frame.sensor), frame.depth)
            frame = self.limited(frame)
        self.sensors.append(frame.sensor)
        self.together.append(frame.together)
        before = self._before.get(frame.sensor)
        self.repeated.append(before is not None and _same_pictures(frame, before))
        self._before[frame.sensor] = frame
        self.blind.append(not frame.depth.any())
        if frame.depth.any() and (not self.distance_m or (self._settling and not settling)):
            self.distance_m = float(np.median(frame.depth[frame.depth > 0]))
        self._settling = self._settling and settling
        labels = self.labels(frame)
        if self._live_factor is None and not settling:
            self._live_factor = self._rated_factor(frame, labels)
        last = self.frame_before(len(self.gains))
        self.gains.append(NEUTRAL if last is None else self.gains[last])
        rig = self.info.rigs[frame.sensor]
        return _Look(views=self.views(frame), labels=labels, seen=observe(frame, rig, self._rays[frame.sensor]))

    def _meter_noise(self, item: SceneObject, look: _Look, mask: NDArray[np.bool_], T_camera_object: Pose) -> None:
        """Find out in its first frames if a sensor scatters more than the very first of them made believe."""
        number = look.views.frame.sensor
        meter = self._meters.setdefault(number, NoiseMeter())
        named = self.config.sensor_of(number) is not Sensor.AUTO
        if named or meter.frames == METERED_FRAMES or not item.evidence.index.count:
            return
        pictures = shown_and_measured(item.evidence, look.views, mask, T_camera_object, self.config.threads)
        meter.add(*pictures, item.evidence.voxel_size_m)
        better = meter.better_than(self._noise[number]) if meter.frames == METERED_FRAMES else None
        if better is not None:
            self._noise[number] = SENSORS[better]

    def frame_before(self, frame: int) -> int | None:
        """Return the frame before one of the frames so far that the same sensor took; None for its first."""
        same = (k for k in range(frame - 1, -1, -1) if self.sensors[k] == self.sensors[frame])
        return next(same, None)

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
        form = self._full[frame.sensor]
        gate = 4 * self.sensor_of(frame.sensor).sigma_m(depth.astype(np.float64)) + PREDICTION_GATE * depth
        nearest = np.full(depth.shape, np.inf)
        for number, item in self.objects.items():
            if not number or item.born is None:
                continue
            pose = form.rig.at_sensor(self._expected(item, frame.index))
            view = cast_view(item.evidence, form, pose, self.config.threads).depth
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

    def _located(self, item: SceneObject, sights: Sequence[Sight]) -> Located | None:
        """Find an object in the frames of a moment.

        It is looked for where it went on in the background, not before the camera. One found by its motion that is out
        of sight stays in the background where it was, or is gone.
        """
        motion = self._room_motion(sights[0].views.frame.index) if item.number and item.born is not None else None
        if motion is not None and item.tracker is not None:
            item.tracker.carry(motion)
        if self.division is None or not item.number or (item.born is None and not item.passing):
            at = item.locate(sights, self.info.rigs, self._one_object)
            return (
                at
                if at is not None or motion is None
                else Located(T_camera_object=motion @ item.poses[-1], status=UNSEEN)
            )
        views = sights[0].views
        if item.passing:
            return self._passing(item, views.frame)
        last, world = item.poses[-1], self.objects[0].poses
        T_camera_object = last if np.array_equal(world[-1], world[-2]) else world[-1] @ inverse(world[-2]) @ last
        at = None
        if self.division.is_seen(item.number, views.frame):
            if item.out_of_sight and item.tracker is not None:
                guess = self.division.way(item.number, item.last_seen, views.frame.index)
                item.tracker.resume(item.poses[item.last_seen] if guess is None else guess @ item.poses[item.last_seen])
            at = item.locate(sights, self.info.rigs, self._one_object)
        gone = self.division.is_gone(item.number, views.frame)
        if at is not None and not at.usable and views.frame.index - item.last_seen > LOST_FRAMES:
            at, gone = None, True  # better nothing than what may be elsewhere, or something else
        if at is not None:
            return at
        if gone and np.linalg.norm(T_camera_object[:3, 3]) < AWAY_M / 2:
            T_camera_object = make_pose(T_camera_object[:3, :3], np.array([0.0, 0.0, -AWAY_M]))
        return Located(T_camera_object=T_camera_object, status=UNSEEN)

    def _room_motion(self, frame: int) -> Pose | None:
        """Return how the background moved before the base since the moment before a frame; None if it did not."""
        background = self.objects.get(0)
        if background is None or background.born is None or not 0 < frame < len(background.poses):
            return None
        before, now = background.poses[frame - 1], background.poses[frame]
        return None if np.array_equal(before, now) else now @ inverse(before)

    def _passing(self, item: SceneObject, frame: Frame) -> Located:
        """Place what is there for a moment, apart from what had its number before; away where there is nothing."""
        assert self.division is not None
        at = self.division.passing(item.number, frame)
        if at is None:
            away = self._away_before(frame.index + 1)[-1] if self.objects[0].poses else AWAY
            return Located(T_camera_object=away, status=UNSEEN)
        apart = np.array([0.0, -at.life * PART_CELLS * item.evidence.voxel_size_m, 0.0])
        return Located(T_camera_object=at.T_camera_object @ make_pose(np.eye(3), apart), status=Status.TRACKED)

    def _away_before(self, frame: int) -> list[Pose]:
        """Return the poses, in all frames before one, of a place far behind the first camera."""
        world = self.objects[0].poses[:frame]
        return [T_camera_world @ inverse(world[0]) @ AWAY for T_camera_world in world]

    def sensor_of(self, number: int) -> SensorModel:
        """Return the noise of a sensor's depth: the one asked for, or guessed from its first frame."""
        return self._noise.get(number) or SENSORS[Sensor.KINECT1]

    def views(self, frame: Frame) -> FrameViews:
        """Return the forms of a frame for registration."""
        return FrameViews(frame, self._full[frame.sensor], self._thinned[frame.sensor])

    def is_given(self, item: SceneObject, at: Located) -> bool:
        """Tell whether a pose is to be taken as it is.

        Poses of a hand-held camera are worth refining. Those of labelled objects are not: given ones are made
        on purpose, tracked ones would follow the shades of the model's colours. A background without camera
        poses stands still, and so does one that was tracked and never moved.
        """
        if item.number > 0 or (at.status == "known" and not self.info.has_camera_poses):
            return True
        return at.status != "known" and item.stayed

    def hardly_moves(self, number: int) -> bool:
        """Tell whether all poses at which an object was tracked lie within half a pixel of the first one."""
        item = self.objects[number]
        tracked = [at.T_camera_object for at in item.found if at is not None and at.usable]
        if item.tracker is None or not tracked:
            return False
        focal = max(rig.depth.fx for rig in self.info.rigs)
        return all(displacement(inverse(tracked[0]) @ pose, self.distance_m) * focal < REST_PIXELS for pose in tracked)

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
        sensor = self._noise.get(frame.sensor)
        limit = self.config.max_depth_m or (sensor.reach_m if sensor else MAX_DEPTH_M)
        return replace(frame, depth=within(frame.depth, limit))

    def _object(self, number: int, sights: Sequence[Sight]) -> SceneObject | None:
        """Return an object, new where enough pixels of a frame show it for the first time."""
        shown = [int(np.count_nonzero(mask & (views.frame.depth > 0))) for views, mask in sights]
        views, mask = sights[int(np.argmax(shown))]
        tracked = not self._stands_still(number) and self._is_tracked(number)
        if number in self.objects:
            item = self.objects[number]
            if not number and self._outgrows(item, max(shown), views.frame):
                item.begin_anew(self._cell_size(number, views, mask, tracked=tracked), max(shown))
            return item
        if number and max(shown) < MIN_PIXELS:
            return None
        size = self._cell_size(number, views, mask, tracked=tracked)
        tracker = None
        passing = self.division is not None and number in PASSING_NUMBERS
        if passing:
            size = max(round(PASSING_CELLS * size, 4), MIN_VOXEL_SIZE_M)
        if tracked and not passing:
            tracker = Tracker(
                self.sensor_of(views.frame.sensor),
                self.config.threads,
                sensor_of=self.sensor_of,
                lit_evenly=number == 0,
                luma_weight=self._luma_weight if number == 0 else min(self._luma_weight, 1.0),
                patience=max(MIN_PATIENCE, round(self.info.fps)),
            )
        self.objects[number] = SceneObject(number, size, tracker, passing=passing)
        self.objects[number].sized_by = max(shown)
        return self.objects[number]

    def _cell_size(self, number: int, views: FrameViews, mask: NDArray[np.bool_], *, tracked: bool) -> float:
        """Return the edge of the cells of an object that a frame shows at `mask` (h, w): asked for, or as fits it."""
        if self.config.voxel_size_m is not None:
            return self.config.voxel_size_m
        size = default_voxel_size(views.frame.depth, mask, views.rig)
        if number == 0 and not tracked and not self.info.has_camera_poses and not self.config.causal:
            size *= BACKDROP_CELLS
        size *= self.config.cell_factor * (self._live_factor or 1.0)
        return max(round(size, 4), MIN_VOXEL_SIZE_M)

    def _outgrows(self, item: SceneObject, shown: int, frame: Frame) -> bool:
        """Tell whether a frame shows so much more of the background than those before that its cells follow from it."""
        chosen_by_specks = item.sized_by < SETTLING_SHARE * frame.depth.size and self.config.voxel_size_m is None
        return chosen_by_specks and shown >= max(RESIZED * item.sized_by, MIN_PIXELS)

    def _is_tracked(self, number: int) -> bool:
        """Objects found by their motion bear no relation to the poses that the input may have."""
        by_motion = number > 0 and self.division is not None
        return by_motion or motion_of(number, self.info, self.config.motion) is Motion.TRACK

    def _rated_factor(self, frame: Frame, labels: NDArray[np.uint8]) -> float:
        """Return by how much wider cells a live encoder takes for its rate, as it can tell from the first frame."""
        rate = self.config.bitrate_bps
        if rate is None or not self.config.causal or not frame.depth.any():
            return 1.0
        cells, rig = 0.0, self.info.rigs[frame.sensor]
        for number in np.unique(labels).tolist():
            mask = labels == number
            pixel = frame.depth[mask] / rig.depth.fx
            area = float(np.square(pixel, dtype=np.float64).sum())
            cells += area / default_voxel_size(frame.depth, mask, rig) ** 2
        return live_cell_factor(cells, rate / 8)

    def _stands_still(self, number: int) -> bool:
        """The background stands still before a camera that does, unless the camera's poses are known.

        That of a depth threshold does by definition.
        """
        rests = self._one_object or (self.division is not None and self.division.camera_rests)
        return number == 0 and rests and not self.info.has_camera_poses

    def _exposed(self, background: SceneObject, seen: Observation, mask: NDArray[np.bool_], pose: Pose) -> Observation:
        """Find the gain of a frame, and return the frame without it."""
        gain = camera_gain(seen, mask, pose, background.evidence, self.gains[seen.frame], self.info.grey)
        self.gains[seen.frame] = gain
        return with_gain(seen, gain)

    def _fuse(
        self, item: SceneObject, seen: Observation, mask: NDArray[np.bool_], pose: Pose, sensor: SensorModel
    ) -> None:
        numbers = fuse(item.evidence, seen, mask, pose, sensor, self.config.fusion, self.config.threads)
        item.entropy.update(numbers, self.config.threads)
        item.note_sight(numbers, seen.frame)


def _shows_much(frame: Frame) -> bool:
    """Tell whether a frame has depth on enough of its pixels to tell what sensor and scene there are."""
    return bool(np.count_nonzero(frame.depth) >= SETTLING_SHARE * frame.depth.size)


def _same_pictures(one: Frame, other: Frame) -> bool:
    """Tell whether two frames show the same, pixel by pixel."""
    if (one.mask is None) != (other.mask is None):
        return False
    if one.mask is not None and other.mask is not None and not np.array_equal(one.mask, other.mask):
        return False
    return np.array_equal(one.color, other.color) and np.array_equal(one.depth, other.depth)
