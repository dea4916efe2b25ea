# SPDX-License-Identifier: MIT
"""The hypothesis of a body that moves: a connected surface, followed until it is known whether it is an object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threedvc.arrays import Doubles
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.registration.initial_poses import predict
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.encoder.tracking.tracker import Tracker
from threedvc.geometry.pose import Pose, inverse

__all__ = ["COLOR_LEVELS", "MAX_LOST_FRAMES", "MotionHypothesis"]

MAX_LOST_FRAMES = 5
"""Frames in a row that a body may be lost in and still be looked for: a hand before it, or a blurred moment."""
MAX_PREDICTED_FRAMES = 2
"""Frames that a body is thought to go on for with its last velocity: what is predicted further ahead is a guess."""
COLOR_LEVELS = 4
"""Levels of each channel that colors are counted by: coarse, so that light and exposure do not move them."""
MIN_COMMON_COLORS = 0.4
"""Part of two histograms that must be the same in what may be one body: less than half, for other sides show others."""


class MotionHypothesis:
    """What may become an object: a model, where it was found, and how well it fitted.

    Parameters
    ----------
    number
        From 1 on, in order of birth.
    born
        The frame that it was first seen in.
    voxel_size_m
        Edge of the cells of its model.
    radius_m
        Radius of a disk as large as what was first seen of it.
    tracker
        Follows it.

    Attributes
    ----------
    found
        Where it was looked for and found, by frame.
    explained
        By frame, the part of the surfaces connected with it that its model showed.
    transience
        By frame, the mean share of frames that saw through its pixels, of those that tell about them.
    pixels
        By frame, how many it covered.
    color_histogram
        (COLOR_LEVELS^3,) pixels by their color, in all frames.
    gone
        Whether its last place was seen to be empty.
    confirmed_in
        The last frame in which it was found when it turned out to be an object; None if it is none so far.
    lost_frames
        For how many frames in a row it has been lost.
    dropped
        Whether it is no longer followed, for good.
    merged_into
        The body that it turned out to be.
    compared_next
        The frame from which on it may be held against bodies that were lost.
    """

    def __init__(self, number: int, born: int, voxel_size_m: float, radius_m: float, tracker: Tracker) -> None:
        self.number, self.born, self.radius_m = number, born, radius_m
        self.model = EvidenceModel(voxel_size_m)
        self.tracker = tracker
        self.found: dict[int, TrackedPose] = {}
        self.explained: dict[int, float] = {}
        self.transience: dict[int, float] = {}
        self.pixels: dict[int, int] = {}
        self.color_histogram = np.zeros(COLOR_LEVELS**3)
        self.gone = False
        self.confirmed_in: int | None = None
        self.lost_frames = 0
        self.dropped = False
        self.merged_into: MotionHypothesis | None = None
        self.compared_next = 0

    @property
    def last(self) -> int:
        """The last frame in which it was found."""
        return max(self.found)

    @property
    def last_pose(self) -> Pose:
        """T_camera_object where it was found last."""
        return self.found[self.last].T_camera_object

    @property
    def active(self) -> bool:
        """Whether it is being followed."""
        return not self.dropped and self.lost_frames <= MAX_LOST_FRAMES

    @property
    def survivor(self) -> MotionHypothesis:
        """The body that it was merged into, or itself."""
        return self.merged_into or self

    def find(self, frame: int, at: TrackedPose) -> None:
        """Note where it was found in a frame."""
        self.lost_frames = 0
        self.found[frame] = at

    def merge_into(self, old: MotionHypothesis, frame: int) -> None:
        """Turn out to be another body, which was found in a frame where this one was found, too."""
        change = inverse(self.found[frame].T_camera_object) @ old.found[frame].T_camera_object
        for k, at in self.found.items():
            if k not in old.found:
                old.found[k] = replace(at, T_camera_object=at.T_camera_object @ change)
        self.merged_into, self.dropped, self.gone = old, True, True

    def looks_like(self, histogram: Doubles) -> bool:
        """Tell whether enough of its colors are those counted in a histogram (COLOR_LEVELS^3,), or none are known."""
        sums = float(self.color_histogram.sum()), float(histogram.sum())
        if not all(sums):
            return True
        common = np.minimum(self.color_histogram / sums[0], histogram / sums[1])
        return float(common.sum()) > MIN_COMMON_COLORS

    def pose_of(self, frame: int) -> Pose | None:
        """Return T_camera_object where it was found."""
        at = self.found.get(frame)
        return None if at is None or not at.usable else at.T_camera_object

    def predicted(self, frame: int) -> Pose:
        """Return where it goes on to with its last velocity, where that is known."""
        last = self.last
        before, here = self.pose_of(last - 1), self.found[last].T_camera_object
        return here if before is None or frame - last > MAX_PREDICTED_FRAMES else predict(before, here)
