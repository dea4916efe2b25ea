# SPDX-License-Identifier: MIT
"""A body: a connected surface that moves, followed until it is known whether it is an object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.tracking.initial_poses import predict
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.encoder.tracking.tracker import Tracker
from threedvc.geometry.pose import Pose, inverse

__all__ = ["HUES", "LOST_FRAMES", "Body"]

LOST_FRAMES = 5
HUES = 4
"""Parts of each channel that colours are counted by."""
LEAST_ALIKE = 0.4


class Body:
    """What may become an object: a model, where it was found, and how well it fitted."""

    def __init__(self, number: int, born: int, voxel_size_m: float, tracker: Tracker) -> None:
        self.number, self.born = number, born
        self.model = EvidenceModel(voxel_size_m)
        self.tracker = tracker
        self.found: dict[int, TrackedPose] = {}
        self.fit: dict[int, float] = {}
        self.passing: dict[int, float] = {}
        self.pixels: dict[int, int] = {}
        self.hues = np.zeros(HUES**3)
        self.gone = False
        self.proved: int | None = None
        self.radius = 0.0
        self.lost = 0
        self.dead = False
        self.same_as: Body | None = None
        self.compared_next = 0

    def looks_like(self, hues: NDArray[np.float64]) -> bool:
        """Tell whether enough of its colours are those counted in a histogram (HUES^3,)."""
        sums = float(self.hues.sum()), float(hues.sum())
        return not all(sums) or float(np.minimum(self.hues / sums[0], hues / sums[1]).sum()) > LEAST_ALIKE

    @property
    def last(self) -> int:
        """The last frame in which it was found."""
        return max(self.found)

    @property
    def active(self) -> bool:
        """Whether it is being followed."""
        return not self.dead and self.lost <= LOST_FRAMES

    def become(self, old: Body, frame: int) -> None:
        """Turn out to be another body, which was found in a frame where this one was found, too."""
        change = inverse(self.found[frame].T_camera_object) @ old.found[frame].T_camera_object
        for k, at in self.found.items():
            if k not in old.found:
                old.found[k] = replace(at, T_camera_object=at.T_camera_object @ change)
        self.same_as, self.dead, self.gone = old, True, True

    def pose_of(self, frame: int) -> Pose | None:
        """Return T_camera_object where it was found."""
        at = self.found.get(frame)
        return None if at is None or not at.usable else at.T_camera_object

    def predicted(self, frame: int) -> Pose:
        """Return where it goes on to with its last velocity, where that is known."""
        last = self.last
        before = self.pose_of(last - 1)
        here = self.found[last].T_camera_object
        return here if before is None or frame - last > 2 else predict(before, here)
