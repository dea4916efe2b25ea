# SPDX-License-Identifier: MIT
"""Spend rays where the picture needs them: every second pixel first, between them only at edges."""

from __future__ import annotations

from threedvc.kernels import kernel

__all__ = ["interpolate_between", "interpolate_diamonds"]

MAX_DEPTH_STEP = 0.02
MAX_BEND = 0.004


@kernel
def is_smooth(depth, labels, a, b, c, d):
    """Tell whether four rays at the corners of a square met one nearly plane surface, or nothing at all."""
    if labels[a] != labels[b] or labels[a] != labels[c] or labels[a] != labels[d]:
        return False
    if depth[a] <= 0.0 or depth[b] <= 0.0 or depth[c] <= 0.0 or depth[d] <= 0.0:
        return depth[a] <= 0.0 and depth[b] <= 0.0 and depth[c] <= 0.0 and depth[d] <= 0.0
    near = min(depth[a], depth[b], depth[c], depth[d])
    far = max(depth[a], depth[b], depth[c], depth[d])
    if far - near > MAX_DEPTH_STEP * near:
        return False
    bend = 1.0 / depth[a] - 1.0 / depth[b] - 1.0 / depth[c] + 1.0 / depth[d]
    return abs(bend) * near < MAX_BEND


@kernel
def interpolate_diamonds(start, stop, width, height, depth, labels, wanted):
    """Interpolate rays at even rows and columns between four that are cast, and say which have to be cast.

    Cast are those whose row and column are both, or neither, multiples of four; the others have four of them
    around at a distance of two.

    Parameters
    ----------
    start, stop
        Range of even rows, counted from 0.
    depth, labels
        (width * height,) float32 and uint8, updated.
    wanted
        (width * height,) uint8: set where a ray has to be cast.
    """
    for row in range(2 * start, min(2 * stop, height), 2):
        for column in range(2 - (row & 2), width, 4):
            place = row * width + column
            wanted[place] = 1
            if row < 2 or column < 2 or row + 2 >= height or column + 2 >= width:
                continue
            above, below, left, right = place - 2 * width, place + 2 * width, place - 2, place + 2
            if not is_smooth(depth, labels, above, left, right, below):
                continue
            wanted[place] = 0
            if depth[above] > 0.0:
                inverse = 1.0 / depth[above] + 1.0 / depth[below] + 1.0 / depth[left] + 1.0 / depth[right]
                depth[place] = 4.0 / inverse
                labels[place] = labels[above]


@kernel
def interpolate_between(start, stop, width, height, depth, labels, wanted):
    """Interpolate the rays between those at even rows and columns, and say which have to be cast.

    Squares ``start..stop`` in rows of squares: the corners are cast already. On a plane the inverse depth
    is linear in the picture, so it is interpolated exactly.

    Parameters
    ----------
    depth, labels
        (width * height,) float32 and uint8, updated.
    wanted
        (width * height,) uint8: set where a ray has to be cast, cleared elsewhere.
    """
    for row in range(2 * start, min(2 * stop, height), 2):
        for column in range(0, width, 2):
            a = row * width + column
            wanted[a] = 0
            right, below = column + 1 < width, row + 1 < height
            inside = column + 2 < width and row + 2 < height
            smooth = False
            if inside:
                b, c = a + 2, a + 2 * width
                smooth = is_smooth(depth, labels, a, b, c, c + 2)
            if right:
                wanted[a + 1] = not smooth
            if below:
                wanted[a + width] = not smooth
            if right and below:
                wanted[a + width + 1] = not smooth
            if not smooth or depth[a] <= 0.0:
                continue
            d = c + 2
            wa, wb, wc, wd = 1.0 / depth[a], 1.0 / depth[b], 1.0 / depth[c], 1.0 / depth[d]
            depth[a + 1], depth[a + width] = 2.0 / (wa + wb), 2.0 / (wa + wc)
            depth[a + width + 1] = 4.0 / (wa + wb + wc + wd)
            for place in (a + 1, a + width, a + width + 1):
                labels[place] = labels[a]
