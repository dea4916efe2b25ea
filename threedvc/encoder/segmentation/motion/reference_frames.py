# SPDX-License-Identifier: MIT
"""Which frames are kept, and which of them are asked what they saw of another one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from threedvc.geometry.pose import Pose

__all__ = ["NEAR_OFFSETS", "ReferenceFrames"]

NEAR_OFFSETS = tuple(k * (k + 1) // 2 for k in range(2, 15))
"""Frames apart of those that are asked, before and after: 3, 6, 10, ... 105. Gaps grow by one, so that what moves fast
and what moves slowly both meet frames in which they were elsewhere; some two dozen questions a point are affordable."""
LANDMARK_STRIDE = 4
"""Frames apart, at first, of the landmarks: frames that all others ask while the camera rests."""
MAX_LANDMARKS = 16
"""Landmarks, before every other one is dropped: with those near in time each point is put about forty questions."""
MAX_KEPT = 800
"""Depth pictures of a file that are kept: 256 MB of them, at four bytes for each of the 80,000 working pixels."""


class ReferenceFrames:
    """The frames that others are held against: those near in time, and landmarks in all of the sequence.

    Parameters
    ----------
    frame_count
        Frames of the sequence, None if it is not known.
    """

    def __init__(self, frame_count: int | None) -> None:
        count = frame_count or 0
        self._stride = 1 + count // MAX_KEPT
        self._landmark_stride = self._stride * LANDMARK_STRIDE
        while count > MAX_LANDMARKS * self._landmark_stride:
            self._landmark_stride *= 2

    def holds(self, frame: int) -> bool:
        """Tell whether a frame is one that others may be held against."""
        return frame % self._stride == 0

    def of(self, frame: int, poses: Sequence[Pose | None]) -> list[int]:
        """Return the frames to ask about a frame, given T_camera_world of all frames so far."""
        near = {frame + sign * k for k in NEAR_OFFSETS for sign in (-1, 1)}
        chosen = {k - k % self._stride for k in near}
        pose = poses[frame]
        for k in range(0, len(poses), self._landmark_stride):
            there = poses[k]
            if pose is not None and there is not None and np.array_equal(pose, there):
                chosen.add(k)
        return sorted(k for k in chosen if 0 <= k < len(poses) and k != frame)

    def take_outdated(self, frame: int, count: int) -> list[int]:
        """Return what nobody will ask for any more, all of `count` frames up to `frame` being segmented.

        Every other landmark is among them when there are too many; these are landmarks no longer.
        """
        old = frame - NEAR_OFFSETS[-1] - 1
        outdated = [old] if old % self._landmark_stride else []
        while count > MAX_LANDMARKS * self._landmark_stride:
            outdated += range(self._landmark_stride, old, 2 * self._landmark_stride)
            self._landmark_stride *= 2
        return outdated
