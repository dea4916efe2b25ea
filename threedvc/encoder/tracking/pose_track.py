# SPDX-License-Identifier: MIT
"""Where objects were found, frame by frame, and how gaps are closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from threedvc.geometry.pose import Pose, identity, interpolated, inverse
from threedvc.stream.pose_status import PoseStatus

__all__ = [
    "PoseTracks",
    "SubmapLink",
    "TrackedPose",
    "carry_resting_objects",
    "interpolate_blind_frames",
    "merge_submaps",
    "pose_between",
]

MAX_ROUNDING = 1e-9
"""An object that was carried along with the background is where that leaves it, but for rounding."""
SubmapLink: TypeAlias = tuple[Pose, int]
"""The motion ``T_submap_other`` of a submap's frame to where another has the same place, and the number of that."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedPose:
    """An object's pose in a frame, and how it was found.

    With several sensors T_camera_object is that before the rig, which all of them are mounted on. The submap is that
    part of the model which it was found by, see `threedvc.encoder.tracking.tracker.Tracker`.
    """

    T_camera_object: Pose
    status: PoseStatus
    submap: int = 0

    @property
    def usable(self) -> bool:
        """Whether the frame may be fused at this pose."""
        return self.status.usable


PoseTracks: TypeAlias = dict[int, list[TrackedPose | None]]
"""Where every object is in every frame, by number; None where it is not."""


def merge_submaps(found: Sequence[TrackedPose | None], links: Mapping[int, SubmapLink]) -> list[TrackedPose | None]:
    """Return located frames with submaps brought to where those that were recognized from them are.

    Parameters
    ----------
    found
        Where an object is in every frame.
    links
        By submap, how it lies to the one that was recognized from it.
    """
    motions = {}
    for submap in links:
        T, at, seen = identity(), submap, set[int]()
        while at in links and at not in seen:
            seen.add(at)
            T, at = T @ links[at][0], links[at][1]
        motions[submap] = T, at
    result: list[TrackedPose | None] = []
    for at_frame in found:
        if at_frame is not None and at_frame.submap in motions:
            T, submap = motions[at_frame.submap]
            at_frame = replace(at_frame, T_camera_object=at_frame.T_camera_object @ T, submap=submap)
        result.append(at_frame)
    return result


def carry_resting_objects(script: Mapping[int, Sequence[TrackedPose | None]], before: PoseTracks) -> PoseTracks:
    """Let tracked objects that rested in the background rest there in a new script, too.

    Parameters
    ----------
    script
        Where everything is in every frame; the background may have other poses than before.
    before
        The same as of the pass before.
    """
    result: PoseTracks = {number: list(found) for number, found in script.items()}
    old, new = before.get(0, []), result.get(0, [])
    for number in result.keys() & before.keys() - {0}:
        found, earlier = result[number], before[number]
        for frame in range(1, min(len(found), len(earlier), len(old), len(new))):
            was, then = _moved(old, frame), _moved(new, frame)
            at, last, then_last = earlier[frame], earlier[frame - 1], found[frame - 1]
            here = found[frame]
            if was is None or then is None or at is None or last is None or here is None or then_last is None:
                continue
            if (
                at.status is not PoseStatus.KNOWN
                and np.abs(was @ last.T_camera_object - at.T_camera_object).max() < MAX_ROUNDING
            ):
                found[frame] = replace(here, T_camera_object=then @ then_last.T_camera_object)
    return result


def _moved(found: Sequence[TrackedPose | None], frame: int) -> Pose | None:
    """Return how an object moved to a frame from the one before; None where that is not known."""
    last, now = found[frame - 1], found[frame]
    if last is None or now is None:
        return None
    if np.array_equal(last.T_camera_object, now.T_camera_object):
        return identity()
    return now.T_camera_object @ inverse(last.T_camera_object)


def pose_between(found: Sequence[TrackedPose | None], frame: int) -> Pose:
    """Return where a lost object was on its way between the frames nearest to it in which it was found.

    Between submaps there is no way: then it was where it was before.
    """
    usable = [(k, at) for k, at in enumerate(found) if at is not None and at.usable]
    before = max((each for each in usable if each[0] < frame), default=None, key=lambda each: each[0])
    after = min((each for each in usable if each[0] > frame), default=None, key=lambda each: each[0])
    if before is None or after is None or before[1].submap != after[1].submap:
        nearest = before or after
        at = nearest[1] if nearest is not None else found[frame]
        return identity() if at is None else at.T_camera_object
    share = (frame - before[0]) / (after[0] - before[0])
    return interpolated(before[1].T_camera_object, after[1].T_camera_object, share)


def interpolate_blind_frames(
    found: Sequence[TrackedPose | None], blind: Sequence[bool], max_run: int
) -> list[TrackedPose | None]:
    """Return located frames with short runs of those without depth on the way between the frames about them.

    What the picture alone says of a pose is worth less than that, but for long ways.

    Parameters
    ----------
    found
        Where an object is in every frame.
    blind
        Whether a frame has no depth.
    max_run
        Frames of a run at most.
    """
    result, start = list(found), 0
    for stop in range(len(result) + 1):
        if stop < len(result) and blind[stop]:
            continue
        before, after = (found[start - 1] if start else None), (found[stop] if stop < len(result) else None)
        if 0 < stop - start <= max_run and before is not None and after is not None and _same_submap(before, after):
            ends = before.T_camera_object, after.T_camera_object
            for frame in range(start, stop):
                at = found[frame]
                if at is not None and at.status is PoseStatus.WEAK:
                    pose = interpolated(*ends, (frame - start + 1) / (stop - start + 1))
                    result[frame] = replace(at, T_camera_object=pose, submap=before.submap)
        start = stop + 1
    return result


def _same_submap(before: TrackedPose, after: TrackedPose) -> bool:
    return before.usable and after.usable and before.submap == after.submap
