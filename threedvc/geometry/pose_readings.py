# SPDX-License-Identifier: MIT
"""What written camera poses may stand for: conventions differ in direction, axes, units and order of quaternions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

import numpy as np

from threedvc.errors import ConfigError
from threedvc.geometry.pose import Pose, compose, inverse, make_pose, quaternion, rotation_from_quaternion
from threedvc.units import MILLIMETERS

__all__ = ["AS_GIVEN", "COMBINED", "TRIED_READINGS", "PoseReading", "pose_reading", "reading_names"]

AS_GIVEN = "as-given"
COMBINED = "+"
OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
"""Camera axes of OpenGL (x right, y up, z back) in ours."""
BODY_AXES = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Our camera axes in those of a robot's body (x forward, y left, z up)."""
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
"""Changes between a right-handed and a left-handed world whose y axis points up, as game engines have it."""

Convert: TypeAlias = Callable[[Pose], Pose]


def _w_first(pose: Pose) -> Pose:
    """Return the pose whose quaternion was written w x y z, but read x y z w."""
    first, second, third, fourth = quaternion(pose[:3, :3])
    return make_pose(rotation_from_quaternion(np.array([second, third, fourth, first])), pose[:3, 3])


def _units(per_meter: float) -> Convert:
    return lambda pose: make_pose(pose[:3, :3], pose[:3, 3] / per_meter)


@dataclass(frozen=True)
class PoseReading:
    """What a written pose is taken for.

    Attributes
    ----------
    name
        What a user calls it.
    meaning
        What the poses are then taken to be, for messages.
    convert
        Turns a pose that was read as T_world_camera in meters, with x y z w quaternions, into what it stands for.
    """

    name: str
    meaning: str
    convert: Convert


_BASIC = (
    PoseReading("w-first", "written w x y z", _w_first),
    PoseReading("millimeters", "to be in millimeters", _units(MILLIMETERS)),
    PoseReading("centimeters", "to be in centimeters", _units(100)),
    PoseReading("inverted", "like world-to-camera", inverse),
    PoseReading(
        "opengl", "like those of a camera with OpenGL axes (y up, z back)", lambda pose: compose(pose, OPENGL_AXES)
    ),
    PoseReading("body", "like those of a body with x forward, y left, z up", lambda pose: compose(pose, BODY_AXES)),
    PoseReading("left-handed", "like those of a left-handed world (y up)", lambda pose: MIRROR @ pose @ MIRROR),
)
"""In the order in which they are applied: numbers first, then which frame is meant, then its axes."""
_COMBINATIONS = (
    ("inverted", "opengl"),
    ("millimeters", "inverted"),
    ("millimeters", "opengl"),
    ("millimeters", "body"),
    ("centimeters", "inverted"),
    ("centimeters", "opengl"),
    ("w-first", "millimeters"),
    ("w-first", "inverted"),
    ("w-first", "opengl"),
    ("w-first", "body"),
    ("millimeters", "inverted", "opengl"),
    ("w-first", "inverted", "opengl"),
    ("w-first", "millimeters", "inverted"),
)
"""Combinations that are tried when poses disagree; a user may ask for any."""


def reading_names() -> tuple[str, ...]:
    """Return the names of the basic readings; several are joined by ``+``."""
    return AS_GIVEN, *(reading.name for reading in _BASIC)


def pose_reading(name: str) -> PoseReading:
    """Return the reading of a name such as ``inverted`` or ``millimeters+opengl``.

    Raises
    ------
    ConfigError
        If there is none of that name.
    """
    if name == AS_GIVEN:
        return PoseReading(AS_GIVEN, "as given", lambda pose: pose)
    asked = name.split(COMBINED)
    chosen = [reading for reading in _BASIC if reading.name in asked]
    if len(chosen) != len(asked):
        raise ConfigError(
            f"--poses {name}: no such reading; choose from {', '.join(reading_names())}, or join several by {COMBINED}"
        )

    def convert(pose: Pose) -> Pose:
        return reduce(lambda so_far, reading: reading.convert(so_far), chosen, pose)

    return PoseReading(COMBINED.join(each.name for each in chosen), ", ".join(each.meaning for each in chosen), convert)


TRIED_READINGS = tuple(
    pose_reading(COMBINED.join(names)) for names in (*((reading.name,) for reading in _BASIC), *_COMBINATIONS)
)
"""What poses that disagree with the depth are tried for, the simplest first."""
