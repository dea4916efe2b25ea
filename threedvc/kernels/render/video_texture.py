# SPDX-License-Identifier: MIT
"""Colors of surfaces gathered from the pictures of a video: sums of integers, the same in every order of pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.blocks import find_cell

__all__ = ["GatheredTexels", "SeenSurface", "gather_colors", "surface_texels"]


class SeenSurface(NamedTuple):
    """What one picture shows of an object.

    Attributes
    ----------
    slopes
        (h * w, 2) float64 slopes of the pixels' rays.
    depth, labels
        (h, w) float32 meters along z and (h, w) uint8: what they meet first.
    label
        The object.
    T_texels_camera
        (3, 4) from the camera to texels whose centers are integers.
    max_ratio
        Depths of neighbors that differ by more than this factor lie on different surfaces.
    """

    slopes: NDArray[np.float64]
    depth: NDArray[np.float32]
    labels: NDArray[np.uint8]
    label: int
    T_texels_camera: NDArray[np.float64]
    max_ratio: float


class GatheredTexels(NamedTuple):
    """Texels of one object.

    Attributes
    ----------
    sums
        (texels, 3) int32 sums of RGB.
    counts
        (texels,) int32 pixels in a sum.
    colors
        (texels, 3) int16 means.
    known
        (texels,) uint8: which of them have a color.
    """

    sums: NDArray[np.int32]
    counts: NDArray[np.int32]
    colors: NDArray[np.int16]
    known: NDArray[np.uint8]


@kernel
def inside_surface(y, x, seen):
    """Tell whether a pixel shows the object, and all its neighbors the same surface: it holds no other's color."""
    _, depth, labels, label, _, max_ratio = seen
    z = depth[y, x]
    if z <= 0.0 or labels[y, x] != label:
        return False
    for k in range(4):
        v = y + (k == 0) - (k == 1)
        u = x + (k == 2) - (k == 3)
        if v < 0 or u < 0 or v >= depth.shape[0] or u >= depth.shape[1]:
            continue
        if labels[v, u] != label or depth[v, u] > max_ratio * z or z > max_ratio * depth[v, u]:
            return False
    return True


@kernel
def texel_at(y, x, seen):
    """Return the texel that the ray of a pixel meets."""
    slopes, depth, _, _, T, _ = seen
    n = y * depth.shape[1] + x
    z = np.float64(depth[y, x])
    px, py = slopes[n, 0] * z, slopes[n, 1] * z
    return (
        np.int64(np.floor(T[0, 0] * px + T[0, 1] * py + T[0, 2] * z + T[0, 3] + 0.5)),
        np.int64(np.floor(T[1, 0] * px + T[1, 1] * py + T[1, 2] * z + T[1, 3] + 0.5)),
        np.int64(np.floor(T[2, 0] * px + T[2, 1] * py + T[2, 2] * z + T[2, 3] + 0.5)),
    )


@kernel
def surface_texels(start, stop, seen, texels, found):
    """Write the texels (h, w, 3) int32 that the rays of rows ``start..stop`` meet, and for which there are any (h, w).

    `seen` is a `SeenSurface`.
    """
    for y in range(start, stop):
        for x in range(seen[1].shape[1]):
            found[y, x] = inside_surface(y, x, seen)
            if found[y, x]:
                texels[y, x, 0], texels[y, x, 1], texels[y, x, 2] = texel_at(y, x, seen)


@kernel
def gather_colors(texels, found, picture, max_count, tables, gathered):
    """Add a picture (h, w, 3) uint8 to the texels that its pixels show, and update their colors.

    Parameters
    ----------
    texels, found
        As `surface_texels` writes them; all of them are in the index.
    max_count
        Sums of so many pixels or more are halved, so that later pictures count more.
    tables
        Index of the texels, see `threedvc.kernels.blocks`.
    gathered
        `GatheredTexels`.
    """
    root_origin, root, supers = tables
    sums, counts, colors, known = gathered
    height, width = found.shape
    places = np.full(height * width, -1, dtype=np.int64)
    for y in range(height):
        for x in range(width):
            if found[y, x]:
                place = find_cell(
                    np.int64(texels[y, x, 0]), np.int64(texels[y, x, 1]), np.int64(texels[y, x, 2]),
                    root_origin, root, supers,
                )  # fmt: skip
                places[y * width + x] = place
                for channel in range(3):
                    sums[place, channel] += picture[y, x, channel]
                counts[place] += 1
    for place in places:
        if place < 0:
            continue
        while counts[place] >= max_count:
            counts[place] >>= 1
            for channel in range(3):
                sums[place, channel] >>= 1
        for channel in range(3):
            colors[place, channel] = (2 * sums[place, channel] + counts[place]) // (2 * counts[place])
        known[place] = 1
