# SPDX-License-Identifier: MIT
"""Least squares of cell colors through the renderer, and of poses through the pictures, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threedvc.arrays import Doubles, Floats
from threedvc.kernels import kernel
from threedvc.kernels.render.shading import interpolation

__all__ = [
    "LumaPicture",
    "add_depth_equations",
    "add_luma_equations",
    "find_corners",
    "gather_colors",
    "gather_neighbors",
    "scatter_colors",
]

WEIGHT_STEPS = 255.0
"""Weights of interpolation are kept in bytes: 8 of them a sample, and millions of samples."""
MIN_Z_M = 0.05
"""Points nearer to a camera, or behind it, are left out: their pixel hangs on every millimeter of the pose."""
DEPTH_REACH = 2
"""Pixels to both sides over which the slope of a depth is taken: next to each other noise would outweigh it."""
DOUBT = 0.1
"""Share of a squared residual of depth, in sigmas, that weighs it down: one of 3.2 counts half."""


class LumaPicture(NamedTuple):
    """A frame's luma and the color camera that took it.

    Attributes
    ----------
    luma, slope_x, slope_y
        (h, w) levels, and their derivatives in levels a pixel.
    camera
        (9,) ``fx, fy, cx, cy, k1, k2, p1, p2, k3``.
    T_color_depth
        (4, 4) from the depth camera to the color camera.
    """

    luma: Floats
    slope_x: Floats
    slope_y: Floats
    camera: Doubles
    T_color_depth: Doubles


@kernel
def find_corners(points, tables, number, numbers, weights):
    """Find the colored cells around points (n, 3) in cells whose centers are integers.

    Parameters
    ----------
    tables, number
        Index of the cells, and (cells,) int32: the number of each colored cell, -1 for others.
    numbers, weights
        (n, 8) int32 and (n, 8) uint8 outputs; weights in 1/255, all 0 where there is no colored cell.
    """
    positions, parts = np.empty(8, dtype=np.int64), np.empty(8)
    colored = (number >= 0).view(np.uint8)
    for i in range(points.shape[0]):
        found = interpolation(points[i, 0], points[i, 1], points[i, 2], tables, colored, positions, parts)
        for k in range(8):
            weights[i, k] = 0
            numbers[i, k] = 0
            if found and parts[k] > 0.0:
                numbers[i, k] = number[positions[k]]
                weights[i, k] = np.uint8(np.floor(parts[k] * WEIGHT_STEPS + 0.5))


@kernel
def gather_colors(start, stop, numbers, weights, values, shown):
    """Interpolate colors ``start..stop`` of `shown` (n, 3) float32 from `values` (cells, 3) float32."""
    for i in range(start, stop):
        red, green, blue, total = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(8):
            w = np.float32(weights[i, k])
            if w > 0:
                cell = numbers[i, k]
                red += w * values[cell, 0]
                green += w * values[cell, 1]
                blue += w * values[cell, 2]
                total += w
        if total > 0:
            red, green, blue = red / total, green / total, blue / total
        shown[i, 0], shown[i, 1], shown[i, 2] = red, green, blue


@kernel
def scatter_colors(start, stop, numbers, weights, rows, power, values):
    """Add rows (n, 3) float32 ``start..stop`` to the cells `values` (cells, 3) that they were interpolated from.

    Each is weighted by the interpolation's weight to the `power` 1 or 2.
    """
    for i in range(start, stop):
        total = np.float32(0.0)
        for k in range(8):
            total += np.float32(weights[i, k])
        if total <= 0:
            continue
        for k in range(8):
            if weights[i, k] > 0:
                w = np.float32(weights[i, k]) / total
                if power == 2:
                    w *= w
                cell = numbers[i, k]
                for channel in range(3):
                    values[cell, channel] += w * rows[i, channel]


@kernel
def gather_neighbors(neighbors, values, factor, result):
    """Add `factor` times the differences of cells to their neighbors (cells, 6), -1: none, to `result` (cells, 3)."""
    for i in range(neighbors.shape[0]):
        for k in range(6):
            other = neighbors[i, k]
            if other >= 0:
                for channel in range(3):
                    result[i, channel] += factor * (values[i, channel] - values[other, channel])


@kernel
def sample(picture, x, y):
    """Return the bilinear value of a picture (h, w) at a place inside."""
    ix, iy = np.int64(x), np.int64(y)
    fx, fy = x - ix, y - iy
    top = picture[iy, ix] * (1.0 - fx) + picture[iy, ix + 1] * fx
    return top * (1.0 - fy) + (picture[iy + 1, ix] * (1.0 - fx) + picture[iy + 1, ix + 1] * fx) * fy


@kernel
def project(camera, x, y):
    """Return the distorted pixel of a slope, and the derivative of it along both axes without the distortion's."""
    k1, k2, p1, p2, k3 = camera[4], camera[5], camera[6], camera[7], camera[8]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return camera[0] * xd + camera[2], camera[1] * yd + camera[3], camera[0] * radial, camera[1] * radial


@kernel
def add_row(row, residual, weight, matrix, side):
    """Add one weighted equation to the upper triangle of a system."""
    for a in range(len(row)):
        side[a] += weight * row[a] * residual
        for b in range(a, len(row)):
            matrix[a, b] += weight * row[a] * row[b]


@kernel
def add_luma_equations(points, luma, T, picture, gain, offset, scale, matrix, side):
    """Add up the equations that pull points to where a picture shows their luma.

    The unknowns are a small shift and turn before the depth camera, and changes of gain and offset.

    Parameters
    ----------
    points, luma
        (n, 3) float64 points of the object in meters and (n,) their luma.
    T
        (4, 4) from the object to the depth camera.
    picture
        See `LumaPicture`.
    gain, offset
        What is expected where a point has luma l: ``gain * l + offset``.
    scale
        Residual at which a point's weight has fallen to a quarter.
    matrix, side
        (8, 8) upper triangle and (8,), updated.

    Returns
    -------
    (weighted sum of squared residuals, sum of weights).
    """
    frame_luma, slope_x, slope_y, camera, E = picture
    height, width = frame_luma.shape
    total, count = 0.0, 0.0
    row = np.empty(8)
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        dx = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        dy = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        dz = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        cx = E[0, 0] * dx + E[0, 1] * dy + E[0, 2] * dz + E[0, 3]
        cy = E[1, 0] * dx + E[1, 1] * dy + E[1, 2] * dz + E[1, 3]
        cz = E[2, 0] * dx + E[2, 1] * dy + E[2, 2] * dz + E[2, 3]
        if cz < MIN_Z_M:
            continue
        x, y = cx / cz, cy / cz
        u, v, fu, fv = project(camera, x, y)
        if not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
            continue
        residual = sample(frame_luma, u, v) - (gain * luma[i] + offset)
        gx, gy = sample(slope_x, u, v) * fu / cz, sample(slope_y, u, v) * fv / cz
        gz = -(gx * x + gy * y)
        ax = E[0, 0] * gx + E[1, 0] * gy + E[2, 0] * gz
        ay = E[0, 1] * gx + E[1, 1] * gy + E[2, 1] * gz
        az = E[0, 2] * gx + E[1, 2] * gy + E[2, 2] * gz
        row[0], row[1], row[2] = ax, ay, az
        row[3], row[4], row[5] = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
        row[6], row[7] = -luma[i], -1.0
        share = residual / scale
        weight = 1.0 / ((1.0 + share * share) * (1.0 + share * share))
        total += weight * residual * residual
        count += weight
        add_row(row, residual, weight, matrix, side)
    return total, count


@kernel
def add_depth_equations(points, T, camera, depth, sensor, limit, matrix, side):
    """Add up the equations that pull points to the depth that a frame measured; see `add_luma_equations`.

    A measurement counts where the depth around it is smooth and within `limit` of the point's, relative to it.
    Residuals are in sigmas of the sensor: `sensor` (4,) is ``s0, s1, s2, quantum`` of its model.
    """
    height, width = depth.shape
    total, count = 0.0, 0.0
    row = np.zeros(8)
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        dx = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        dy = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        dz = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if dz < MIN_Z_M:
            continue
        x, y = dx / dz, dy / dz
        u, v, fu, fv = project(camera, x, y)
        iu, iv = np.int64(np.floor(u + 0.5)), np.int64(np.floor(v + 0.5))
        reach = DEPTH_REACH
        if iu < reach or iv < reach or iu >= width - reach or iv >= height - reach:
            continue
        here = np.float64(depth[iv, iu])
        left, right = np.float64(depth[iv, iu - reach]), np.float64(depth[iv, iu + reach])
        above, below = np.float64(depth[iv - reach, iu]), np.float64(depth[iv + reach, iu])
        if min(here, left, right, above, below) <= 0.0:
            continue
        slack = limit * here
        if abs(left + right - 2.0 * here) > slack or abs(above + below - 2.0 * here) > slack:
            continue
        sx, sy = 0.5 / DEPTH_REACH * (right - left), 0.5 / DEPTH_REACH * (below - above)
        away = here + sx * (u - iu) + sy * (v - iv) - dz
        if abs(away) > slack:
            continue
        # Across the surface, so that steep ones do not count more.
        gx, gy = sx * fu / dz, sy * fv / dz
        gz = -(gx * x + gy * y) - 1.0
        axial, quantum = sensor[0] + dz * (sensor[1] + dz * sensor[2]), sensor[3] * dz * dz
        unit = np.sqrt((axial * axial + quantum * quantum / 12.0) * (gx * gx + gy * gy + gz * gz))
        residual, gx, gy, gz = away / unit, gx / unit, gy / unit, gz / unit
        row[0], row[1], row[2] = gx, gy, gz
        row[3], row[4], row[5] = dy * gz - dz * gy, dz * gx - dx * gz, dx * gy - dy * gx
        weight = 1.0 / (1.0 + DOUBT * residual * residual)
        total += weight * residual * residual
        count += weight
        add_row(row, residual, weight, matrix, side)
    return total, count
