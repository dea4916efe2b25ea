# SPDX-License-Identifier: MIT
"""A room filmed from near by a sensor that guesses depth between few measurements: smooth, wrong anew in each frame."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from helpers.streams import ListSequence
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import Pose, make_pose
from threedvc.synthesis import SyntheticSequence, make_scene

__all__ = ["nonrigid_sequence"]

CLOSER = 0.1
KNOTS = 4, 5
CALM = 0.8


@cache
def nonrigid_sequence(
    frames: int, size: tuple[int, int] = (96, 72), share: float = 0.03, part: float = 1.0
) -> ListSequence:
    """Return frames of a small room whose depth is off by a smooth field, that much of it on an average.

    `part` is the share of the columns, from the left, in which it is off.
    """
    source = SyntheticSequence(make_scene("room", frames=frames, size=size))
    rng = np.random.default_rng(7)
    field = rng.normal(size=KNOTS)
    kept = []
    for frame in source:
        field = CALM * field + np.sqrt(1 - CALM**2) * rng.normal(size=KNOTS)
        off = cv2.resize(field, size, interpolation=cv2.INTER_CUBIC)
        off[:, round(part * size[0]) :] = 0
        depth = CLOSER * frame.depth * (1 + share * off)
        kept.append(replace(frame, depth=depth.astype(np.float32), T_world_camera=_closer(frame)))
    return ListSequence(kept, replace(source.info, frame_count=frames, depth_scale=10_000.0))


def _closer(frame: Frame) -> Pose:
    assert frame.T_world_camera is not None
    shift: NDArray[np.float64] = CLOSER * frame.T_world_camera[:3, 3]
    return make_pose(frame.T_world_camera[:3, :3], shift)
