# SPDX-License-Identifier: MIT
"""Pixels that no surface shows, filled from their surroundings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels.render.hole_filling import pull, push

__all__ = ["fill_unknown"]


def fill_unknown(value: NDArray[np.float32], known: NDArray[np.uint8]) -> None:
    """Fill pixels (h, w, 3) where `known` (h, w) is 0 from ever coarser levels (pull-push)."""
    if known.all() or value.shape[0] * value.shape[1] == 1:
        return
    height, width = -(-value.shape[0] // 2), -(-value.shape[1] // 2)
    coarse, coarse_known = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.uint8)
    pull(value, known, coarse, coarse_known)
    fill_unknown(coarse, coarse_known)
    push(value, known, coarse)
