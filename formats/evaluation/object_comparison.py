# SPDX-License-Identifier: MIT
"""How well a stream has found the objects of its reference: which are which, their outlines and their poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import SequenceError
from threedvc.formats.decoding import DecodedFrame
from threedvc.formats.evaluation.frame_ranges import FrameSpan, ranges_of
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import Pose, inverse, rotation_angle
from threedvc.metrics.trajectory import ObjectPoseError, TrajectoryError, object_pose_error, trajectory_error

__all__ = ["ObjectComparison", "ObjectQuality", "SpuriousObject", "matched"]

LABELS = 256
"""Of 8-bit masks."""
MIN_PIXELS = 30
"""An object with fewer pixels than these is not taken to be shown by a frame."""
MIN_SHARE = 0.1
"""Objects are only matched where at least this part of what is drawn lies on the other."""
MOVED_M = 0.01
"""Between two poses of an object, from which on it has moved: beyond their jitter."""
MOVED_DEG = 2.0
"""By which it has turned: beyond the jitter of poses, too."""


@dataclass(frozen=True, kw_only=True)
class ObjectQuality:
    """How well one object of the reference was found.

    Attributes
    ----------
    label
        Its label in the reference.
    number
        The object of the stream that is matched to it, or None.
    frames, moved_frames
        Number of frames in which the reference shows it, and of those in which it has moved.
    iou, moved_iou
        Mean over these of the intersection of what is drawn with the mask, divided by their union; 0 where nothing is
        matched, None without such frames.
    pose
        Error of its poses where the reference shows it, or None where these are not known.
    """

    label: int
    number: int | None
    frames: int
    moved_frames: int
    iou: float | None
    moved_iou: float | None
    pose: ObjectPoseError | None


@dataclass(frozen=True, kw_only=True)
class SpuriousObject:
    """An object of the stream that is none of the reference, and the frames that show it."""

    number: int
    frames: int
    spans: tuple[FrameSpan, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """One frame: pixels by (number, label), or None without a mask, by number, and poses by label and by number."""

    index: int
    sensor: int
    number: int
    shared: Mapping[tuple[int, int], int] | None
    drawn: Mapping[int, int]
    T_world_camera: Pose | None
    true: Mapping[int, Pose]
    found: Mapping[int, Pose]

    def pixels(self, label: int) -> int:
        """Return the pixels of a label in the mask."""
        return sum(count for (_, other), count in (self.shared or {}).items() if other == label)

    def iou(self, number: int | None, label: int) -> float:
        """Return the overlap of an object as drawn with a label."""
        both = 0 if number is None else (self.shared or {}).get((number, label), 0)
        either = self.pixels(label) + (0 if number is None else self.drawn.get(number, 0)) - both
        return both / either if either else 0.0

    def shows(self, number: int | None, label: int) -> bool:
        """Tell whether the mask shows a label; without one, whether the object matched to it is drawn."""
        if self.shared is None:
            return number is not None and self.drawn.get(number, 0) >= MIN_PIXELS
        return self.pixels(label) >= MIN_PIXELS

    def T_world_object(self, label: int) -> Pose | None:
        """Return the true pose of an object in the frame of the background, or None."""
        if self.T_world_camera is None or label not in self.true:
            return None
        return self.T_world_camera @ self.true[label]


def matched(shared: Mapping[tuple[int, int], int], drawn: Mapping[int, int]) -> dict[int, int]:
    """Match objects one to one, those that share most pixels first.

    Parameters
    ----------
    shared
        Pixels by number of the object in the stream and label in the reference, over all frames with masks.
    drawn
        Pixels by number, over the same frames. A pair that shares less than a tenth of these is none.

    Returns
    -------
    dict
        Number by label.
    """
    numbers: dict[int, int] = {}
    pairs = [(number, label) for number, label in shared if number and label]
    for number, label in sorted(pairs, key=lambda pair: (-shared[pair], pair)):
        enough = shared[number, label] >= MIN_SHARE * drawn[number]
        if enough and label not in numbers and number not in numbers.values():
            numbers[label] = number
    return numbers


@dataclass(kw_only=True)
class ObjectComparison:
    """Objects of a stream beside those of its reference, frame by frame."""

    _frames: list[_Seen] = field(default_factory=list)
    _camera_known: bool = False

    def add(self, drawn: DecodedFrame, given: Frame) -> None:
        """Compare one frame.

        Raises
        ------
        SequenceError
            If the mask has another size than the labels.
        """
        shared = None if given.mask is None else _shared_pixels(drawn, given.mask)
        counts = np.bincount(drawn.labels.ravel(), minlength=LABELS)
        self._camera_known |= given.T_world_camera is not None
        self._frames.append(
            _Seen(
                index=drawn.index,
                sensor=drawn.sensor,
                number=drawn.number,
                shared=shared,
                drawn={int(number): int(counts[number]) for number in np.flatnonzero(counts) if number},
                T_world_camera=given.T_world_camera,
                true={label: pose for label, pose in given.T_camera_object.items() if label},
                found=drawn.T_camera_object,
            )
        )

    def reference(self) -> list[ObjectQuality] | None:
        """Return how well each object of the reference was found, by rising label; None if it has no masks or poses."""
        if not self._has_masks() and not self._labels():
            return None
        numbers = self.matches()
        return [self._quality(label, numbers.get(label)) for label in self._labels()]

    def spurious(self) -> list[SpuriousObject] | None:
        """Return the objects that frames with a mask show and that are matched to none; None if no frame has a mask."""
        if not self._has_masks():
            return None
        drawn = {number for frame in self._masked() for number in frame.drawn if frame.drawn[number] >= MIN_PIXELS}
        found = []
        for number in sorted(drawn - set(self.matches().values())):
            frames = [frame.index for frame in self._frames if frame.drawn.get(number, 0) >= MIN_PIXELS]
            found.append(SpuriousObject(number=number, frames=len(frames), spans=ranges_of(frames)))
        return found

    def matches(self) -> dict[int, int]:
        """Return the stream's number of each label: by masks, or the same number where no frame has one."""
        if not self._has_masks():
            numbers = {number for frame in self._frames for number in frame.found}
            return {label: label for label in self._labels() if label in numbers}
        shared: Counter[tuple[int, int]] = Counter()
        drawn: Counter[int] = Counter()
        for frame in self._masked():
            shared.update(frame.shared or {})
            drawn.update(frame.drawn)
        return matched(shared, drawn)

    def motion(self) -> dict[int, TrajectoryError]:
        """Return, by number, the error of the camera's trajectory as seen from the object, in frames that show it.

        Of several sensors that one counts which sees the object most often.
        """
        errors = {}
        for label, number in sorted(self.matches().items(), key=lambda item: item[1]):
            posed = self._posed(label, number)
            most = Counter(frame.sensor for frame in posed).most_common(1)
            frames = [frame for frame in posed if frame.sensor == most[0][0]]
            # Seen from the object, a stream's own choice of object frame is a choice of world, which
            # the alignment of trajectories removes.
            if frames:
                errors[number] = trajectory_error(
                    [inverse(frame.true[label]) for frame in frames],
                    [inverse(frame.found[number]) for frame in frames],
                    [frame.number for frame in frames],
                )
        return errors

    def _has_masks(self) -> bool:
        return any(frame.shared is not None for frame in self._frames)

    def _masked(self) -> Iterator[_Seen]:
        return (frame for frame in self._frames if frame.shared is not None)

    def _labels(self) -> list[int]:
        shown = {label for frame in self._masked() for _, label in frame.shared or {} if label}
        return sorted(shown.union(*(frame.true for frame in self._frames)))

    def _quality(self, label: int, number: int | None) -> ObjectQuality:
        masked = [frame for frame in self._masked() if frame.shows(number, label)]
        moved = self._moved(masked, label)
        return ObjectQuality(
            label=label,
            number=number,
            frames=len(masked),
            moved_frames=len(moved),
            iou=_mean(frame.iou(number, label) for frame in masked),
            moved_iou=_mean(frame.iou(number, label) for frame in moved),
            pose=None if number is None else self._pose(label, number),
        )

    def _moved(self, frames: Sequence[_Seen], label: int) -> list[_Seen]:
        """Return those of some frames in which an object stands elsewhere than in the first of them."""
        first: dict[int, Pose] = {}
        moved = []
        for frame in frames:
            pose = frame.T_world_object(label) if self._camera_known else frame.true.get(label)
            if pose is not None and _differ(first.setdefault(frame.sensor, pose), pose):
                moved.append(frame)
        return moved

    def _posed(self, label: int, number: int) -> list[_Seen]:
        """Return the frames that show an object and in which both of its poses are known."""
        both = (frame for frame in self._frames if label in frame.true and number in frame.found)
        return [frame for frame in both if frame.shows(number, label)]

    def _pose(self, label: int, number: int) -> ObjectPoseError | None:
        frames = self._posed(label, number)
        if not frames:
            return None
        return object_pose_error([frame.true[label] for frame in frames], [frame.found[number] for frame in frames])


def _shared_pixels(drawn: DecodedFrame, mask: NDArray[np.uint8]) -> dict[tuple[int, int], int]:
    if mask.shape != drawn.labels.shape:
        raise SequenceError(
            f"mask of frame {drawn.index} has shape {mask.shape} and the depth of the stream {drawn.labels.shape};"
            " masks belong to the depth camera"
        )
    counts = np.bincount(drawn.labels.ravel() * np.int64(LABELS) + mask.ravel(), minlength=LABELS * LABELS)
    return {divmod(int(pair), LABELS): int(counts[pair]) for pair in np.flatnonzero(counts)}


def _differ(first: Pose, second: Pose) -> bool:
    between = inverse(first) @ second
    return bool(np.linalg.norm(between[:3, 3]) > MOVED_M or np.degrees(rotation_angle(between)) > MOVED_DEG)


def _mean(values: Iterable[float]) -> float | None:
    listed = list(values)
    return float(np.mean(listed)) if listed else None
