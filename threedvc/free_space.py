# SPDX-License-Identifier: MIT
"""What frames saw through: the evidence by which things that move are told from those that stand still.

A point that some other frame saw through was not there at that time, if it belongs to what the pose of that frame is
taken against: so it does not move with it. `Memory` keeps the depth of frames to ask them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.camera import Camera
from threedvc.fusion import camera_parameters
from threedvc.kernels.free_space import count_sights
from threedvc.parallel import for_ranges
from threedvc.pose import Pose, inverse
from threedvc.registration_data import camera_rays
from threedvc.sensor_model import SensorModel

__all__ = ["Memory"]

Counts = NDArray[np.uint8]

UNIT_M = 0.0002
MAX_UNITS = 65535
WINDOW = 5
"""Side in pixels of the surroundings of which the least and the largest depth count: poses and edges are not exact."""
MARGIN_SIGMAS = 4.0
MOVING_MARGIN, STILL_MARGIN = 0.015, 0.004
MISFIT_SCALES = 5.0
"""Times the median distance of two frames from each other that a point must exceed, so that errors of poses do not
count."""
EVERY = 6
LEAST_POINTS = 60


class Memory:
    """Depth pictures of frames, and where their points would be in each other.

    Parameters
    ----------
    camera
        The camera of the pictures.
    sensor
        Noise of the depth.
    threads
        Number of threads; counts do not depend on it.
    """

    def __init__(self, camera: Camera, sensor: SensorModel, threads: int) -> None:
        self.camera = camera
        self._sensor, self._threads = sensor, threads
        self._pictures: dict[int, NDArray[np.uint16]] = {}

    def keep(self, frame: int, depth: NDArray[np.float32]) -> None:
        """Keep the depth (h, w) of a frame in metres."""
        units = np.rint(depth / UNIT_M)
        known = (units > 0) & (units < MAX_UNITS)
        square = np.ones((WINDOW, WINDOW), np.uint8)
        near = cv2.erode(np.where(known, units, MAX_UNITS).astype(np.uint16), square)
        far = cv2.dilate(np.where(known, units, 0).astype(np.uint16), square)
        enough = cv2.blur(known.astype(np.float32), (WINDOW, WINDOW)) > 0.5
        self._pictures[frame] = np.where(enough & known, np.stack([near, far]), 0).astype(np.uint16)

    def forget(self, frame: int) -> None:
        """Drop a frame, if it is there."""
        self._pictures.pop(frame, None)

    def sights(
        self,
        depth: NDArray[np.float32],
        chosen: NDArray[np.bool_],
        pose: Pose,
        others: Iterable[int],
        pose_of: Callable[[int], Pose | None],
        *,
        whole: bool = True,
    ) -> tuple[Counts, Counts]:
        """Count how many of some frames saw through the points of a frame, and how many saw them.

        Parameters
        ----------
        depth, chosen
            (h, w) depth of the frame in metres, and the pixels to ask for.
        pose
            T_camera_object of the frame for what the points are taken to belong to.
        others
            Frames to ask, of those that are kept.
        pose_of
            Gives T_camera_object of any of them, or None.
        whole
            Whether most of the frame belongs to the object: then frames that do not fit it well count less.

        Returns
        -------
        tuple
            (h, w) uint8 each.
        """
        asked = [(k, at) for k in others if k in self._pictures and (at := pose_of(k)) is not None]
        through, on = np.zeros(depth.shape, np.uint8), np.zeros(depth.shape, np.uint8)
        if not asked:
            return through, on
        T = np.stack([at @ inverse(pose) for _, at in asked])
        pictures = np.stack([self._pictures[k] for k, _ in asked], axis=1)
        nearest, furthest = pictures[0], pictures[1]
        s, still = self._sensor, np.array([np.array_equal(at, pose) for _, at in asked])
        noise = MARGIN_SIGMAS * np.array([s.s0_m, s.s1, s.s2_per_m + s.quantum_per_m / np.sqrt(12)])
        margins = np.tile(noise, (len(asked), 1))
        misfits = self._misfits(depth, T, pictures) if whole else np.zeros(len(asked))
        margins[:, 1] += np.where(still, STILL_MARGIN, np.maximum(MOVING_MARGIN, MISFIT_SCALES * misfits))
        rays, parameters = camera_rays(self.camera), camera_parameters(self.camera)

        def work(start: int, stop: int) -> None:
            count_sights(
                depth, rays, chosen, T, nearest, furthest, UNIT_M, parameters, margins, through, on, start, stop
            )

        for_ranges(work, len(depth), self._threads)
        return through, on

    def _misfits(
        self, depth: NDArray[np.float32], T: NDArray[np.float64], pictures: NDArray[np.uint16]
    ) -> NDArray[np.float64]:
        """Return the median relative distance (n,) of the points from the surfaces of other frames."""
        some = depth[::EVERY, ::EVERY] > 0
        z = depth[::EVERY, ::EVERY][some].astype(np.float64)
        points = np.column_stack([camera_rays(self.camera)[::EVERY, ::EVERY][some] * z[:, None], z])
        misfits = np.ones(len(T))
        for number, transform in enumerate(T):
            moved = points @ transform[:3, :3].T + transform[:3, 3]
            moved = moved[np.max(np.abs(moved[:, :2]), axis=1) < 1.5 * moved[:, 2]]
            columns, rows = np.rint(self.camera.project(moved)).astype(np.intp).T
            inside = (columns >= 0) & (rows >= 0) & (columns < self.camera.width) & (rows < self.camera.height)
            near, far = pictures[:, number, rows[inside], columns[inside]]
            off = np.abs((near / 2 + far / 2) * UNIT_M / moved[inside, 2] - 1)[near > 0]
            if len(off) >= LEAST_POINTS:
                misfits[number] = np.median(off)
        return misfits
