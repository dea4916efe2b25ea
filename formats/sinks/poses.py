# SPDX-License-Identifier: MIT
"""The text of ``poses.txt`` in the plain layout."""

from __future__ import annotations

from collections.abc import Iterable

from threedvc.geometry.pose import Pose, quaternion

__all__ = ["pose_lines"]

HEADING = "# frame tx ty tz qx qy qz qw, T_world_camera, meters"


def pose_lines(poses: Iterable[tuple[int, Pose | None]]) -> list[str]:
    """Return the lines of numbered T_world_camera; that of a pose which is not known has the number alone."""
    lines = [HEADING]
    for frame, pose in poses:
        values = [] if pose is None else [*pose[:3, 3], *quaternion(pose[:3, :3])]
        # Adding zero makes negative zeros positive.
        lines.append(" ".join([str(frame), *(f"{value + 0.0:.12f}" for value in values)]))
    return lines
