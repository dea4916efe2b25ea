# SPDX-License-Identifier: MIT
"""What is known of a box of space, cell by cell: free, occupied, or not seen.

A decoded model holds occupied cells alone, so that what is free and what was never looked at must be found again: by
drawing the depth of frames and integrating it as the encoder integrates what a sensor measures (sec. 2.3), into all
cells of a coarser tessellation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.config import FusionConfig
from threedvc.encoder.fusion.integration import camera_parameters, confidence_of, free_space_log_odds
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.kernels.encoder.exploration import DepthObservation, observe_depth
from threedvc.metrics.entropy import bernoulli_entropy_bits
from threedvc.parallel import default_threads, for_ranges

__all__ = ["OccupancyField", "widened"]

MAX_CELLS = 1 << 20
"""Of a box: 4 MB of log-odds, as much again for each thread that judges views. A larger room has wider cells."""
MAX_LOG_ODDS = FusionConfig().max_log_odds
"""The bound of fusion: what was seen often is as sure here as there."""
FREE, OCCUPIED = -1.0, 1.0
"""Log-odds beyond which a cell counts as known, odds of e to 1 (a probability of 0.73); in between it is uncertain."""
COARSER = 1.05
"""Step by which cells are widened until they are few enough: no cell is more than 5 % wider than it has to be."""
STOPS = 1e6
"""Halvings per meter where rays stop: nothing passes even the smallest cell."""


def widened(cells: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """Return the cells (nx, ny, nz) no more than some steps along each axis away from marked ones."""
    wide = cells.copy()
    for axis in range(3):
        view = np.moveaxis(wide, axis, 0)
        source = view.copy()
        for step in range(1, min(steps, len(source) - 1) + 1):
            view[step:] |= source[:-step]
            view[:-step] |= source[step:]
    return wide


def _sides(extent: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    """Return how many cells along each side cover an extent (3,) in meters, as floats, which do not overflow."""
    return np.maximum(np.ceil(extent / cell_m - 1e-9), 1)


class OccupancyField:
    """Log-odds of occupancy of the cells of a box; 0, which is one bit of entropy, where nothing was seen.

    Parameters
    ----------
    low_m, high_m
        (3,) corners of the box in meters.
    finest_m
        Least edge of a cell; a large box has larger ones, so that there are no more than `MAX_CELLS`.
    half_m
        How far half of all rays get through space that was not seen.
    threads
        Number of threads; results do not depend on it.

    Attributes
    ----------
    log_odds
        (nx, ny, nz) float32 log of P(occupied) / P(free).
    origin_m, cell_m
        Corner of cell (0, 0, 0), and edge of a cell.
    """

    def __init__(
        self,
        low_m: NDArray[np.float64],
        high_m: NDArray[np.float64],
        *,
        finest_m: float,
        half_m: float,
        threads: int | None = None,
    ) -> None:
        extent = np.maximum(high_m - low_m, finest_m)
        self.cell_m = finest_m
        while np.prod(_sides(extent, self.cell_m)) > MAX_CELLS:
            self.cell_m *= COARSER
        self.origin_m = np.array(low_m, dtype=np.float64)
        self.log_odds = np.zeros(tuple(map(int, _sides(extent, self.cell_m))), dtype=np.float32)
        self.half_m = half_m
        self._delta = np.empty_like(self.log_odds)
        self._threads = threads or default_threads()

    @property
    def bits(self) -> float:
        """Entropy of all cells."""
        return float(self.entropy().sum(dtype=np.float64))

    @property
    def free(self) -> NDArray[np.bool_]:
        """Cells (nx, ny, nz) known to be free."""
        return np.asarray(self.log_odds < FREE)

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Cells (nx, ny, nz) known to be occupied."""
        return np.asarray(self.log_odds > OCCUPIED)

    def border(self) -> NDArray[np.int64]:
        """Return the numbers (n,) of cells that are uncertain beside ones known to be free, if only by a corner."""
        return np.flatnonzero(~self.free & ~self.occupied & widened(self.free, 1))

    def entropy(self) -> NDArray[np.float32]:
        """Return the entropy of each cell (nx, ny, nz) in bits."""
        return bernoulli_entropy_bits(self.log_odds).astype(np.float32)

    def opacity(self) -> NDArray[np.float32]:
        """Return how often rays are halved per meter of each cell (nx, ny, nz).

        A cell believed occupied lets none pass. Space that was not seen lets more of them pass than equiprobable cells
        that do not depend on each other would: what is empty is so at large.
        """
        halvings = np.logaddexp(0, self.log_odds) / (np.log(2) * self.half_m)
        return np.where(self.occupied, STOPS, halvings).astype(np.float32)

    def cells_from(self, T_field_camera: Pose) -> NDArray[np.float64]:
        """Return the (3, 4) map from camera coordinates in meters to cells, whose corners are integers."""
        T = T_field_camera[:3] / self.cell_m
        T[:, 3] -= self.origin_m / self.cell_m
        return np.asarray(T)

    def cells_at(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the numbers of the distinct cells that points (n, 3) in meters lie in; those outside are left out."""
        cells = np.floor((points - self.origin_m) / self.cell_m).astype(np.int64)
        inside = np.all((cells >= 0) & (cells < self.log_odds.shape), axis=1)
        return np.unique(np.ravel_multi_index(tuple(cells[inside].T), self.log_odds.shape))

    def centers(self, numbers: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the centers (n, 3) in meters of cells of given numbers (n,)."""
        cells = np.stack(np.unravel_index(numbers, self.log_odds.shape), axis=-1)
        return self.origin_m + (cells + 0.5) * self.cell_m

    def observe(
        self,
        depth: NDArray[np.float32],
        mask: NDArray[np.bool_],
        camera: Camera,
        T_camera_field: Pose,
        sensor: SensorModel,
    ) -> None:
        """Integrate a depth picture.

        Parameters
        ----------
        depth
            (h, w) meters along z, 0 = nothing there.
        mask
            (h, w) pixels that show what the field is of; the others tell only what lies before them.
        camera
            The camera of the picture.
        T_camera_field
            Pose of the box in that camera.
        sensor
            How the picture is taken to scatter.
        """
        cells = np.diag([self.cell_m, self.cell_m, self.cell_m, 1.0])
        cells[:3, 3] = self.origin_m
        T_camera_cells, T_cells_camera = compose(T_camera_field, cells), self.cells_from(inverse(T_camera_field))
        observation = DepthObservation(
            camera_parameters(camera), sensor.parameters(), depth, mask, confidence_of(depth, camera),
            free_space_log_odds(sensor),
        )  # fmt: skip

        def slab_range(start: int, stop: int) -> None:
            observe_depth(
                start, stop, self.log_odds, self.cell_m, observation, T_camera_cells, T_cells_camera, self._delta
            )

        for_ranges(slab_range, len(self.log_odds), self._threads)
        self.log_odds += self._delta
        np.clip(self.log_odds, -MAX_LOG_ODDS, MAX_LOG_ODDS, out=self.log_odds)

    def hold_occupied(self, points: NDArray[np.float64]) -> None:
        """Let cells with points (n, 3) of surfaces, in meters, stop rays; they stay uncertain until seen well."""
        flat, numbers = self.log_odds.reshape(-1), self.cells_at(points)
        flat[numbers] = np.maximum(flat[numbers], np.float32(1.01 * OCCUPIED))

    def hold_free(self, place: NDArray[np.float64], radius_m: float, sensor: SensorModel) -> None:
        """Take cells within a radius of a place (3,) in meters, where a camera has been, as passed through."""
        reach = np.ceil(radius_m / self.cell_m)
        axis = np.arange(-reach, reach + 1)
        offsets = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) * self.cell_m
        near = offsets[np.linalg.norm(offsets, axis=1) <= radius_m]
        flat, numbers = self.log_odds.reshape(-1), self.cells_at(place + near)
        flat[numbers] = np.minimum(flat[numbers], np.float32(free_space_log_odds(sensor)))
