# SPDX-License-Identifier: MIT
"""Poses that come with the input: whether an object has them, and which they are."""

from __future__ import annotations

from collections.abc import Mapping

from threedvc.config import Motion
from threedvc.errors import ConfigError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.pose import Pose, identity, inverse

__all__ = ["known_pose", "motion_of"]


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
