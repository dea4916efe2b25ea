# SPDX-License-Identifier: MIT
"""Turning a picture of inverse depths into a layer of cells, compiled.

Inverse depth w is linear in the slopes x, y of a ray where the surface is a plane: with w = a x + b y + c the plane
is a X + b Y + c Z = 1. So a cell's center at depth Z, where the picture shows w, is 1 - Z w off it, in units in which
(a, b, c) is its normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.coding.depth_picture import at, differ

__all__ = ["DepthView", "count_places", "spread_depths"]

MARGIN_CELLS = 1.5
"""How far the layer goes on beyond the border of the picture, where rays of its outermost pixels need it. As all
numbers here, every reader must use it."""
NEAR = 7
"""Samples that differ by less than a part of this many may belong to the surface around a sample."""
MIN_SHARE = 0.5
"""A surface that goes on from a sample ends where its inverse depth is this share of the sample's."""
OVERLAP = 0.125
"""How far, in cells, the surface may pass beside a cell that counts; without it there are pinholes in creases."""
REACH_CELLS = 0.51 + OVERLAP
"""A cell's center is within this of the surface along some axis."""
PLACE_LIMIT = float(1 << 24)
"""Cells from the origin beyond which bounds are not told apart: far beyond those that an index takes."""
FAR_DEPTH = 1e30
"""Beyond all places."""
CEILED, FLOORED = 0.501, 0.499
"""Half a cell, and a little wider lest rounding leaves out a cell at a bound."""


class DepthView(NamedTuple):
    """Inverse depths, the camera that sees them, and the cells of the object that they are turned into.

    Attributes
    ----------
    samples
        (rows, columns) int64, 0 = nothing there.
    unit
        Inverse depth in 1/m of one unit of the samples.
    lens
        (4,) float64 fx, fy, cx, cy in samples.
    T_camera_object
        (3, 4) float64.
    cell_size_m
        Edge of a cell.
    levels
        Number of places in a cell that the surface may pass.
    """

    samples: NDArray[np.int64]
    unit: float
    lens: NDArray[np.float64]
    T_camera_object: NDArray[np.float64]
    cell_size_m: float
    levels: int


@kernel
def tilt(samples: NDArray[np.int64], y: int, x: int, dy: int, dx: int) -> float:
    """Return the slope of the surface at a sample along an axis, from neighbors on the same surface, per sample."""
    here, before, after = samples[y, x], at(samples, y - dy, x - dx), at(samples, y + dy, x + dx)
    goes_back, goes_on = before > 0 and not differ(before, here), after > 0 and not differ(after, here)
    if goes_back and goes_on:
        return (after - before) / 2.0
    if goes_on:
        return float(after - here)
    return float(here - before) if goes_back else 0.0


@kernel
def is_smooth(samples: NDArray[np.int64], y: int, x: int) -> bool:
    """Tell whether the four samples from (y, x) on lie on one surface."""
    a, b, c, d = at(samples, y, x), at(samples, y, x + 1), at(samples, y + 1, x), at(samples, y + 1, x + 1)
    if min(a, b, c, d) == 0:
        return False
    return not (differ(a, b) or differ(c, d) or differ(a, c) or differ(b, d))


@kernel
def margin_of(view: DepthView, y: int, x: int) -> float:
    """Return how many samples beyond the border of the picture a sample there may speak for."""
    f = max(view.lens[0], view.lens[1])
    return 0.5 + MARGIN_CELLS * view.cell_size_m * f * view.samples[y, x] * view.unit


@kernel
def steepest(samples: NDArray[np.int64], y: int, x: int, dy: int, dx: int) -> float:
    """Return the largest difference along an axis between samples of one surface, of the nine around (y, x)."""
    most = np.int64(0)
    for across in range(-1, 2):
        for along in range(-1, 1):
            j, i = y + across * dx + along * dy, x + across * dy + along * dx
            a, b = at(samples, j, i), at(samples, j + dy, i + dx)
            if a > 0 and b > 0 and not differ(a, b):
                most = max(most, abs(a - b))
    return float(most)


@kernel
def find_reach(view: DepthView, y: int, x: int, reach: NDArray[np.float64]) -> None:
    """Find how many samples left, right, up and down (4,) a sample may speak for."""
    samples = view.samples
    rough = 0
    for k in range(4):
        rough += not is_smooth(samples, y - (k & 1), x - (k >> 1))
    reach[:] = 1.0 if rough else 0.5
    margin = max(margin_of(view, y, x), 1.0)
    if x == 0:
        reach[0] = margin
    if x == samples.shape[1] - 1:
        reach[1] = margin
    if y == 0:
        reach[2] = margin
    if y == samples.shape[0] - 1:
        reach[3] = margin


@kernel
def find_range(view: DepthView, y: int, x: int, reach: NDArray[np.float64]) -> tuple[float, float]:
    """Return between which depths the cells lie that the surface at a sample passes."""
    samples, unit, lens = view.samples, view.unit, view.lens
    here = samples[y, x]
    over_x, over_y = max(reach[0], reach[1]), max(reach[2], reach[3])
    across, down = steepest(samples, y, x, 0, 1), steepest(samples, y, x, 1, 0)
    low, high = here - across * over_x - down * over_y, here + across * over_x + down * over_y
    for k in range(9):
        other = at(samples, y + k // 3 - 1, x + k % 3 - 1)
        if other > 0 and abs(other - here) * NEAR <= here:
            low, high = min(low, float(other)), max(high, float(other))
    nx, ny = across * unit * lens[0], down * unit * lens[1]
    nz = high * unit + nx * (abs(x - lens[2]) + over_x) / lens[0] + ny * (abs(y - lens[3]) + over_y) / lens[1]
    thick = REACH_CELLS * view.cell_size_m * np.sqrt(nx * nx + ny * ny + nz * nz)
    return max(1.0 - thick, 0.0) / (high * unit), (1.0 + thick) / (max(low, MIN_SHARE * here) * unit)


@kernel
def find_bounds(view: DepthView, y: int, x: int, bounds: NDArray[np.int64]) -> None:
    """Find the cells, lowest and after the highest (2, 3), whose centers a sample may speak for."""
    T, lens = view.T_camera_object, view.lens
    reach = np.empty(4)
    find_reach(view, y, x, reach)
    least_z, most_z = find_range(view, y, x, reach)
    for axis in range(3):
        least, most = FAR_DEPTH, -FAR_DEPTH
        for k in range(8):
            z = most_z if k & 1 else least_z
            px = ((x + reach[1] if k & 2 else x - reach[0]) - lens[2]) / lens[0] * z - T[0, 3]
            py = ((y + reach[3] if k & 4 else y - reach[2]) - lens[3]) / lens[1] * z - T[1, 3]
            place = (T[0, axis] * px + T[1, axis] * py + T[2, axis] * (z - T[2, 3])) / view.cell_size_m
            least, most = min(least, place), max(most, place)
        if not -PLACE_LIMIT < least <= most < PLACE_LIMIT:
            least, most = -PLACE_LIMIT, PLACE_LIMIT
        bounds[0, axis], bounds[1, axis] = np.int64(np.ceil(least - CEILED)), np.int64(np.floor(most - FLOORED)) + 1


@kernel
def count_places(view: DepthView) -> float:
    """Return how many cells there are to look at."""
    total = 0.0
    bounds = np.empty((2, 3), dtype=np.int64)
    for y in range(view.samples.shape[0]):
        for x in range(view.samples.shape[1]):
            if view.samples[y, x] > 0:
                find_bounds(view, y, x, bounds)
                total += (
                    float(bounds[1, 0] - bounds[0, 0])
                    * float(bounds[1, 1] - bounds[0, 1])
                    * float(bounds[1, 2] - bounds[0, 2])
                )
    return total


@kernel
def interpolate_surface(
    samples: NDArray[np.int64], y: int, x: int, f: float, g: float, surface: NDArray[np.float64]
) -> None:
    """Find inverse depth and its slopes (3,) at (x + f, y + g) amid four samples."""
    a, b = float(samples[y, x]), float(samples[y, x + 1])
    c, d = float(samples[y + 1, x]), float(samples[y + 1, x + 1])
    surface[0] = a + (b - a) * f + (c - a) * g + (a - b - c + d) * f * g
    surface[1], surface[2] = (b - a) * (1.0 - g) + (d - c) * g, (c - a) * (1.0 - f) + (d - b) * f


@kernel
def local_surface(view: DepthView, y: int, x: int, u: float, v: float, surface: NDArray[np.float64]) -> bool:
    """Find inverse depth and its slopes (3,) at a place (u, v); return False if sample (y, x) does not speak for it.

    Amid samples of one surface it is interpolated, and the nearest speaks. Elsewhere the nearest sample's surface goes
    on, and those behind it go on beneath it, so that nothing gapes beside an edge.
    """
    samples = view.samples
    rows, columns = samples.shape
    ny = min(max(np.int64(np.floor(v + 0.5)), 0), rows - 1)
    nx = min(max(np.int64(np.floor(u + 0.5)), 0), columns - 1)
    y0, x0 = np.int64(np.floor(v)), np.int64(np.floor(u))
    mine = ny == y and nx == x
    if is_smooth(samples, y0, x0):
        interpolate_surface(samples, y0, x0, u - x0, v - y0, surface)
        return mine
    here, nearest = samples[y, x], samples[ny, nx]
    if not mine and not (abs(u - x) <= 1.0 and abs(v - y) <= 1.0 and here < nearest and differ(here, nearest)):
        return False
    surface[1], surface[2] = tilt(samples, y, x, 0, 1), tilt(samples, y, x, 1, 0)
    surface[0] = here + surface[1] * (u - x) + surface[2] * (v - y)
    return surface[0] > MIN_SHARE * here


@kernel
def relief_at(view: DepthView, y: int, x: int, cell: NDArray[np.int64], surface: NDArray[np.float64]) -> int:
    """Return the relief of a cell by the surface that a sample speaks for, 0 if it does not pass the cell."""
    T, h = view.T_camera_object, view.cell_size_m
    ox, oy, oz = (cell[0] + 0.5) * h, (cell[1] + 0.5) * h, (cell[2] + 0.5) * h
    px = T[0, 0] * ox + T[0, 1] * oy + T[0, 2] * oz + T[0, 3]
    py = T[1, 0] * ox + T[1, 1] * oy + T[1, 2] * oz + T[1, 3]
    pz = T[2, 0] * ox + T[2, 1] * oy + T[2, 2] * oz + T[2, 3]
    if not pz > 0.0:
        return 0
    sx, sy = px / pz, py / pz
    u, v = view.lens[0] * sx + view.lens[2], view.lens[1] * sy + view.lens[3]
    margin = margin_of(view, y, x)
    rows, columns = view.samples.shape
    if not (-margin <= u <= columns - 1 + margin and -margin <= v <= rows - 1 + margin):
        return 0
    if not local_surface(view, y, x, u, v, surface):
        return 0
    w = surface[0] * view.unit
    nx, ny = surface[1] * view.unit * view.lens[0], surface[2] * view.unit * view.lens[1]
    nz = w - nx * sx - ny * sy
    axis, most = 0, 0.0
    for k in range(3):
        across = T[0, k] * nx + T[1, k] * ny + T[2, k] * nz
        if abs(across) > abs(most):
            axis, most = k, across
    height = (1.0 - pz * w) / (most * h) + 0.5
    if not -OVERLAP <= height < 1.0 + OVERLAP:
        return 0
    return 1 + 8 * axis + min(max(np.int64(np.floor(height * view.levels)), 0), view.levels - 1)


@kernel
def spread_depths(view: DepthView, cells: NDArray[np.int32], relief: NDArray[np.uint8]) -> int:
    """Find the cells (n, 3) that the surface passes, and where; return how many there are, some more than once.

    What does not fit into `cells` and `relief` is left out.
    """
    count = 0
    bounds, cell, surface = np.empty((2, 3), dtype=np.int64), np.empty(3, dtype=np.int64), np.empty(3)
    for y in range(view.samples.shape[0]):
        for x in range(view.samples.shape[1]):
            if view.samples[y, x] == 0:
                continue
            find_bounds(view, y, x, bounds)
            for k in range(bounds[0, 2], bounds[1, 2]):
                for j in range(bounds[0, 1], bounds[1, 1]):
                    for i in range(bounds[0, 0], bounds[1, 0]):
                        cell[0], cell[1], cell[2] = i, j, k
                        found = relief_at(view, y, x, cell, surface)
                        if found == 0:
                            continue
                        if count < len(cells):
                            cells[count, 0], cells[count, 1], cells[count, 2] = i, j, k
                            relief[count] = found
                        count += 1
    return count
