# SPDX-License-Identifier: MIT
"""A depth map as it will look from where the camera is next, compiled.

Plain double precision in the order written here, without parallel sums: every machine finds the same map.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import lean

__all__ = ["CameraMotion", "blend_depth", "fill_gaps", "refine_depth", "splat_depth"]

EDGE = 0.03
"""Depths that differ by more than this part of them lie on different surfaces."""
SHARE = 0.5
"""Part of what a frame adds to the map before: less follows too late where poses are a little off, more is noisier."""
LEAST_PART = 0.05
"""Of a pixel that must be known where a map is read between four."""
REFINEMENTS = 2
"""Readings of the map for a pixel: the second moves it by less than a tenth of a pixel."""


class CameraMotion(NamedTuple):
    """A camera that moves.

    Attributes
    ----------
    slopes
        (h, w, 2) float64 undistorted x / z and y / z of the pixels.
    parameters
        (9,) float64 ``fx, fy, cx, cy, k1, k2, p1, p2, k3``.
    T_now_before, T_before_now
        (4, 4) float64, translations in raw units of depth.
    """

    slopes: NDArray[np.float64]
    parameters: NDArray[np.float64]
    T_now_before: NDArray[np.float64]
    T_before_now: NDArray[np.float64]


@lean
def moved(pose: NDArray[np.float64], x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a point after a rigid transform."""
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


@lean
def pixel_of(camera: NDArray[np.float64], x: float, y: float) -> tuple[float, float]:
    """Return the pixel of a ray with slopes x and y."""
    k1, k2, p1, p2, k3 = camera[4], camera[5], camera[6], camera[7], camera[8]
    if k1 != 0 or k2 != 0 or p1 != 0 or p2 != 0 or k3 != 0:
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x, y = (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )
    return camera[0] * x + camera[2], camera[1] * y + camera[3]


@lean
def blend_depth(
    decoded: NDArray[np.uint16], expected: NDArray[np.float64], mean: NDArray[np.float64], first: int, last: int
) -> None:
    """Write rows of the mean of what was expected and what came; what came alone where they differ."""
    for y in range(first, last):
        for x in range(decoded.shape[1]):
            came, before = np.float64(decoded[y, x]), expected[y, x]
            if came > 0 and before > 0 and abs(came - before) < EDGE * came:
                came = before + SHARE * (came - before)
            mean[y, x] = came


@lean
def splat_depth(depth: NDArray[np.float64], motion: CameraMotion, found: NDArray[np.float64]) -> None:
    """Move every known pixel to the nearest one of the next view; of several the nearest to the camera stays."""
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            z = depth[y, x]
            if z <= 0:
                continue
            px, py, pz = moved(motion.T_now_before, motion.slopes[y, x, 0] * z, motion.slopes[y, x, 1] * z, z)
            if pz <= 0:
                continue
            u, v = pixel_of(motion.parameters, px / pz, py / pz)
            if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
                continue
            column, row = np.int64(np.floor(u + 0.5)), np.int64(np.floor(v + 0.5))
            if found[row, column] == 0 or pz < found[row, column]:
                found[row, column] = pz


@lean
def fill_gaps(found: NDArray[np.float64], filled: NDArray[np.float64], first: int, last: int) -> None:
    """Write rows of a map in which pixels that nothing has come to take what is left, above, right or below."""
    height, width = found.shape
    for y in range(first, last):
        for x in range(width):
            z = found[y, x]
            if z == 0 and x > 0:
                z = found[y, x - 1]
            if z == 0 and y > 0:
                z = found[y - 1, x]
            if z == 0 and x < width - 1:
                z = found[y, x + 1]
            if z == 0 and y < height - 1:
                z = found[y + 1, x]
            filled[y, x] = z


@lean
def read_between(depth: NDArray[np.float64], u: float, v: float, near: float) -> float:
    """Return the depth at a place between four pixels, of those on the surface at about `near`; 0 if unknown."""
    height, width = depth.shape
    if not (0 <= u < width - 1 and 0 <= v < height - 1):
        return 0.0
    column, row = np.int64(np.floor(u)), np.int64(np.floor(v))
    right, below = u - column, v - row
    total, parts = 0.0, 0.0
    for j in range(2):
        for i in range(2):
            z = depth[row + j, column + i]
            if z > 0 and abs(z - near) < EDGE * near:
                part = (right if i else 1 - right) * (below if j else 1 - below)
                total += part * z
                parts += part
    return total / parts if parts >= LEAST_PART else 0.0


@lean
def refine_depth(
    depth: NDArray[np.float64],
    motion: CameraMotion,
    filled: NDArray[np.float64],
    expected: NDArray[np.float64],
    first: int,
    last: int,
) -> None:
    """Write rows of what is expected in the next view: what `depth` shows where a pixel's ray meets it."""
    for y in range(first, last):
        for x in range(depth.shape[1]):
            z = filled[y, x]
            for _ in range(REFINEMENTS):
                if z <= 0:
                    break
                px, py, pz = moved(motion.T_before_now, motion.slopes[y, x, 0] * z, motion.slopes[y, x, 1] * z, z)
                if pz <= 0:
                    z = 0.0
                    break
                u, v = pixel_of(motion.parameters, px / pz, py / pz)
                there = read_between(depth, u, v, pz)
                z = z + there - pz if there > 0 else 0.0
            expected[y, x] = max(z, 0.0)
