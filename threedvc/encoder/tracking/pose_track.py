# SPDX-License-Identifier: MIT
"""Where objects were found, frame by frame, and how gaps are closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from threedvc.config import Motion
from threedvc.encoder.tracking.registration import Status
from threedvc.errors import ConfigError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.pose import Pose, identity, interpolated, inverse

__all__ = [
    "UNSEEN",
    "Located",
    "Script",
    "along_with_the_room",
    "bridged",
    "joined_parts",
    "known_pose",
    "motion_of",
    "pose_between",
]

SAME_REST = 1e-9
UNSEEN = "unseen"
"""Status of an object that is not in sight, at the pose it is taken to have."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Located:
    """An object's pose in a frame, and how it was found: known, tracked, relocalised, weak, lost or unseen.

    With several sensors T_camera_object is that before the base, which all of them are mounted on. The part is that of
    the model which it was found by, see `Tracker`.
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
    """Return T_camera_object, before the sensor that took the frame, as the input gives it, or None where it does not.

    With `only_label` an object whose number names no pose takes the only one there is: a depth threshold
    finds one object, whatever its label.
    """
    if number == 0:
        return identity() if frame.T_world_camera is None else inverse(frame.T_world_camera)
    poses: Mapping[int, Pose] = frame.T_camera_object
    if number in poses:
        return poses[number]
    return next(iter(poses.values())) if only_label and len(poses) == 1 else None


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


def along_with_the_room(script: Mapping[int, Sequence[Located | None]], before: Script) -> Script:
    """Let tracked objects that rested in the background rest there in a new script, too.

    Parameters
    ----------
    script
        Where everything is in every frame; the background may have other poses than before.
    before
        The same as of the pass before.
    """
    result: Script = {number: list(found) for number, found in script.items()}
    old, new = before.get(0, []), result.get(0, [])
    for number in result.keys() & before.keys() - {0}:
        found, earlier = result[number], before[number]
        for frame in range(1, min(len(found), len(earlier), len(old), len(new))):
            was, then = _moved(old, frame), _moved(new, frame)
            at, last, then_last = earlier[frame], earlier[frame - 1], found[frame - 1]
            here = found[frame]
            if was is None or then is None or at is None or last is None or here is None or then_last is None:
                continue
            if at.status != "known" and np.abs(was @ last.T_camera_object - at.T_camera_object).max() < SAME_REST:
                found[frame] = replace(here, T_camera_object=then @ then_last.T_camera_object)
    return result


def _moved(found: Sequence[Located | None], frame: int) -> Pose | None:
    """Return how an object moved to a frame from the one before; None where that is not known."""
    last, now = found[frame - 1], found[frame]
    if last is None or now is None:
        return None
    if np.array_equal(last.T_camera_object, now.T_camera_object):
        return identity()
    return now.T_camera_object @ inverse(last.T_camera_object)


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


def bridged(found: Sequence[Located | None], blind: Sequence[bool], most: int) -> list[Located | None]:
    """Return located frames with short runs of those without depth on the way between the frames about them.

    What the picture alone says of a pose is worth less than that, but for long ways.

    Parameters
    ----------
    found
        Where an object is in every frame.
    blind
        Whether a frame has no depth.
    most
        Frames of a run at most.
    """
    result, start = list(found), 0
    for stop in range(len(result) + 1):
        if stop < len(result) and blind[stop]:
            continue
        before, after = (found[start - 1] if start else None), (found[stop] if stop < len(result) else None)
        if 0 < stop - start <= most and before is not None and after is not None and _same_part(before, after):
            ends = before.T_camera_object, after.T_camera_object
            for frame in range(start, stop):
                at = found[frame]
                if at is not None and at.status == Status.WEAK:
                    pose = interpolated(*ends, (frame - start + 1) / (stop - start + 1))
                    result[frame] = replace(at, T_camera_object=pose, part=before.part)
        start = stop + 1
    return result


def _same_part(before: Located, after: Located) -> bool:
    return before.usable and after.usable and before.part == after.part
