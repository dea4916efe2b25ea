# SPDX-License-Identifier: MIT
"""What the segmentation by motion knows of a sequence so far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threedvc.arrays import Floats, Mask
from threedvc.config import EncoderConfig, FusionConfig
from threedvc.encoder.registration.frame_resolutions import Downsampled
from threedvc.encoder.registration.model_view import raycast_model
from threedvc.encoder.segmentation.motion.downsampling import Downsampling
from threedvc.encoder.segmentation.motion.free_space import DepthHistory
from threedvc.encoder.segmentation.motion.moving_body import MotionHypothesis
from threedvc.encoder.segmentation.motion.reference_frames import ReferenceFrames
from threedvc.frames.depth_limit import limited_depth
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose

__all__ = ["FUSION", "SegmenterState", "cell_size"]

CELL_PIXELS = 2.0
"""Pixels that a cell covers: fewer cells are quicker, and models need be no finer than to be recognized by."""
MIN_CELL_M = 0.002
"""Edge of the smallest cells: below it they would follow the noise of most sensors."""
CELL_DISTANCE_PERCENTILE = 75
"""Percentile of the depth that cells are chosen for: most of what is seen gets cells of so many pixels, or larger."""
FUSION = FusionConfig()
"""As for objects with masks."""


class SegmenterState:
    """Cameras, poses of the camera, depth of frames and bodies of a sequence that is segmented by motion.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.
    sensor
        Noise of the depth.
    downsampling
        Brings frames to the working resolution.

    Attributes
    ----------
    rig, rays
        Cameras of the downsampled frames, and the (h, w, 2) slopes of their pixels.
    full, coarse
        All of these pixels, and every other one of every other row, as models are seen at.
    poses
        T_camera_world of each frame observed, None where the camera was lost.
    history
        Depth of the frames observed.
    bodies
        All that ever moved, by number from 1 on.
    """

    def __init__(
        self, info: SequenceInfo, config: EncoderConfig, sensor: SensorModel, downsampling: Downsampling
    ) -> None:
        self.sensor, self.threads = sensor, config.threads
        self._max_depth_m = config.max_depth_m
        self._downsampling, self.rig = downsampling, downsampling.rig
        self.rays = self.rig.depth.rays()
        self.full, self.coarse = (Downsampled(self.rig, n, sparse=False, flat=True) for n in (1, 2))
        self.reference_frames = ReferenceFrames(info.frame_count)
        self.history = DepthHistory(self.rig.depth, sensor, config.threads)
        self.poses: list[Pose | None] = []
        self.bodies: list[MotionHypothesis] = []

    def downsampled(self, frame: Frame) -> Frame:
        """Return a frame downsampled, without what is too far to be measured."""
        small = self._downsampling.downsampled(frame)
        return replace(small, depth=limited_depth(small.depth, self._max_depth_m, self.sensor))

    def pose_of(self, frame: int) -> Pose | None:
        """Return T_camera_world of a frame observed, or None."""
        return self.poses[frame] if 0 <= frame < len(self.poses) else None

    def forget(self, frame: int) -> None:
        """Drop what only frames near in time to `frame` would ask for, all frames up to it being segmented."""
        for k in self.reference_frames.take_outdated(frame, len(self.poses)):
            self.history.forget(k)

    def predicted_depth(self, body: MotionHypothesis, pose: Pose) -> Floats:
        """Return the depth (h, w) of a body's model at T_camera_object, 0 where it shows nothing."""
        return raycast_model(body.model, self.full, pose, self.threads).depth

    def coarse_predicted_depth(self, body: MotionHypothesis, pose: Pose) -> Floats:
        """Return the same of a quarter of the rays, each for four pixels."""
        depth, size = raycast_model(body.model, self.coarse, pose, self.threads).depth, self.rig.depth
        return depth.repeat(2, axis=0).repeat(2, axis=1)[: size.height, : size.width]


def cell_size(depth: Floats, mask: Mask, rig: CameraRig, percentile: int = CELL_DISTANCE_PERCENTILE) -> float:
    """Return the edge in meters of a cell that covers about two pixels of what is seen at `mask` (h, w)."""
    seen = depth[mask & (depth > 0)]
    distance = float(np.percentile(seen, percentile)) if len(seen) else 1.0
    return max(round(CELL_PIXELS * distance / rig.depth.fx, 3), MIN_CELL_M)
