# SPDX-License-Identifier: MIT
"""Depth as it was captured, where rigid models cannot tell it: what a frame of a depth video shows.

Sensors that guess between few measurements give a surface another shape in every frame. The stream may carry a video
of such depth beside the models: small pictures in logarithmic units, which stand for drawn depth in frames as captured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.render.depth_video import magnify
from threedvc.parallel import for_ranges

__all__ = ["EDGE", "CapturedDepth", "depth_levels"]

EDGE = 1.1
"""Samples that differ by more than this factor lie on different surfaces. Every reader must use it
(docs/drawing.md)."""


def depth_levels(nearest_m: float, ratio: float, bits: int) -> NDArray[np.float64]:
    """Return the depths (2^bits,) in meters of sample values, each `ratio` times the one before."""
    return np.multiply.accumulate(np.concatenate([[nearest_m], np.full((1 << bits) - 1, ratio)]))


@dataclass(frozen=True, kw_only=True, eq=False)
class CapturedDepth:
    """The depth of one frame.

    Attributes
    ----------
    samples
        (rows, columns) uint16, which cover the picture of the depth camera.
    levels
        (n,) float64 meters: what their values mean.
    complete
        Whether something is everywhere, also where nothing is drawn.
    """

    samples: NDArray[np.uint16]
    levels: NDArray[np.float64]
    complete: bool

    def shown(self, drawn: NDArray[np.float32], threads: int) -> NDArray[np.float32]:
        """Return the depth (h, w) in meters of a frame for which the models' (h, w) is drawn; 0 = nothing there."""
        result = np.empty_like(drawn)

        def row_range(start: int, stop: int) -> None:
            magnify(start, stop, self.samples, self.levels, EDGE, self.complete, drawn, result)

        for_ranges(row_range, len(drawn), threads)
        return result
