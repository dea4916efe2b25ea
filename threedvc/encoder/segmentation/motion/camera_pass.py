# SPDX-License-Identifier: MIT
"""Where the camera is in each frame, found before the background while what moves is kept out of it."""

from __future__ import annotations

import numpy as np

from threedvc.arrays import Floats, Mask
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import fuse, observe
from threedvc.encoder.registration.frame_resolutions import FrameResolutions, ObjectView
from threedvc.encoder.segmentation.motion.morphology import grown, opened
from threedvc.encoder.segmentation.motion.reference_frames import NEAR_OFFSETS
from threedvc.encoder.segmentation.motion.segmenter_state import FUSION, SegmenterState, cell_size
from threedvc.encoder.tracking.tracker import Tracker
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, identity, inverse

__all__ = ["CameraPass"]

BACKGROUND_CELLS = 2.0
"""By how much wider the background's cells are than those of bodies. Measured together with coarse rays: half the time,
for an ATE of 15.3 mm instead of 12.4 on the kitchen (decision 0016)."""
MIN_STATIC_SHARE = 0.3
"""Part of the picture that must stand still: where most seems to move, the pose is wrong rather."""
MAX_FULL_PIXELS = 60_000
"""Pixels of the largest picture that the camera is found with all of; of larger ones a quarter still are 15,000."""
MOVING_BORDER_PX = 2
"""Pixels about what moves that are kept out, too: it will be near there in the next frame."""


class CameraPass:
    """Finds the camera in one frame after the other.

    Parameters
    ----------
    state
        What is known of the sequence; it is only read.
    known
        Whether frames tell their poses.
    rests
        Whether the camera is known to stand still.
    """

    def __init__(self, state: SegmenterState, *, known: bool, rests: bool = False) -> None:
        self._state, self._known, self._rests = state, known, rests
        size = state.rig.depth
        self._resolution = state.coarse if size.width * size.height > MAX_FULL_PIXELS else state.full
        self._tracker = Tracker(state.sensor, state.threads, recovers=False)
        self._everything = np.ones((size.height, size.width), dtype=np.bool_)
        self._static = self._everything
        self._background: EvidenceModel | None = None

    def locate(self, frame: Frame) -> Pose | None:
        """Return T_camera_world of the next frame, downsampled, and fuse what stands still; None if it is lost."""
        if self._known:
            return None if frame.T_world_camera is None else inverse(frame.T_world_camera)
        if self._rests:
            return identity()
        state, views = self._state, FrameResolutions(frame, self._resolution, self._resolution)
        if self._background is None:
            self._background = EvidenceModel(_background_cell_size(frame.depth, state.rig))
            at = self._tracker.start(ObjectView(views, self._everything), 0, state.rig)
        else:
            at = self._tracker.locate([ObjectView(views, self._static)], self._background)
        if not at.usable:
            self._static = self._everything
            return None
        pose = at.T_camera_object
        static = self._static_pixels(frame, pose)
        observation = observe(frame, state.rig, state.rays)
        fuse(self._background, observation, static, pose, state.sensor, FUSION, state.threads)
        enough = np.count_nonzero(static) > MIN_STATIC_SHARE * static.size
        self._static = static if enough else self._everything
        return pose

    def _static_pixels(self, frame: Frame, pose: Pose) -> Mask:
        """Return the pixels (h, w) that no frame before saw through, nor any near them."""
        state, before = self._state, [frame.index - k for k in NEAR_OFFSETS]
        through, _ = state.history.count_free_space_votes(
            frame.depth, self._everything, pose, before, state.pose_of, sparse=True
        )
        return ~grown(opened(through > 0), MOVING_BORDER_PX)


def _background_cell_size(depth: Floats, rig: CameraRig) -> float:
    """Return a cell that is good enough to find the camera: wider ones, but not where most is much nearer than some."""
    known = depth > 0
    return max(BACKGROUND_CELLS * cell_size(depth, known, rig, 50), cell_size(depth, known, rig))
