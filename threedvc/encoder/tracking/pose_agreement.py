# SPDX-License-Identifier: MIT
"""Camera poses that come with a recording: do they agree with its depth?

Poses are written in many conventions, and a wrong one gives a stream that is wrong everywhere. So a few pairs of frames
are held against each other before encoding: points of one are moved into the other under the given poses, and their
depth is compared with what was measured there. If much more of it disagrees than under another reading of the same
poses, or than after a short registration of the two frames, the poses are not what they are taken for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.tracking.pair_registration import PairRegistration, unlabeled_pixels
from threedvc.frames.frame import Frame
from threedvc.frames.sequence import FactualSequence, FrameSequence
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.geometry.pose_readings import COMBINED, TRIED_READINGS, PoseReading, pose_reading

__all__ = ["PoseAgreement", "measure_agreement"]

PLACES = 6
"""Places of a recording that are looked at; a few are enough, for a wrong convention is wrong everywhere."""
GAPS = (1, 4, 16)
"""Frames between the two of a pair: slow cameras show a wrong convention only over more of them."""
TOLERANCE = 0.03
"""Share of the depth by which two frames may differ: sensors scatter by 1 % or less, wrong poses by more than 5."""
MIN_IN_VIEW = 0.2
"""Where less of a frame is in the view of its neighbor, the poses say that they do not see the same place."""
MIN_POINTS = 300
"""Shares of fewer points are told to no better than some percent."""
MARGIN = 0.12
"""Poses of good recordings disagree on up to .07 more of the depth than a registration of neighbors does."""
MIN_RATIO = 3.0
"""And so many times as much: where depth is bad everywhere, a margin alone would blame the poses."""
OTHER_MOTION, OTHER_MARGIN = 0.5, 0.03
"""Less is enough where the poses also move the frames otherwise than a registration does, by this share of the motion:
good recordings come to .3, but those whose depth no rigid motion explains to .9."""
SAME_MOTION = 0.3
"""Poses that move a frame as a registration does differ from it by less than this share of the motion."""
AS_GOOD = 0.03
"""A reading explains the poses if no more of the depth than this disagrees beyond the best that can be had."""
MAX_SHIFT = 30
"""Frames by which the poses' clock is tried to be early or late: a second of a common recording."""


@dataclass(frozen=True, kw_only=True)
class PoseAgreement:
    """How much of the depth of neighboring frames disagrees under their poses, as shares of 0 to 1.

    Attributes
    ----------
    as_given
        Under the poses as they are.
    readings
        Under other readings, by name; only those that move the frames as the registration does.
    registered
        After a short registration of the frames; None where that found nothing.
    motion_error
        Median of what the motions of registered frames differ from the given ones by, over the motions themselves.
    shift
        Number of frames by which the poses seem to be those of later frames (earlier ones, if negative), and what
        disagrees if they are moved; None if that was not looked for or does not explain them.
    """

    as_given: float
    readings: Mapping[str, float] = field(default_factory=dict)
    registered: float | None = None
    motion_error: float = 0.0
    shift: tuple[int, float] | None = None

    @property
    def best(self) -> float:
        """The least that disagrees under anything but the poses as given."""
        return min([*self.readings.values(), *([] if self.registered is None else [self.registered])], default=1.0)

    @property
    def contradicts(self) -> bool:
        """Whether the poses cannot be right."""
        margin = OTHER_MARGIN if self.motion_error >= OTHER_MOTION else MARGIN
        return self.as_given > self.best + margin and self.as_given > MIN_RATIO * self.best

    @property
    def reading(self) -> PoseReading | None:
        """The simplest reading that explains the poses, if one does."""
        good = [name for name, share in self.readings.items() if share <= self.best + AS_GOOD]
        if not good or not self.contradicts:
            return None
        return pose_reading(min(good, key=lambda name: (name.count(COMBINED), self.readings[name])))

    @property
    def explanation(self) -> str:
        """What is wrong and what to do about it, for a message."""
        given = f"{_percent(self.as_given)} of the depth disagrees between neighboring frames"
        if self.reading is not None:
            read_so = _percent(self.readings[self.reading.name])
            return f"poses look {self.reading.meaning}: {given}, {read_so} if read so; use --poses {self.reading.name}"
        if self.shift is not None:
            frames, share = self.shift
            late = f"{abs(frames)} frame{'s' if abs(frames) > 1 else ''} {'later' if frames > 0 else 'earlier'}"
            return (
                f"poses look like those of {late}: {given}, {_percent(share)} if moved; correct their numbers or times"
            )
        least = self.best if self.registered is None else self.registered
        return f"poses contradict the depth: {given}, {_percent(least)} where it is registered; correct or remove them"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.1f} %"


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two frames with poses: points (n, 3) of the first, and where a registration finds it: T_second_first or None."""

    positions: tuple[int, int]
    T_world_first: Pose
    T_world_second: Pose
    second: Frame
    points: NDArray[np.float64]
    camera: Camera
    registered: Pose | None

    def given(self, reading: PoseReading | None = None) -> Pose:
        """Return T_second_first by the given poses, as a reading has them."""
        return _relative(self.T_world_first, self.T_world_second, reading)

    def disagreement(self, T_second_first: Pose) -> float:
        """Return the share of the points that do not meet what the second frame measured, or NaN."""
        moved = self.points @ T_second_first[:3, :3].T + T_second_first[:3, 3]
        moved = moved[moved[:, 2] > 0]
        pixels = np.rint(self.camera.project(moved)) if len(moved) else np.zeros((0, 2))
        inside = ((pixels >= 1) & (pixels < [self.camera.width - 1, self.camera.height - 1])).all(axis=1)
        if np.count_nonzero(inside) < MIN_IN_VIEW * len(self.points):
            return 1.0
        columns, rows = pixels[inside].astype(int).T
        distances = _distances(
            np.where(unlabeled_pixels(self.second), self.second.depth, 0), rows, columns, moved[inside, 2]
        )
        known = np.isfinite(distances)
        return float((distances[known] > TOLERANCE).mean()) if known.any() else float("nan")


def _distances(
    depth: NDArray[np.float32], rows: NDArray[np.int64], columns: NDArray[np.int64], z: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how far depths `z` (n,) are from the nearest measurement about their pixels, over z; inf without one."""
    nearest = np.full(len(z), np.inf)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            measured = depth[rows + down, columns + right]
            distance = np.abs(measured - z) / z
            nearest = np.where(measured > 0, np.minimum(nearest, distance), nearest)
    return nearest


def _relative(first: Pose, second: Pose, reading: PoseReading | None = None) -> Pose:
    """Return T_second_first of two frames with these T_world_camera."""
    if reading is not None:
        first, second = reading.convert(first), reading.convert(second)
    return compose(inverse(second), first)


def measure_agreement(frames: FrameSequence, threads: int = 1) -> PoseAgreement | None:
    """Hold a few pairs of neighboring frames against each other under their given camera poses.

    Parameters
    ----------
    frames
        A sequence, of which some frames have a ``T_world_camera``. About 24 of them are read.
    threads
        Number of threads of the registration.

    Returns
    -------
    PoseAgreement or None
        For that distance between the frames of a pair at which the poses look worst against the best alternative;
        None where no two frames can be compared.
    """
    registrar = PairRegistration(frames.info.rigs[0], threads)
    read: dict[int, Frame] = {}

    def frame(index: int) -> Frame:
        if index not in read:
            read[index] = frames[index]
        return read[index]

    measured: list[tuple[PoseAgreement, Sequence[_Pair]]] = []
    for gap in GAPS:
        pairs: Sequence[_Pair] = list(_pairs(frame, len(frames), gap * len(frames.info.rigs), registrar))
        agreement = _agreement(pairs)
        if agreement is not None:
            measured.append((agreement, pairs))
    if not measured:
        return None
    worst, pairs = max(measured, key=lambda each: each[0].as_given - each[0].best)
    if worst.contradicts and worst.reading is None and isinstance(frames, FactualSequence):
        poses = [facts.T_world_camera for facts in frames.facts()]
        return replace(worst, shift=_shift(pairs, poses, worst.best))
    return worst


def _pairs(frame: Callable[[int], Frame], count: int, gap: int, registrar: PairRegistration) -> Iterator[_Pair]:
    """Yield pairs of frames of the first sensor with poses and depth, spread over the sequence."""
    if gap >= count:
        return
    for start in np.unique(np.linspace(0, count - 1 - gap, PLACES).astype(int)).tolist():
        first, second = frame(start), frame(start + gap)
        T_world_first, T_world_second = first.T_world_camera, second.T_world_camera
        if T_world_first is None or T_world_second is None or first.sensor or second.sensor:
            continue
        points = registrar.points(first)
        if len(points) >= MIN_POINTS and np.count_nonzero(second.depth) >= MIN_POINTS:
            found = registrar.motion(first, second)
            places = start, start + gap
            yield _Pair(places, T_world_first, T_world_second, second, points, registrar.rig.depth, found)


def _agreement(pairs: Sequence[_Pair]) -> PoseAgreement | None:
    """Measure pairs of one distance, those alone that can be registered if these are half of them."""
    sure = [pair for pair in pairs if pair.registered is not None]
    chosen = sure if 2 * len(sure) >= len(pairs) else pairs
    as_given = _mean(pair.disagreement(pair.given()) for pair in chosen)
    if as_given is None:
        return None
    plausible = [reading for reading in TRIED_READINGS if chosen is not sure or _is_plausible(sure, reading)]
    readings = {reading.name: _mean(pair.disagreement(pair.given(reading)) for pair in chosen) for reading in plausible}
    registered = _mean(pair.disagreement(pair.registered) for pair in chosen if pair.registered is not None)
    return PoseAgreement(
        as_given=as_given,
        readings={name: share for name, share in readings.items() if share is not None},
        registered=registered if chosen is sure else None,
        motion_error=_median_motion_error(sure) if chosen is sure else 0.0,
    )


def _is_plausible(pairs: Sequence[_Pair], reading: PoseReading) -> bool:
    """Tell whether poses, read so, move the frames of registered pairs about as the registration does."""
    errors, motions = zip(*_motions(pairs, reading), strict=True)
    return bool(sum(errors) <= SAME_MOTION * sum(motions))


def _median_motion_error(pairs: Sequence[_Pair]) -> float:
    """Return the median of what given motions are off by over the motions, 0 for a camera at rest."""
    return float(np.median([error / motion for error, motion in _motions(pairs) if motion] or [0.0]))


def _motions(pairs: Sequence[_Pair], reading: PoseReading | None = None) -> Iterator[tuple[float, float]]:
    """Yield for registered pairs by how much the poses are off, and the motion: medians over depth."""
    for pair in pairs:
        if pair.registered is None:
            continue
        found, read = (pair.points @ T[:3, :3].T + T[:3, 3] for T in (pair.registered, pair.given(reading)))
        error, motion = found - read, found - pair.points
        depth = pair.points[:, 2]
        yield (
            float(np.median(np.linalg.norm(error, axis=1) / depth)),
            float(np.median(np.linalg.norm(motion, axis=1) / depth)),
        )


def _shift(pairs: Sequence[_Pair], poses: Sequence[Pose | None], best: float) -> tuple[int, float] | None:
    """Return by how many frames the poses (one for each frame) are off, and what disagrees once they are moved."""
    found: dict[int, float] = {}
    for shift in range(-MAX_SHIFT, MAX_SHIFT + 1):
        shares = []
        for pair in pairs:
            first, second = (place - shift for place in pair.positions)
            if not (0 <= first < len(poses) and 0 <= second < len(poses)):
                continue
            T_first, T_second = poses[first], poses[second]
            if T_first is not None and T_second is not None:
                shares.append(pair.disagreement(_relative(T_first, T_second)))
        share = _mean(shares)
        if share is not None and 2 * len(shares) >= len(pairs):
            found[shift] = share
    likeliest = min(found, key=lambda shift: (found[shift], abs(shift)), default=0)
    return (likeliest, found[likeliest]) if likeliest and found[likeliest] <= best + AS_GOOD else None


def _mean(shares: Iterable[float]) -> float | None:
    """Return the mean of those that are numbers; None if none is."""
    known = [share for share in shares if np.isfinite(share)]
    return float(np.mean(known)) if known else None
