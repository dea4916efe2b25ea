# SPDX-License-Identifier: MIT
"""Pull-push interpolation: averages of known pixels at half size, then values for unknown ones from there."""

from __future__ import annotations

import numpy as np

from threedvc.kernels import kernel

__all__ = ["pull", "push"]

NEAR, FAR = np.float32(0.75), np.float32(0.25)
"""Weights of the nearer and the further of two samples of half the size in bilinear interpolation."""


@kernel
def pull(value, known, coarse, coarse_known):
    """Average the known ones of every 2x2 pixels of `value` (h, w, 3) float32 into `coarse` (h/2, w/2, 3).

    `known` and `coarse_known` are uint8; an odd last row or column stands alone.
    """
    for i in range(coarse.shape[0]):
        for j in range(coarse.shape[1]):
            r, g, b, count = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for y in range(2 * i, min(2 * i + 2, value.shape[0])):
                for x in range(2 * j, min(2 * j + 2, value.shape[1])):
                    if known[y, x]:
                        r += value[y, x, 0]
                        g += value[y, x, 1]
                        b += value[y, x, 2]
                        count += np.float32(1.0)
            coarse_known[i, j] = count > 0
            if count > 0:
                coarse[i, j, 0], coarse[i, j, 1], coarse[i, j, 2] = r / count, g / count, b / count


@kernel
def push(value, known, coarse):
    """Give every unknown pixel of `value` (h, w, 3) the bilinear value of `coarse` (h/2, w/2, 3)."""
    rows, columns = coarse.shape[0], coarse.shape[1]
    for y in range(value.shape[0]):
        for x in range(value.shape[1]):
            if known[y, x]:
                continue
            i, j = y >> 1, x >> 1
            k = min(max(i + (1 if y & 1 else -1), 0), rows - 1)
            m = min(max(j + (1 if x & 1 else -1), 0), columns - 1)
            for c in range(3):
                beside = NEAR * coarse[i, j, c] + FAR * coarse[i, m, c]
                beyond = NEAR * coarse[k, j, c] + FAR * coarse[k, m, c]
                value[y, x, c] = NEAR * beside + FAR * beyond
