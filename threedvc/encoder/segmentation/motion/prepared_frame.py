# SPDX-License-Identifier: MIT
"""Frames prepared for segmentation: what moves in them, and how far their depth is from that of models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats, Labels, Mask
from threedvc.encoder.fusion.integration import Observation, observe
from threedvc.encoder.registration.frame_resolutions import FrameResolutions
from threedvc.encoder.segmentation.motion.morphology import closed, grown, opened
from threedvc.encoder.segmentation.motion.moving_body import MotionHypothesis
from threedvc.encoder.segmentation.motion.segmenter_state import SegmenterState
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import Pose
from threedvc.kernels.encoder.free_space import connect_surfaces

__all__ = [
    "AGREEMENT",
    "COARSE_GATE",
    "FINE_GATE",
    "GATE_SIGMAS",
    "MIN_PIXELS",
    "MIN_VOTES",
    "PreparedFrame",
    "connected_surfaces",
    "prepared_frame",
]

MIN_VOTES = 2
"""Frames that must have seen through a point to say that it moves: a single one may err at an edge."""
MIN_CERTAIN_SHARE = 0.6
"""Part of a surface with any votes that must have enough of them, so that the rest of it is taken to move, too."""
MAX_JUMP = 0.03
"""Step of the depth, in parts of it, between neighbors of one surface: slanted surfaces step by less at two pixels."""
GATE_SIGMAS = 4.0
"""Deviations of the sensor by which a depth may differ from a model's: one in 16,000 differs by more by chance."""
COARSE_GATE, FINE_GATE = 0.03, 0.01
"""Parts of the depth by which it may differ from a model's in addition, at a predicted pose and at one that was found:
15 mm at half a meter, for the prediction may be off by what a thing moves in a frame, and 5 mm."""
MIN_PIXELS = 60
"""Pixels of the smallest surface that is followed: less of it is mostly edge and tells no pose."""
AGREEMENT = 0.7
"""Part of what a model and a frame show of each other that must agree, if they are to show one body."""


@dataclass(eq=False, kw_only=True)
class PreparedFrame:
    """A frame under segmentation.

    Attributes
    ----------
    frame
        The frame, downsampled.
    T_camera_world
        Its camera.
    views, observation
        What registration and fusion take of it.
    moving
        (h, w) whether a pixel belongs to something that moves.
    transience
        (h, w) share of the frames that saw through a pixel, of those that tell about it.
    surfaces
        (h, w) numbers of the connected surfaces of what moves, from 1 on.
    noise_m
        (h, w) how far noise may take the depth.
    labels
        (h, w) numbers of the bodies, 0 = none so far.
    """

    frame: Frame
    T_camera_world: Pose
    views: FrameResolutions
    observation: Observation
    moving: Mask
    transience: Floats
    surfaces: NDArray[np.int32]
    noise_m: Floats
    labels: Labels

    @property
    def index(self) -> int:
        """Number of the frame."""
        return self.frame.index

    @property
    def depth(self) -> Floats:
        """(h, w) meters."""
        return self.frame.depth

    def gate_m(self, share: float) -> Floats:
        """Return by how much (h, w) the depth may differ from a model's: by noise and by a share of itself."""
        return self.noise_m + np.float32(share) * self.depth

    def pixels_of(self, body: MotionHypothesis) -> Mask:
        """Return the pixels (h, w) labeled as a body."""
        return np.asarray(self.labels == body.number, dtype=np.bool_)

    def relabel(self, body: MotionHypothesis, as_body: MotionHypothesis) -> None:
        """Give the pixels of one body to another."""
        self.labels[self.labels == body.number] = as_body.number


def prepared_frame(state: SegmenterState, frame: Frame, pose: Pose) -> PreparedFrame:
    """Ask other frames what moves in a downsampled one, whose T_camera_world is known."""
    depth = frame.depth
    asked = state.reference_frames.of(frame.index, state.poses)
    through, on = state.history.count_free_space_votes(depth, depth > 0, pose, asked, state.pose_of, sparse=True)
    seen_through = _spread_over_surfaces(depth, through)
    moving = closed(seen_through & grown(opened(seen_through), 1)) & (depth > 0)
    sigma = state.sensor.sigma_m(depth.astype(np.float64)).astype(np.float32)
    return PreparedFrame(
        frame=frame,
        T_camera_world=pose,
        views=FrameResolutions(frame, state.full, state.full),
        observation=observe(frame, state.rig, state.rays),
        moving=moving,
        transience=through / np.maximum(through.astype(np.float32) + on, 1),
        surfaces=connected_surfaces(depth, moving),
        noise_m=np.float32(GATE_SIGMAS) * sigma,
        labels=np.zeros(depth.shape, np.uint16),
    )


def _spread_over_surfaces(depth: Floats, through: NDArray[np.uint8]) -> Mask:
    """Return the pixels (h, w) that enough frames saw through, and those of surfaces that are mostly such."""
    certain, likely = through >= MIN_VOTES, through > 0
    surfaces = connected_surfaces(depth, likely)
    sizes = np.maximum(np.bincount(surfaces.ravel()), 1)
    mostly = np.bincount(surfaces.ravel(), certain.ravel()) > MIN_CERTAIN_SHARE * sizes
    return np.asarray(certain | (likely & mostly[surfaces]), dtype=np.bool_)


def connected_surfaces(depth: Floats, mask: Mask) -> NDArray[np.int32]:
    """Number the surfaces (h, w) from 1 on that the pixels of a mask make, 0 elsewhere; they end where depth jumps."""
    surfaces, stack = np.zeros(depth.shape, np.int32), np.empty(depth.size, np.int32)
    connect_surfaces(depth, mask, MAX_JUMP, surfaces, stack)
    return surfaces
