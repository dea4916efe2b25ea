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

from threedvc.encoder.fusion.integration import camera_parameters
from threedvc.encoder.tracking.registration_types import camera_rays
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse
from threedvc.kernels.encoder.free_space import count_sights, measure_misfits
from threedvc.parallel import for_ranges

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
FIRST_SLOTS = 128


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
        self._pictures = np.empty((FIRST_SLOTS, camera.height, camera.width, 2), np.uint16)
        self._slots: dict[int, int] = {}
        self._free = list(range(FIRST_SLOTS))

    def keep(self, frame: int, depth: NDArray[np.float32]) -> None:
        """Keep the depth (h, w) of a frame in metres."""
        units = np.rint(depth / UNIT_M)
        known = (units > 0) & (units < MAX_UNITS)
        square = np.ones((WINDOW, WINDOW), np.uint8)
        near = cv2.erode(np.where(known, units, MAX_UNITS).astype(np.uint16), square)
        far = cv2.dilate(np.where(known, units, 0).astype(np.uint16), square)
        enough = cv2.blur(known.astype(np.float32), (WINDOW, WINDOW)) > 0.5
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

    def sights(
        self,
        depth: NDArray[np.float32],
        chosen: NDArray[np.bool_],
        pose: Pose,
        others: Iterable[int],
        pose_of: Callable[[int], Pose | None],
        *,
        whole: bool = True,
        sparse: bool = False,
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
        sparse
            Whether every other pixel of every other row is asked for first, and others only near those that were seen
            through. What is three pixels wide is found like that.

        Returns
        -------
        tuple
            (h, w) uint8 each.
        """
        asked = [(k, at) for k in others if k in self._slots and (at := pose_of(k)) is not None]
        through, on = np.zeros(depth.shape, np.uint8), np.zeros(depth.shape, np.uint8)
        if not asked:
            return through, on
        T = np.stack([at @ inverse(pose) for _, at in asked])
        slots = np.array([self._slots[k] for k, _ in asked])
        still = np.array([np.array_equal(at, pose) for _, at in asked])
        margins = self._margins(depth, T, slots, still, whole)
        rays, parameters = camera_rays(self.camera), camera_parameters(self.camera)

        def ask(some: NDArray[np.bool_]) -> None:
            def work(start: int, stop: int) -> None:
                count_sights(
                    depth, rays, some, T, self._pictures, slots, UNIT_M, parameters, margins, through, on, start, stop
                )

            for_ranges(work, len(depth), self._threads)

        if not sparse:
            ask(chosen)
            return through, on
        first = np.zeros_like(chosen)
        first[::2, ::2] = chosen[::2, ::2]
        ask(first)
        near = cv2.dilate((through > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        ask(chosen & near & ~first)
        return through, on

    def _margins(
        self,
        depth: NDArray[np.float32],
        T: NDArray[np.float64],
        slots: NDArray[np.int64],
        still: NDArray[np.bool_],
        whole: bool,
    ) -> NDArray[np.float64]:
        """Return the margins (n, 3) of `count_sights` for frames before a camera that stands still or not."""
        s = self._sensor
        margins = np.tile(
            MARGIN_SIGMAS * np.array([s.s0_m, s.s1, s.s2_per_m + s.quantum_per_m / np.sqrt(12)]), (len(T), 1)
        )
        moving = np.full(len(T), MOVING_MARGIN)
        if whole and not still.all():
            moving[~still] = np.maximum(MOVING_MARGIN, MISFIT_SCALES * self._misfits(depth, T[~still], slots[~still]))
        margins[:, 1] += np.where(still, STILL_MARGIN, moving)
        return margins

    def _misfits(
        self, depth: NDArray[np.float32], T: NDArray[np.float64], slots: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Return the median relative distance (n,) of the points from the surfaces of other frames."""
        some = depth[::EVERY, ::EVERY] > 0
        z = depth[::EVERY, ::EVERY][some].astype(np.float64)
        points = np.column_stack([camera_rays(self.camera)[::EVERY, ::EVERY][some] * z[:, None], z])
        off = np.empty((len(T), len(points)))

        def work(start: int, stop: int) -> None:
            measure_misfits(points, T, self._pictures, slots, UNIT_M, camera_parameters(self.camera), off, start, stop)

        for_ranges(work, len(T), self._threads)
        known = [row[np.isfinite(row)] for row in off]
        return np.array([np.median(row) if len(row) >= LEAST_POINTS else 1.0 for row in known])
