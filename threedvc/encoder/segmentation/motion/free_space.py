# SPDX-License-Identifier: MIT
"""Votes of free space: the evidence by which things that move are told from those that stand still.

A point that some other frame saw through was not there at that time, if it belongs to what the pose of that frame is
taken against: so it does not move with it. `DepthHistory` keeps the depth of frames and counts their votes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats, Mask
from threedvc.encoder.fusion.integration import camera_parameters
from threedvc.encoder.registration.registration_types import camera_rays
from threedvc.encoder.segmentation.motion.morphology import grown, square
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse
from threedvc.kernels.encoder.free_space import OtherFrames, count_free_space_votes, measure_misfits
from threedvc.parallel import for_ranges

__all__ = ["DepthHistory", "FreeSpaceVotes"]

UNIT_M = 0.0002
"""Step of the depth that is kept: a fifth of a millimeter is below the noise of any sensor, and 16 bits of it reach 13
meters."""
MAX_UNITS = int(np.iinfo(np.uint16).max)
WINDOW = 5
"""Side in pixels of the surroundings of which the least and the largest depth count: poses and edges are not exact."""
MIN_KNOWN_SHARE = 0.5
"""Part of such surroundings that must have depth: at the edge of holes the nearest depth may be missing."""
MARGIN_SIGMAS = 4.0
"""Deviations of the sensor within which a point counts as seen: noise hardly ever takes it further."""
MOVING_MARGIN, STILL_MARGIN = 0.015, 0.004
"""Parts of the depth that are added while the camera moves, for errors of poses and calibration, and while it rests."""
MISFIT_SCALES = 5.0
"""Times the median residual of two frames that a point must exceed, so that errors of poses do not count."""
MISFIT_STRIDE = 6
"""Pixels apart of those that tell the median residual of frames: some two thousand of a picture determine it well."""
MIN_MISFIT_POINTS = 60
"""Points that a median is taken of; frames that share fewer tell nothing."""
UNKNOWN_MISFIT = 1.0
"""Median residual, in parts of the depth, of frames that share too little: nothing is seen through by such a margin."""
FIRST_SLOTS = 128
"""Pictures that there is room for at first: what a live encoder keeps, 105 frames back and 16 landmarks."""


class FreeSpaceVotes(NamedTuple):
    """How many frames saw through each point of a frame, and how many saw it: (h, w) uint8 each."""

    through: NDArray[np.uint8]
    on: NDArray[np.uint8]


class DepthHistory:
    """Depth pictures of frames, and where their points would be in each other.

    Parameters
    ----------
    camera
        The camera of the pictures.
    sensor
        Noise of the depth.
    threads
        Number of threads; votes do not depend on it.
    """

    def __init__(self, camera: Camera, sensor: SensorModel, threads: int) -> None:
        self._camera, self._sensor, self._threads = camera, sensor, threads
        self._pictures = np.empty((FIRST_SLOTS, camera.height, camera.width, 2), np.uint16)
        self._slots: dict[int, int] = {}
        self._free = list(range(FIRST_SLOTS))

    def keep(self, frame: int, depth: Floats) -> None:
        """Keep the depth (h, w) of a frame in meters."""
        units = np.rint(depth / UNIT_M)
        known = (units > 0) & (units < MAX_UNITS)
        near = cv2.erode(np.where(known, units, MAX_UNITS).astype(np.uint16), square(WINDOW))
        far = cv2.dilate(np.where(known, units, 0).astype(np.uint16), square(WINDOW))
        enough = cv2.blur(known.astype(np.float32), (WINDOW, WINDOW)) > MIN_KNOWN_SHARE
        slot = self._slot(frame)  # may replace the pictures
        picture = self._pictures[slot]
        picture[..., 0], picture[..., 1] = np.where(enough & known, near, 0), np.where(enough & known, far, 0)

    def _slot(self, frame: int) -> int:
        if not self._free:
            count = len(self._pictures)
            self._pictures = np.concatenate([self._pictures, np.empty_like(self._pictures)])
            self._free = list(range(count, 2 * count))
        self._slots[frame] = self._free.pop()
        return self._slots[frame]

    def forget(self, frame: int) -> None:
        """Drop a frame, if it is there."""
        slot = self._slots.pop(frame, None)
        if slot is not None:
            self._free.append(slot)

    def count_free_space_votes(
        self,
        depth: Floats,
        mask: Mask,
        pose: Pose,
        frames: Iterable[int],
        pose_of: Callable[[int], Pose | None],
        *,
        whole: bool = True,
        sparse: bool = False,
    ) -> FreeSpaceVotes:
        """Count how many of some frames saw through the points of a frame, and how many saw them.

        Parameters
        ----------
        depth, mask
            (h, w) depth of the frame in meters, and the pixels to ask for.
        pose
            T_camera_object of the frame for what the points are taken to belong to.
        frames
            Frames to ask, of those that are kept.
        pose_of
            Gives T_camera_object of any of them, or None.
        whole
            Whether most of the frame belongs to the object: then frames that do not fit it well count less.
        sparse
            Whether every other pixel of every other row is asked for first, and others only near those that were seen
            through. What is three pixels wide is found like that.

        Returns
        -------
        FreeSpaceVotes
            0 at other pixels.
        """
        asked = [(k, at) for k in frames if k in self._slots and (at := pose_of(k)) is not None]
        votes = FreeSpaceVotes(np.zeros(depth.shape, np.uint8), np.zeros(depth.shape, np.uint8))
        if not asked:
            return votes
        T = np.stack([at @ inverse(pose) for _, at in asked])
        slots = np.array([self._slots[k] for k, _ in asked])
        still = np.array([np.array_equal(at, pose) for _, at in asked])
        margins = self._margins(depth, T, slots, still, whole)
        rays, others = camera_rays(self._camera), self._others(T, slots)

        def ask(some: Mask) -> None:
            def work(start: int, stop: int) -> None:
                count_free_space_votes(depth, rays, some, others, margins, *votes, start, stop)

            for_ranges(work, len(depth), self._threads)

        if not sparse:
            ask(mask)
            return votes
        first = np.zeros_like(mask)
        first[::2, ::2] = mask[::2, ::2]
        ask(first)
        ask(mask & grown(votes.through > 0, 2) & ~first)
        return votes

    def _others(self, T: Doubles, slots: NDArray[np.int64]) -> OtherFrames:
        return OtherFrames(T, self._pictures, slots, UNIT_M, camera_parameters(self._camera))

    def _margins(self, depth: Floats, T: Doubles, slots: NDArray[np.int64], still: Mask, whole: bool) -> Doubles:
        """Return the margins (n, 3) of the votes for frames before a camera that stands still or not."""
        s = self._sensor
        margins = np.tile(
            MARGIN_SIGMAS * np.array([s.s0_m, s.s1, s.s2_per_m + s.quantum_per_m / np.sqrt(12)]), (len(T), 1)
        )
        moving = np.full(len(T), MOVING_MARGIN)
        if whole and not still.all():
            residuals = self._median_residuals(depth, T[~still], slots[~still])
            moving[~still] = np.maximum(MOVING_MARGIN, MISFIT_SCALES * residuals)
        margins[:, 1] += np.where(still, STILL_MARGIN, moving)
        return margins

    def _median_residuals(self, depth: Floats, T: Doubles, slots: NDArray[np.int64]) -> Doubles:
        """Return the median relative distance (n,) of the points from the surfaces of other frames."""
        small = depth[::MISFIT_STRIDE, ::MISFIT_STRIDE]
        known = small > 0
        z = small[known].astype(np.float64)
        rays = camera_rays(self._camera)[::MISFIT_STRIDE, ::MISFIT_STRIDE][known]
        points = np.column_stack([rays * z[:, None], z])
        residuals, others = np.empty((len(T), len(points))), self._others(T, slots)

        def work(start: int, stop: int) -> None:
            measure_misfits(points, others, residuals, start, stop)

        for_ranges(work, len(T), self._threads)
        shared = [row[np.isfinite(row)] for row in residuals]
        return np.array([np.median(row) if len(row) >= MIN_MISFIT_POINTS else UNKNOWN_MISFIT for row in shared])
