# SPDX-License-Identifier: MIT
"""Integration of one RGB-D frame into the evidence of one object (sec. 2.3).

Work goes block by block: the ray of a cell is the one through its center, so that every cell reads
the state before the frame and writes only its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.blocks import BLOCK_CELLS, BLOCK_RADIUS, BLOCK_SIDE, find_cell
from threedvc.kernels.encoder.ray_update import MAX_SIDE, MAX_WINDOW, WINDOW_SIGMAS, cell_update

__all__ = [
    "MIN_Z_M",
    "ColorCells",
    "ColorReading",
    "DepthCells",
    "DepthReading",
    "fuse_color",
    "integrate_depth",
    "mark_blocks",
    "project_point",
    "sensor_sigma",
    "visible_blocks",
]

MIN_Z_M = 0.01
"""What is nearer to a camera, or behind it, is not in its picture: no sensor measures there."""
BEYOND_BORDER = 0.02
"""Weight of a reading at the border for cells beyond it: a fiftieth, so that views that show them outweigh it
(decision 0011)."""
MIN_BAND_CELLS = 2.0
"""Cells within this of a reading count as near it, however exact: where in its cell a surface is, is not known."""
EXCESS_SIGMA_M = 0.001
"""Added to a sensor's deviation, as poses and calibration err as well: weights of exact readings stay finite."""
UNIT_SIGMA_M = EXCESS_SIGMA_M + 0.0012
"""Deviation of a reading of weight 1: a Kinect's at one meter."""
MAX_WEIGHT = 200.0
"""Weight of a distance at which it stops to grow, so that what was seen often can still change."""
COLOR_SIGMAS, COLOR_CELLS = 2.0, 1.5
"""Cells within so many deviations of a reading, or so many edges, take its color: those that a surface may pass."""
MAX_COLOR_WEIGHT = 1e4
"""The same for colors, of which a look from one meter weighs 1 at most: they hardly change any more."""
OUTLINE, OUTLINE_PX = 1.5, 2.0
"""How many times wider than radius over depth a sphere is taken to be seen, and pixels beyond: it is wider aside of the
axis, and far ones are smaller than a pixel."""
LENS_SLACK = 0.25
"""Part of a picture by which a lens with distortion may move a block into it."""
REPEATED_KEYS = 8
"""Keys listed last that a block is looked for among: a ray and its neighbor meet no more."""
KEY_BITS = 21
"""Bits of one coordinate of a block's key: three of them fit into 63."""
KEY_OFFSET = 1 << (KEY_BITS - 1)
"""Added to a coordinate, which may be negative; far beyond what an index accepts."""


class DepthCells(NamedTuple):
    """Cells of an object, as depth changes them: coordinates of the blocks (n, 3), and arrays (n, 512)."""

    coords: NDArray[np.int32]
    voxel_size: float
    tables: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]
    log_odds: NDArray[np.float32]
    distance: NDArray[np.float32]
    weight: NDArray[np.float32]
    first_seen: NDArray[np.int32]


class DepthReading(NamedTuple):
    """A depth picture (h, w), which pixels of it show the object, and what is known of its sensor."""

    camera: NDArray[np.float64]
    depth: NDArray[np.float32]
    mask: NDArray[np.bool_]
    sensor: NDArray[np.float64]
    band_sigmas: float
    free_log_odds: float
    frame: int


class ColorCells(NamedTuple):
    """Cells of an object, as color changes them: coordinates of blocks (n, 3), arrays (n, 512, 3) and (n, 512)."""

    coords: NDArray[np.int32]
    voxel_size: float
    color: NDArray[np.float32]
    weight: NDArray[np.float32]


class ColorReading(NamedTuple):
    """A color picture with the depth picture that was taken with it.

    Attributes
    ----------
    T_color_depth, depth_camera, color_camera
        How the cameras lie, and their parameters.
    depth, confidence
        (h, w) float32 in the depth camera; confidence weighs viewing angle and depth edges.
    sensor
        Noise of the depth.
    levels
        A pyramid of float32 RGB pictures, each half the size of the one before.
    """

    T_color_depth: NDArray[np.float64]
    depth_camera: NDArray[np.float64]
    color_camera: NDArray[np.float64]
    depth: NDArray[np.float32]
    confidence: NDArray[np.float32]
    sensor: NDArray[np.float64]
    levels: tuple[NDArray[np.float32], ...]


@kernel
def project_point(x, y, z, camera):
    """Project a point in camera coordinates to distorted pixel coordinates (u, v)."""
    a, b = x / z, y / z
    r2 = a * a + b * b
    radial = 1.0 + r2 * (camera[4] + r2 * (camera[5] + r2 * camera[8]))
    u = a * radial + 2.0 * camera[6] * a * b + camera[7] * (r2 + 2.0 * a * a)
    v = b * radial + camera[6] * (r2 + 2.0 * b * b) + 2.0 * camera[7] * a * b
    return camera[0] * u + camera[2], camera[1] * v + camera[3]


@kernel
def sensor_sigma(z, sensor):
    """Return the axial deviation in meters at depth z, see `threedvc.frames.sensor_model`."""
    axial = sensor[0] + z * (sensor[1] + z * sensor[2])
    rounding = sensor[3] * z * z
    return np.sqrt(axial * axial + rounding * rounding / 12.0)


@kernel
def mark_blocks(depth, mask, rays, stride, T_object_camera, voxel_size, sensor, band_sigmas, keys):
    """List blocks that measured surfaces may touch, as packed keys with few repetitions; return how many.

    A key is ``(x + 2^20) | (y + 2^20) << 21 | (z + 2^20) << 42`` of block coordinates, which are clamped to
    +-2^20, far beyond what the index accepts; `keys` is int64 with room for ``5 * pixels`` entries.
    """
    count = 0
    size = voxel_size * BLOCK_SIDE
    for v in range(0, depth.shape[0], stride):
        for u in range(0, depth.shape[1], stride):
            z = depth[v, u]
            if z <= 0.0 or not mask[v, u]:
                continue
            band = max(band_sigmas * sensor_sigma(z, sensor), MIN_BAND_CELLS * voxel_size)
            for step in range(-2, 3):
                t = z + 0.5 * step * band
                x, y = rays[v, u, 0] * t, rays[v, u, 1] * t
                key = np.int64(0)
                for axis in range(3):
                    row = T_object_camera[axis]
                    place = row[0] * x + row[1] * y + row[2] * t + row[3]
                    block = min(max(np.floor(place / size), -float(KEY_OFFSET)), float(KEY_OFFSET - 1))
                    key |= (np.int64(block) + KEY_OFFSET) << (KEY_BITS * axis)
                fresh = True
                for back in range(1, min(count, REPEATED_KEYS) + 1):
                    if keys[count - back] == key:
                        fresh = False
                        break
                if fresh:
                    keys[count] = key
                    count += 1
    return count


@kernel
def visible_blocks(coords, count, voxel_size, T_camera_object, camera, width, height, far, numbers):
    """List the numbers of blocks whose bounding sphere can be seen nearer than `far`; return how many."""
    found = 0
    radius = BLOCK_RADIUS * voxel_size
    for b in range(count):
        cx = (coords[b, 0] * BLOCK_SIDE + BLOCK_SIDE // 2) * voxel_size
        cy = (coords[b, 1] * BLOCK_SIDE + BLOCK_SIDE // 2) * voxel_size
        cz = (coords[b, 2] * BLOCK_SIDE + BLOCK_SIDE // 2) * voxel_size
        T = T_camera_object
        z = T[2, 0] * cx + T[2, 1] * cy + T[2, 2] * cz + T[2, 3]
        if z < -radius or z > far + radius:
            continue
        # Nearer blocks may lie anywhere in the picture.
        if z > 2.0 * radius:
            x = T[0, 0] * cx + T[0, 1] * cy + T[0, 2] * cz + T[0, 3]
            y = T[1, 0] * cx + T[1, 1] * cy + T[1, 2] * cz + T[1, 3]
            reach_x = OUTLINE * camera[0] * radius / (z - radius) + OUTLINE_PX
            reach_y = OUTLINE * camera[1] * radius / (z - radius) + OUTLINE_PX
            u, v = camera[0] * x / z + camera[2], camera[1] * y / z + camera[3]
            slack_u, slack_v = LENS_SLACK * width * camera[9], LENS_SLACK * height * camera[9]
            if u < -reach_x - slack_u or u > width + reach_x + slack_u:
                continue
            if v < -reach_y - slack_v or v > height + reach_y + slack_v:
                continue
        numbers[found] = b
        found += 1
    return found


@kernel
def ray_window_update(
    x, y, z, reading, sigma, T_object_camera, voxel_size, outlier, tables, log_odds, odds, likelihood
):
    """Return the log-odds change of the cell at (x, y, z) in camera coordinates given a reading along its ray.

    The sum of eq. (6) runs over the cells of the ray from the cell itself, or the front end of the
    window around the reading, to the window's back end, at the spacing of the tessellation.
    """
    root_origin, root, supers = tables
    sx, sy = x / z, y / z
    step = voxel_size / np.sqrt(sx * sx + sy * sy + 1.0)
    window = WINDOW_SIGMAS * sigma + step
    first = -np.int64(min(max(np.ceil((z - (reading - window)) / step), 0.0), MAX_SIDE))
    last = np.int64(min(max(np.ceil((reading + window - z) / step), 0.0), MAX_SIDE))
    n = last - first + 1
    for k in range(n):
        t = z + (first + k) * step
        d = (reading - t) / sigma
        likelihood[k] = (1.0 - outlier) * np.exp(-0.5 * d * d) + outlier
        px, py = sx * t, sy * t
        T = T_object_camera
        cell = find_cell(
            np.int64(np.floor((T[0, 0] * px + T[0, 1] * py + T[0, 2] * t + T[0, 3]) / voxel_size)),
            np.int64(np.floor((T[1, 0] * px + T[1, 1] * py + T[1, 2] * t + T[1, 3]) / voxel_size)),
            np.int64(np.floor((T[2, 0] * px + T[2, 1] * py + T[2, 2] * t + T[2, 3]) / voxel_size)),
            root_origin,
            root,
            supers,
        )
        odds[k] = log_odds[cell] if cell >= 0 else 0.0
    return cell_update(odds, likelihood, outlier, n, -first)


@kernel
def integrate_depth(numbers, start, stop, cells, reading, T_camera_object, T_object_camera, delta):
    """Update occupancy, signed distance and first sight of the cells of blocks ``numbers[start:stop]``.

    `cells` are `DepthCells`, `reading` is a `DepthReading`. `delta` (len(numbers), 512) receives the change of the
    log-odds; the caller adds it when all blocks are done, so that every ray sum sees the state before the frame.
    """
    coords, voxel_size, tables, log_odds, distance, weight, first_seen = cells
    camera, depth, mask, sensor, band_sigmas, free_log_odds, frame = reading
    odds = np.empty(MAX_WINDOW)
    likelihood = np.empty(MAX_WINDOW)
    flat = log_odds.reshape(-1)
    T = T_camera_object
    for n in range(start, stop):
        b = numbers[n]
        for i in range(BLOCK_CELLS):
            delta[n, i] = 0.0
            px = (coords[b, 0] * BLOCK_SIDE + (i & 7) + 0.5) * voxel_size
            py = (coords[b, 1] * BLOCK_SIDE + ((i >> 3) & 7) + 0.5) * voxel_size
            pz = (coords[b, 2] * BLOCK_SIDE + (i >> 6) + 0.5) * voxel_size
            z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
            if z <= MIN_Z_M:
                continue
            x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
            y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
            fu, fv = project_point(x, y, z, camera)
            u, v = np.int64(np.floor(fu + 0.5)), np.int64(np.floor(fv + 0.5))
            share = 1.0
            if u < 0 or v < 0 or u >= depth.shape[1] or v >= depth.shape[0]:
                # Surfaces go on for a cell beyond the border, lest they end before it; better views outweigh that.
                near = voxel_size * camera[0] / z
                u, v = min(max(u, 0), depth.shape[1] - 1), min(max(v, 0), depth.shape[0] - 1)
                if max(abs(fu - u), abs(fv - v)) > near:
                    continue
                share = BEYOND_BORDER
            measured = np.float64(depth[v, u])
            if measured <= 0.0:
                continue
            sigma = sensor_sigma(measured, sensor)
            spread = np.sqrt(sigma * sigma + voxel_size * voxel_size / 12.0)
            band = max(band_sigmas * sigma, MIN_BAND_CELLS * voxel_size)
            away = measured - z
            if away < -band or (not mask[v, u] and away < band):
                continue
            precision = UNIT_SIGMA_M * UNIT_SIGMA_M / ((EXCESS_SIGMA_M + sigma) * (EXCESS_SIGMA_M + sigma)) * share
            if away > band:
                delta[n, i] = free_log_odds
            else:
                delta[n, i] = ray_window_update(
                    x, y, z, measured, spread, T_object_camera, voxel_size, sensor[4], tables, flat, odds, likelihood
                )
                if frame < first_seen[b, i]:
                    first_seen[b, i] = frame
            delta[n, i] *= share
            total = weight[b, i] + precision
            distance[b, i] += np.float32((min(away, band) - distance[b, i]) * precision / total)
            weight[b, i] = min(total, MAX_WEIGHT)


@kernel
def sample_image(level, u, v, channel):
    """Sample an image (h, w, 3) bilinearly at (u, v), clamped at its border."""
    height, width = level.shape[0], level.shape[1]
    u = min(max(u, 0.0), width - 1.0)
    v = min(max(v, 0.0), height - 1.0)
    i, j = min(np.int64(v), max(height - 2, 0)), min(np.int64(u), max(width - 2, 0))
    k, m = min(i + 1, height - 1), min(j + 1, width - 1)
    a, b = v - i, u - j
    top = level[i, j, channel] * (1.0 - b) + level[i, m, channel] * b
    bottom = level[k, j, channel] * (1.0 - b) + level[k, m, channel] * b
    return top * (1.0 - a) + bottom * a


@kernel
def fuse_color(numbers, start, stop, cells, reading, T_camera_object):
    """Update the color of cells near the measured surface in blocks ``numbers[start:stop]``.

    `cells` are `ColorCells`, `reading` is a `ColorReading`. A cell takes its color from the level of the pyramid whose
    pixels are just finer than the cell appears.
    """
    coords, voxel_size, color, weight = cells
    E, depth_camera, color_camera, depth, confidence, sensor, levels = reading
    T = T_camera_object
    for n in range(start, stop):
        b = numbers[n]
        for i in range(BLOCK_CELLS):
            px = (coords[b, 0] * BLOCK_SIDE + (i & 7) + 0.5) * voxel_size
            py = (coords[b, 1] * BLOCK_SIDE + ((i >> 3) & 7) + 0.5) * voxel_size
            pz = (coords[b, 2] * BLOCK_SIDE + (i >> 6) + 0.5) * voxel_size
            z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
            if z <= MIN_Z_M:
                continue
            x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
            y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
            fu, fv = project_point(x, y, z, depth_camera)
            u, v = np.int64(np.floor(fu + 0.5)), np.int64(np.floor(fv + 0.5))
            if u < 0 or v < 0 or u >= depth.shape[1] or v >= depth.shape[0] or confidence[v, u] <= 0.0:
                continue
            measured = np.float64(depth[v, u])
            reach = max(COLOR_SIGMAS * sensor_sigma(measured, sensor), COLOR_CELLS * voxel_size)
            if measured <= 0.0 or abs(measured - z) > reach:
                continue
            cx = E[0, 0] * x + E[0, 1] * y + E[0, 2] * z + E[0, 3]
            cy = E[1, 0] * x + E[1, 1] * y + E[1, 2] * z + E[1, 3]
            cz = E[2, 0] * x + E[2, 1] * y + E[2, 2] * z + E[2, 3]
            if cz <= MIN_Z_M:
                continue
            gu, gv = project_point(cx, cy, cz, color_camera)
            full = levels[0].shape
            if gu < -0.5 or gv < -0.5 or gu > full[1] - 0.5 or gv > full[0] - 0.5:
                continue
            level, scale = 0, 1.0
            while level + 1 < len(levels) and 2.0 * scale * cz <= voxel_size * color_camera[0]:
                level, scale = level + 1, scale * 2.0
            gain = np.float64(confidence[v, u]) / (z * z)
            total = weight[b, i] + gain
            for c in range(3):
                seen = sample_image(levels[level], (gu + 0.5) / scale - 0.5, (gv + 0.5) / scale - 0.5, c)
                color[b, i, c] += np.float32((seen - color[b, i, c]) * gain / total)
            weight[b, i] = min(total, MAX_COLOR_WEIGHT)
