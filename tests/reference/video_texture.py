# SPDX-License-Identifier: MIT
"""Slow reference of colors gathered from pictures, pixel by pixel as docs/drawing.md says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Texel = tuple[int, int, int]


def gather(
    texels: dict[Texel, list[int]],
    points: NDArray[np.float64],
    depth: NDArray[np.float32],
    shown: NDArray[np.bool_],
    picture: NDArray[np.uint8],
    *,
    max_ratio: float,
    max_count: int,
) -> None:
    """Add a picture (h, w, 3) to texels, which hold red, green, blue and number of pixels.

    `points` (h, w, 3) are where rays meet surfaces in units of texels, `shown` (h, w) which of them meet the object.
    """
    height, width = depth.shape
    touched = set()
    for y in range(height):
        for x in range(width):
            if not shown[y, x]:
                continue
            around = [(y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)]
            around = [(v, u) for v, u in around if 0 <= v < height and 0 <= u < width]
            if any(
                not shown[v, u] or depth[v, u] > max_ratio * depth[y, x] or depth[y, x] > max_ratio * depth[v, u]
                for v, u in around
            ):
                continue
            i, j, k = (int(value) for value in np.floor(points[y, x]))
            total = texels.setdefault((i, j, k), [0, 0, 0, 0])
            for channel in range(3):
                total[channel] += int(picture[y, x, channel])
            total[3] += 1
            touched.add((i, j, k))
    for texel in touched:
        while texels[texel][3] >= max_count:
            texels[texel] = [value // 2 for value in texels[texel]]


def color(total: list[int]) -> list[int]:
    """Return the color of a texel."""
    return [(2 * value + total[3]) // (2 * total[3]) for value in total[:3]]
