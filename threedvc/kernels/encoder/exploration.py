# SPDX-License-Identifier: MIT
"""What depth pictures tell about the cells of a box, where a camera can go in it, and what it would see there.

A box is dense: cell (i, j, k) of a (nx, ny, nz) array reaches from corner (i, j, k) to (i + 1, j + 1, k + 1), in cells
from the corner of the box.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threedvc.arrays import Doubles, Floats, Mask
from threedvc.kernels import inlined, kernel
from threedvc.kernels.encoder.fusion import MIN_Z_M, project_point, sensor_sigma
from threedvc.kernels.encoder.ray_update import MAX_SIDE, MAX_WINDOW, WINDOW_SIGMAS, cell_update

__all__ = ["DepthObservation", "flood_cells", "look_at_cells", "observe_depth"]

MIN_BAND_CELLS = 2.0
"""Cells within this of a reading are never taken as passed through: where in its cell a surface is, is not known."""
MIN_REACH = 0.01
"""A ray that one in a hundred comes so far tells next to nothing more."""
MIN_SLOPE = 1e-12
"""A direction that is smaller along an axis runs across it, and could not be divided by."""


class DepthObservation(NamedTuple):
    """A depth picture, and how far it counts.

    Attributes
    ----------
    camera, sensor
        Parameters of the camera and of the noise of its depth.
    depth
        (h, w) meters, 0 = unknown.
    mask
        (h, w): where it is not set, something else was seen, and only cells before it learn from that.
    trust
        (h, w) 0..1: how far a reading counts for the cells near it.
    free_log_odds
        By how much the log-odds of cells before a reading change.
    """

    camera: Doubles
    sensor: Doubles
    depth: Floats
    mask: Mask
    trust: Floats
    free_log_odds: float


@kernel
def observe_depth(start, stop, log_odds, cell_size, observation, T_camera_cells, T_cells_camera, delta):
    """Write into `delta` (nx, ny, nz) how a depth picture moves the log-odds of the cells of slabs ``start..stop``.

    The ray of a cell is the one through its center, as in `threedvc.kernels.encoder.fusion`: the ray sum of eq. (6)-(7)
    near the reading, ``free_log_odds`` before it, nothing behind it. See `DepthObservation`.
    """
    camera, sensor, depth, mask, trust, free_log_odds = observation
    odds, likelihood = np.empty(MAX_WINDOW), np.empty(MAX_WINDOW)
    T = T_camera_cells
    for i in range(start, stop):
        for j in range(log_odds.shape[1]):
            for k in range(log_odds.shape[2]):
                delta[i, j, k] = 0.0
                a, b, c = i + 0.5, j + 0.5, k + 0.5
                z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
                if z <= MIN_Z_M:
                    continue
                x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
                y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
                fu, fv = project_point(x, y, z, camera)
                if not (-0.5 <= fu < depth.shape[1] - 0.5 and -0.5 <= fv < depth.shape[0] - 0.5):
                    continue
                u, v = np.int64(np.floor(fu + 0.5)), np.int64(np.floor(fv + 0.5))
                reading = np.float64(depth[v, u])
                if reading <= 0.0:
                    continue
                sigma = sensor_sigma(reading, sensor)
                spread = np.sqrt(sigma * sigma + cell_size * cell_size / 12.0)
                band = max(WINDOW_SIGMAS * sigma, MIN_BAND_CELLS * cell_size)
                away = reading - z
                if away > band:
                    delta[i, j, k] = free_log_odds
                elif away >= -band and mask[v, u]:
                    change = window_change(
                        x / z, y / z, z, reading, spread, T_cells_camera, cell_size, sensor[4], log_odds, odds,
                        likelihood,
                    )  # fmt: skip
                    delta[i, j, k] = change * trust[v, u]


@kernel
def window_change(sx, sy, z, reading, spread, T_cells_camera, cell_size, outlier, log_odds, odds, likelihood):
    """Return the ray sum of the cell at depth z on a ray of slopes (sx, sy); cells outside the box are unknown."""
    T = T_cells_camera
    step = cell_size / np.sqrt(sx * sx + sy * sy + 1.0)
    window = WINDOW_SIGMAS * spread + step
    first = -np.int64(min(max(np.ceil((z - (reading - window)) / step), 0.0), MAX_SIDE))
    last = np.int64(min(max(np.ceil((reading + window - z) / step), 0.0), MAX_SIDE))
    for n in range(last - first + 1):
        t = z + (first + n) * step
        d = (reading - t) / spread
        likelihood[n] = (1.0 - outlier) * np.exp(-0.5 * d * d) + outlier
        i = np.int64(np.floor((T[0, 0] * sx + T[0, 1] * sy + T[0, 2]) * t + T[0, 3]))
        j = np.int64(np.floor((T[1, 0] * sx + T[1, 1] * sy + T[1, 2]) * t + T[1, 3]))
        k = np.int64(np.floor((T[2, 0] * sx + T[2, 1] * sy + T[2, 2]) * t + T[2, 3]))
        inside = 0 <= i < log_odds.shape[0] and 0 <= j < log_odds.shape[1] and 0 <= k < log_odds.shape[2]
        odds[n] = log_odds[i, j, k] if inside else 0.0
    return cell_update(odds, likelihood, outlier, last - first + 1, -first)


@kernel
def flood_cells(passable, queue, count, reached):
    """Mark in `reached` (nx, ny, nz) all cells with a way of steps between faces through `passable` ones.

    The ways begin at the `count` marked cells that stand in `queue`, an int64 array with room for the numbers of all
    cells. Return how many are marked.
    """
    nx, ny, nz = passable.shape
    head = 0
    while head < count:
        number = queue[head]
        head += 1
        i, j, k = number // (ny * nz), number // nz % ny, number % nz
        for side in range(6):
            way = 2 * (side & 1) - 1
            a = i + way if side < 2 else i
            b = j + way if 2 <= side < 4 else j
            c = k + way if side >= 4 else k
            if a < 0 or b < 0 or c < 0 or a >= nx or b >= ny or c >= nz or reached[a, b, c] or not passable[a, b, c]:
                continue
            reached[a, b, c] = 1
            queue[count] = (a * ny + b) * nz + c
            count += 1
    return count


@inlined
def box_span(origin, along, size, near, far):
    """Return the part of ``near..far`` in which ``origin + t along`` lies within 0..size."""
    if abs(along) < MIN_SLOPE:
        return (near, far) if 0.0 <= origin < size else (1.0, 0.0)
    first, second = -origin / along, (size - origin) / along
    return max(near, min(first, second)), min(far, max(first, second))


@kernel
def look_along(slopes, T, cell_size, opacity, sensor, far, looks, touched, count):
    """Raise `looks` (nx, ny, nz) along one ray; list in `touched` the cells seen first; return how many are listed."""
    shape, near = opacity.shape, 0.0
    for axis in range(3):
        along = T[axis, 0] * slopes[0] + T[axis, 1] * slopes[1] + T[axis, 2]
        near, far = box_span(T[axis, 3], along, shape[axis], near, far)
    if near >= far:
        return count
    ahead, ways, crossing, spacing = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3), np.empty(3)
    for axis in range(3):
        along = T[axis, 0] * slopes[0] + T[axis, 1] * slopes[1] + T[axis, 2]
        ahead[axis] = min(max(np.int64(np.floor(T[axis, 3] + along * near)), 0), shape[axis] - 1)
        ways[axis] = 1 if along > 0.0 else -1
        level = abs(along) < MIN_SLOPE
        spacing[axis] = np.inf if level else 1.0 / abs(along)
        crossing[axis] = np.inf if level else (ahead[axis] + (along > 0.0) - T[axis, 3]) / along
    length = np.sqrt(slopes[0] * slopes[0] + slopes[1] * slopes[1] + 1.0)
    reach, depth = 1.0, near
    while reach > MIN_REACH and depth < far:
        i, j, k = ahead[0], ahead[1], ahead[2]
        sigma = sensor_sigma(depth, sensor)
        look = np.float32(reach * cell_size * cell_size / (cell_size * cell_size + sigma * sigma))
        if looks[i, j, k] == 0.0:
            touched[count] = (i * shape[1] + j) * shape[2] + k
            count += 1
        looks[i, j, k] = max(looks[i, j, k], look)
        axis = np.argmin(crossing)
        passed = max(min(crossing[axis], far) - depth, 0.0)
        reach *= np.exp2(-opacity[i, j, k] * passed * length)
        depth = crossing[axis]
        crossing[axis] += spacing[axis]
        ahead[axis] += ways[axis]
        if ahead[axis] < 0 or ahead[axis] >= shape[axis]:
            break
    return count


@kernel
def look_at_cells(start, stop, poses, slopes, cell_size, entropy, taken, opacity, sensor, reach, seen, gains):
    """Write what views ``start..stop`` would learn into `gains` (views,) float64, in bits.

    A ray looks at the cells that it passes up to depth `reach`: with the probability that nothing has stopped it
    before, times what the sensor tells at that depth. The look of a view at a cell is the best one of its rays, so that
    a cell counts once, with that share of its `entropy` less the share `taken` already.

    Parameters
    ----------
    poses
        (views, 3, 4) T_cells_camera: from meters to cells.
    slopes
        (rays, 2) slopes.
    entropy
        (nx, ny, nz) float32 bits of each cell.
    taken
        (nx, ny, nz) float32 best looks of views that are given.
    opacity
        (nx, ny, nz) float32 halvings of the rays per meter, finite.
    seen
        (nx, ny, nz) float32: raised to the best look of these views.
    """
    looks = np.zeros(entropy.shape, np.float32)
    touched = np.empty(entropy.size, np.int32)
    flat, best = looks.reshape(-1), seen.reshape(-1)
    bits, had = entropy.reshape(-1), taken.reshape(-1)
    for view in range(start, stop):
        count = 0
        for ray in range(slopes.shape[0]):
            count = look_along(slopes[ray], poses[view], cell_size, opacity, sensor, reach, looks, touched, count)
        total = 0.0
        for n in range(count):
            cell = touched[n]
            total += max(np.float64(flat[cell]) - np.float64(had[cell]), 0.0) * np.float64(bits[cell])
            best[cell] = max(best[cell], flat[cell])
            flat[cell] = 0.0
        gains[view] = total
