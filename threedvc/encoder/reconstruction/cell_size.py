# SPDX-License-Identifier: MIT
"""The default size of a cell, from the distance of a surface and the pixels that see it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.camera import CameraRig

__all__ = ["default_voxel_size"]

PIXELS_PER_CELL = 4.0
MIN_PIXELS_PER_CELL = 1.3
REFERENCE_PIXELS = 640 * 480


def default_voxel_size(depth: NDArray[np.float32], mask: NDArray[np.bool_], rig: CameraRig) -> float:
    """Choose a cell that covers about 4 pixels of a 640x480 picture at the depth that 3/4 of an object do not exceed.

    Small pictures get finer cells against their pixels; the size is rounded to a millimetre.
    """
    seen = depth[mask & (depth > 0)]
    distance = float(np.percentile(seen, 75)) if len(seen) else 1.0
    pixels = max(PIXELS_PER_CELL * float(np.sqrt(depth.size / REFERENCE_PIXELS)), MIN_PIXELS_PER_CELL)
    return max(round(pixels * distance / rig.depth.fx, 3), 0.001)
