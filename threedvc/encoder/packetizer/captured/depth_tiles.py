# SPDX-License-Identifier: MIT
"""What is known of the tiles of a depth video before it is coded: what models miss there, and what was measured."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.packetizer.captured.depth_run import PictureFormat
from threedvc.metrics.depth_errors import geman_mcclure_errors
from threedvc.render.captured_depth import tile_grid, tiles_of_pixels

__all__ = ["are_measured", "tile_misfits"]

MIN_MEASURED = 0.2
"""Times the share of all pixels that a sensor measured in the frames of a run, from which share of its own pixels on a
tile counts as measured; by hand. Sparse sensors measure few pixels everywhere."""


def tile_misfits(
    pictures: Iterable[tuple[NDArray[np.float32], NDArray[np.float32]]], video: PictureFormat
) -> NDArray[np.float64]:
    """Return the misfit of depths that are drawn in each tile (down, across) of a video, over that of a wrong picture.

    `pictures` are pairs of what is drawn and what was measured, (h, w) each.
    """
    return _mean_sums((geman_mcclure_errors(*pair) / pair[0].size for pair in pictures), video)


def are_measured(depths: Sequence[NDArray[np.float32]], video: PictureFormat) -> NDArray[np.bool_]:
    """Tell of which tiles (down, across) of a video more than next to nothing was measured in depths (h, w)."""
    pixels = _mean_sums([np.ones(depths[0].shape)], video)
    measured = _mean_sums((depth > 0 for depth in depths), video)
    return np.asarray(measured >= MIN_MEASURED * pixels * (measured.sum() / depths[0].size))


def _mean_sums(maps: Iterable[NDArray[Any]], video: PictureFormat) -> NDArray[np.float64]:
    """Return for each tile (down, across) of a video the sum over its pixels, averaged over maps (h, w)."""
    size = video.rows, video.columns
    tiles = np.zeros(tile_grid(*size))
    count = 0
    for values in maps:
        numbers = np.ravel_multi_index(np.ix_(*tiles_of_pixels(size, values.shape)), tiles.shape)
        tiles += np.bincount(numbers.reshape(-1), values.reshape(-1), tiles.size).reshape(tiles.shape)
        count += 1
    return tiles / max(count, 1)
