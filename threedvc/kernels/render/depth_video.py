# SPDX-License-Identifier: MIT
"""Depth pictures of a video, magnified to the size at which they are shown.

Only + - * / and floor are used, and the pixels are independent of each other: the result is the same on every
machine and for any number of threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel

__all__ = ["magnify"]


@kernel
def cubic_weights(f: float, weights: NDArray[np.float64]) -> None:
    """Set the four weights of Catmull and Rom's interpolation at a part f of the way between the inner two."""
    weights[0] = 0.5 * f * (f * (2.0 - f) - 1.0)
    weights[1] = 0.5 * (f * f * (3.0 * f - 5.0) + 2.0)
    weights[2] = 0.5 * f * (f * (4.0 - 3.0 * f) + 1.0)
    weights[3] = 0.5 * f * f * (f - 1.0)


@kernel
def magnify(
    start: int, stop: int, samples: NDArray[np.uint16], levels: NDArray[np.float64], edge: float, complete: bool,
    drawn: NDArray[np.float32], shown: NDArray[np.float32],
) -> None:  # fmt: skip
    """Set rows ``start:stop`` of `shown` (h, w) to the depths of samples (rows, columns) that cover the picture.

    `levels` (n,) are the depths of sample values in meters, ascending. Where the four samples about a pixel differ
    by a factor of more than `edge` two surfaces meet: there `drawn` (h, w), if it is between, tells which of them it
    is. Where nothing is drawn nothing is shown, unless the video is `complete`.
    """
    rows, columns = samples.shape
    last = len(levels) - 1
    height, width = drawn.shape
    down, across = np.empty(4), np.empty(4)
    for y in range(start, stop):
        v = (y + 0.5) * rows / height - 0.5
        i = np.int64(np.floor(v))
        cubic_weights(v - i, down)
        for x in range(width):
            there = drawn[y, x]
            if there <= 0.0 and not complete:
                shown[y, x] = 0.0
                continue
            u = (x + 0.5) * columns / width - 0.5
            j = np.int64(np.floor(u))
            cubic_weights(u - j, across)
            total, least, greatest = 0.0, last, 0
            for a in range(4):
                row = min(max(i - 1 + a, 0), rows - 1)
                along = 0.0
                for b in range(4):
                    value = samples[row, min(max(j - 1 + b, 0), columns - 1)]
                    along += across[b] * value
                    if 0 < a < 3 and 0 < b < 3:
                        least, greatest = min(least, np.int64(value)), max(greatest, np.int64(value))
                total += down[a] * along
            if levels[greatest] > edge * levels[least] and levels[least] <= there <= levels[greatest]:
                shown[y, x] = there
                continue
            total = min(max(total, 0.0), float(last))
            k = min(np.int64(np.floor(total)), last - 1)
            shown[y, x] = levels[k] + (total - k) * (levels[k + 1] - levels[k])
