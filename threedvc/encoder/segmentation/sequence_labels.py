# SPDX-License-Identifier: MIT
"""The labels of all frames of a sequence that is segmented by motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.config import EncoderConfig
from threedvc.encoder.segmentation.motion.backward_search import find_among, visible_pixels
from threedvc.encoder.segmentation.motion.downsampling import Downsampling
from threedvc.encoder.segmentation.motion.motion_segmenter import (
    MIN_CERTAIN_TRANSIENCE,
    TRANSIENT_LABEL,
    MotionSegmenter,
)
from threedvc.encoder.segmentation.motion.moving_body import MotionHypothesis
from threedvc.encoder.segmentation.motion.object_evidence import is_object
from threedvc.encoder.segmentation.motion.segmenter_state import SegmenterState
from threedvc.encoder.segmentation.motion.transient_numbers import TRANSIENT_NUMBERS, TransientNumbers
from threedvc.encoder.segmentation.packed_picture import PackedPicture, packed
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sensor_model import chosen_sensor
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import Pose, inverse

__all__ = ["MAX_LOST_SHARE", "VOID_LABEL", "SequenceLabels", "TransientPose"]

VOID_LABEL = int(np.iinfo(np.uint8).max)
"""Label of pixels that belong neither to the background nor to an object, such as of hands."""
MAX_OBJECTS = 200
"""Objects at most: labels are bytes, and those from 240 on have another meaning."""
MAX_LOST_SHARE = 0.05
"""Part of the frames in which the camera, or an object, may be lost; else what seems to move may not be rigid."""
MIN_TRANSIENT_BPS = 24_000
"""Below this rate transient things are left out: their cells would take more than a tenth from all others (decision
0016)."""


class TransientPose(NamedTuple):
    """A transient thing in a frame: which one of those with its number it is, and its T_camera_object."""

    segment: int
    T_camera_object: Pose


@dataclass(kw_only=True, eq=False)
class _FrameLabels:
    """Labels of a frame (h, w), downsampled, and which objects were found, are gone, or are transient, by number."""

    labels: PackedPicture[np.uint8]
    found: set[int]
    gone: set[int]
    transient: dict[int, TransientPose]


class _Segmented(NamedTuple):
    """A frame of which it is not known yet which bodies are objects: their numbers (h, w), and those that are gone."""

    timestamp_ns: int
    labels: PackedPicture[np.uint16]
    gone: set[MotionHypothesis]


class SequenceLabels:
    """Labels of frames by their time, and which objects are there.

    Frames that are not known yet are segmented when they are asked for, in order, as a live encoder needs it.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.

    Attributes
    ----------
    camera_rests
        Whether the camera stands still in a sequence that was taken as a whole.
    """

    def __init__(self, info: SequenceInfo, config: EncoderConfig) -> None:
        self._info, self._config = info, config
        self._downsampling = Downsampling(info)
        self._segmenter: MotionSegmenter | None = None  # until a first frame tells the sensor
        self._frames: dict[int, _FrameLabels] = {}
        self._objects: dict[MotionHypothesis, int] = {}
        self._transients = TransientNumbers(self._downsampling.rig.depth)
        self._has_transients = config.bitrate_bps is None or config.bitrate_bps >= MIN_TRANSIENT_BPS
        self.camera_rests = False

    @property
    def is_sure(self) -> bool:
        """Whether it found objects in a sequence that was taken as a whole, and never lost the camera for long."""
        poses = [] if self._segmenter is None else self._segmenter.state.poses
        lost = sum(pose is None for pose in poses)
        return bool(self._objects) and lost <= MAX_LOST_SHARE * len(poses)

    def labels(self, frame: Frame) -> NDArray[np.uint8]:
        """Return the labels (h, w) of a frame's depth picture: 0 the background, objects, or `VOID_LABEL`."""
        if frame.timestamp_ns not in self._frames:
            self._segment_next(frame)
        small = self._frames[frame.timestamp_ns].labels.unpacked()
        return self._downsampling.upsample_labels(small, frame.depth, self._config.threads)

    def is_seen(self, number: int, frame: Frame) -> bool:
        """Tell whether an object was found in a frame."""
        return number in self._frames[frame.timestamp_ns].found

    def is_gone(self, number: int, frame: Frame) -> bool:
        """Tell whether an object is no longer where it was last."""
        return number in self._frames[frame.timestamp_ns].gone

    def transient(self, number: int, frame: Frame) -> TransientPose | None:
        """Return which transient thing has a number in a frame and where it is, or None."""
        return self._frames[frame.timestamp_ns].transient.get(number)

    def displacement(self, number: int, start: int, stop: int) -> Pose | None:
        """Return how an object moved before the camera from one frame to another, or None."""
        body = next(body for body, known_as in self._objects.items() if known_as == number)
        before, after = body.pose_of(start), body.pose_of(stop)
        return None if before is None or after is None else after @ inverse(before)

    def segment_all(self, frames: FrameSequence) -> None:
        """Segment a sequence as a whole: every frame with what all others saw."""
        segmenter = self._segmenter_for(frames[0])
        state = segmenter.state
        for frame in frames:
            segmenter.observe(frame)
        self.camera_rests = _never_moves(state.poses)
        segmented = [_segmented(segmenter, frame) for frame in frames]
        for body in state.bodies:
            self._number(state, body)
        for index in range(len(segmented)):
            for body in state.bodies:
                self._number_transient(body, index, ahead=True)
        for index, each in enumerate(segmented):
            self._keep(state, each, index)
        for body in state.bodies:
            if body in self._objects:
                self._label_backwards(state, body, frames, segmented)

    def _segmenter_for(self, frame: Frame) -> MotionSegmenter:
        """Return the segmenter; a first frame tells what sensor it is made for."""
        if self._segmenter is None:
            sensor = chosen_sensor(self._config.sensor, frame.depth)
            self._segmenter = MotionSegmenter(self._info, self._config, sensor, self._downsampling)
        return self._segmenter

    def _segment_next(self, frame: Frame) -> None:
        """Segment the next frame by what was seen so far."""
        segmenter = self._segmenter_for(frame)
        state = segmenter.state
        segmenter.observe(frame)
        segmented = _segmented(segmenter, frame)
        for body in state.bodies:
            self._number(state, body)
            self._number_transient(body, frame.index)
        self._keep(state, segmented, frame.index)
        state.forget(frame.index)

    def _number(self, state: SegmenterState, body: MotionHypothesis) -> None:
        """Give a body a number once it is an object of its own."""
        known = body in self._objects or body.merged_into is not None
        if not known and len(self._objects) < MAX_OBJECTS and is_object(state, body):
            self._objects[body] = len(self._objects) + 1

    def _number_transient(self, body: MotionHypothesis, frame: int, *, ahead: bool = False) -> None:
        """Give a body that is no object a number for as long as it is seen well."""
        if self._has_transients and body.survivor not in self._objects:
            self._transients.assign(body, frame, ahead=ahead)

    def _keep(self, state: SegmenterState, segmented: _Segmented, index: int) -> None:
        """Keep the labels of a frame, and which objects are in it."""
        table = np.zeros(TRANSIENT_LABEL + 1, dtype=np.uint8)
        table[TRANSIENT_LABEL] = VOID_LABEL
        transient = {}
        for body in state.bodies:
            moves = body.transience.get(index, 0) > MIN_CERTAIN_TRANSIENCE
            table[body.number] = self._objects.get(body.survivor, VOID_LABEL if moves else 0)
            segment, pose = self._transients.segment_of(body, index), body.pose_of(index)
            if segment is not None and pose is not None and body not in self._objects:
                table[body.number] = segment.number
                transient[segment.number] = TransientPose(segment.order, pose)
        self._frames[segmented.timestamp_ns] = _FrameLabels(
            labels=packed(table[segmented.labels.unpacked()]),
            found={number for body, number in self._objects.items() if body.pose_of(index) is not None},
            gone={number for body, number in self._objects.items() if body in segmented.gone},
            transient=transient,
        )

    def _label_backwards(
        self, state: SegmenterState, body: MotionHypothesis, frames: FrameSequence, segmented: Sequence[_Segmented]
    ) -> None:
        """Label an object by its finished model before it was known as one, back to where it stood still at first.

        Pixels that were given to no object may turn out to be its, also those of other bodies.
        """
        for index in range(body.confirmed_in or 0, -1, -1):
            if index > body.born and body.pose_of(index) is None:
                continue
            frame = frames[index]
            kept = self._frames[frame.timestamp_ns]
            labels = kept.labels.unpacked()
            free = (labels == 0) | (labels >= TRANSIENT_NUMBERS.start)
            mask = visible_pixels(state, body, frame)
            if mask is None and index < body.born:
                mask = find_among(state, body, frame, (segmented[index].labels.unpacked() > 0) & free)
                if mask is None:
                    return
            if mask is not None and mask.any():
                kept.labels = packed(np.where(mask & free, np.uint8(self._objects[body]), labels))
                kept.found.add(self._objects[body])


def _segmented(segmenter: MotionSegmenter, frame: Frame) -> _Segmented:
    labels = packed(segmenter.segment(frame))
    return _Segmented(frame.timestamp_ns, labels, {body for body in segmenter.state.bodies if body.gone})


def _never_moves(poses: Sequence[Pose | None]) -> bool:
    """Tell whether a camera was never lost and never moved."""
    first = poses[0]
    return first is not None and all(pose is not None and np.array_equal(pose, first) for pose in poses)
