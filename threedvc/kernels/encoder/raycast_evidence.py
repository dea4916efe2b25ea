# SPDX-License-Identifier: MIT
"""Ray casting of the encoder's evidence: what the model so far looks like, for registration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats
from threedvc.kernels import inlined, kernel
from threedvc.kernels.blocks import BLOCK_CELLS, BLOCK_SIDE, MISSING_SUPER, SUPER_SIDE, find_block, find_cell
from threedvc.kernels.render.raycast import RAY_NUDGE, ROUNDING, next_crossing
from threedvc.units import LUMA_WEIGHTS

__all__ = ["EvidenceCells", "ViewRays", "cast_evidence", "fill_between", "interpolate"]

RED, GREEN, BLUE = LUMA_WEIGHTS
UNKNOWN = 1e9
"""No signed distance is so large: something around is not known."""
STEP = 0.7
"""Part of the distance to the surface by which a ray goes on, as a signed distance along other rays may be too large;
and cells by which it goes on where nothing is known."""
MIN_STEP = 0.6
"""Cells by which a ray goes on at least: noise near a surface must not hold it."""
MAX_CHANGE = 2.5
"""Cells by which the distance may fall from one place to the next: more is the rim of an occlusion, not a surface."""
EXTRAPOLATION = 0.5
"""How far beyond two places, in parts of the way between them, a surface may be looked for: distances are not exact."""
NORMAL_REACH = 0.7
"""Cells on either side over which a gradient is taken: so all cells around a point have a say."""
MIN_SHARE = 1e-6
"""Added to weights of colors, so that at a cell's center the others do not weigh nothing at all."""
MAX_DEPTH_STEP = 0.04
MAX_BEND = 0.006
MIN_COSINE = 0.9
"""What four rays at the corners of a square may differ by if those between are interpolated: parts of the depth, parts
of the inverse depth that they are off a plane, twice what pictures forgive, and the cosine between normals, 26
degrees."""


class EvidenceCells(NamedTuple):
    """Evidence of an object, one value a cell; `tables` is the index of the cells.

    Attributes
    ----------
    voxel_size
        Edge of a cell in meters.
    tables
        See `threedvc.kernels.blocks`.
    distance, weight
        (cells,) signed distances in meters and their weights, 0 = unknown.
    color, color_weight
        (cells, 3) RGB and (cells,) weights, 0 = unknown.
    """

    voxel_size: float
    tables: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]
    distance: Floats
    weight: Floats
    color: Floats
    color_weight: Floats


class ViewRays(NamedTuple):
    """What rays met: (n,) depth in meters, (n, 3) unit normal in the camera, (n,) luma; 0 where nothing is known."""

    depth: Floats
    normal: Floats
    intensity: Floats


@kernel
def interpolate(x, y, z, tables, distance, weight):
    """Interpolate the signed distance at (x, y, z) in shifted cells; UNKNOWN unless all eight cells are known."""
    root_origin, root, supers = tables
    ix, iy, iz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
    ax, ay, az = x - ix, y - iy, z - iz
    value = 0.0
    first = find_cell(ix, iy, iz, root_origin, root, supers)
    if first < 0 or weight[first] <= 0.0:
        return UNKNOWN
    inside = (ix & 7) < 7 and (iy & 7) < 7 and (iz & 7) < 7
    for k in range(8):
        dx, dy, dz = k & 1, (k >> 1) & 1, k >> 2
        cell = first + dx + 8 * dy + 64 * dz
        if not inside:
            cell = find_cell(ix + dx, iy + dy, iz + dz, root_origin, root, supers)
        if cell < 0 or weight[cell] <= 0.0:
            return UNKNOWN
        share = (ax if dx else 1.0 - ax) * (ay if dy else 1.0 - ay) * (az if dz else 1.0 - az)
        value += share * distance[cell]
    return value


@kernel
def slope_within(x, y, z, tables, distance, weight, gradient):
    """Take the gradient of the signed distance at (x, y, z) from the eight cells around; tell if all are known."""
    root_origin, root, supers = tables
    ix, iy, iz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
    ax, ay, az = x - ix, y - iy, z - iz
    gradient[:] = 0.0
    for k in range(8):
        dx, dy, dz = k & 1, (k >> 1) & 1, k >> 2
        cell = find_cell(ix + dx, iy + dy, iz + dz, root_origin, root, supers)
        if cell < 0 or weight[cell] <= 0.0:
            return False
        sx, sy, sz = ax if dx else 1.0 - ax, ay if dy else 1.0 - ay, az if dz else 1.0 - az
        gradient[0] += (2 * dx - 1) * sy * sz * distance[cell]
        gradient[1] += (2 * dy - 1) * sx * sz * distance[cell]
        gradient[2] += (2 * dz - 1) * sx * sy * distance[cell]
    return True


@kernel
def march(ox, oy, oz, dx, dy, dz, t, t_far, voxel_size, tables, distance, weight):
    """Return the depth at which a ray passes from the front of a known surface to its back, or 0."""
    root_origin, root, supers = tables
    norm = np.sqrt(dx * dx + dy * dy + dz * dz)
    nudge = max(RAY_NUDGE / norm, ROUNDING * t_far)
    before, t_before = UNKNOWN, 0.0
    block, bx, by, bz = np.int32(-1), np.int64(0), np.int64(0), np.int64(0)
    while t < t_far:
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        cx, cy, cz = np.int64(np.floor(x + 0.5)), np.int64(np.floor(y + 0.5)), np.int64(np.floor(z + 0.5))
        if block < 0 or cx >> 3 != bx or cy >> 3 != by or cz >> 3 != bz:
            bx, by, bz = cx >> 3, cy >> 3, cz >> 3
            block = find_block(bx, by, bz, root_origin, root, supers)
        if block < 0:
            size = float(SUPER_SIDE) if block == MISSING_SUPER else float(BLOCK_SIDE)
            shift = 6 if block == MISSING_SUPER else 3
            leave = min(
                next_crossing((ox + 0.5) / size, dx / size, cx >> shift),
                next_crossing((oy + 0.5) / size, dy / size, cy >> shift),
                next_crossing((oz + 0.5) / size, dz / size, cz >> shift),
            )
            t = max(leave, t) + nudge
            before = UNKNOWN
            continue
        cell = np.int64(block) * BLOCK_CELLS + (cx & 7) + 8 * (cy & 7) + 64 * (cz & 7)
        if weight[cell] <= 0.0:
            before = UNKNOWN
            t += STEP / norm
            continue
        here = np.float64(distance[cell])
        if here <= 0.0 and before < UNKNOWN and before > 0.0:
            exact_before = interpolate(
                ox + t_before * dx, oy + t_before * dy, oz + t_before * dz, tables, distance, weight
            )
            exact_here = interpolate(x, y, z, tables, distance, weight)
            if exact_before < UNKNOWN and exact_here < UNKNOWN and exact_before > exact_here:
                before, here = exact_before, exact_here
            if before - here < MAX_CHANGE * voxel_size:
                share = min(max(before / (before - here), -EXTRAPOLATION), 1.0 + EXTRAPOLATION)
                return t_before + (t - t_before) * share
            return 0.0
        before, t_before = here, t
        t += max(STEP * abs(here) / voxel_size, MIN_STEP) / norm
    return 0.0


@inlined
def facing_gradient(x, y, z, d, flat, tables, distance, weight, gradient):
    """Set the gradient (3,) of the signed distance where a ray of direction `d` met the surface.

    Return its length, 0 if too little is known or the surface faces away. See `cast_evidence` for `flat`.
    """
    known = True
    for axis in range(3):
        ex, ey, ez = NORMAL_REACH * (axis == 0), NORMAL_REACH * (axis == 1), NORMAL_REACH * (axis == 2)
        ahead = interpolate(x + ex, y + ey, z + ez, tables, distance, weight)
        behind = interpolate(x - ex, y - ey, z - ez, tables, distance, weight)
        known = known and ahead < UNKNOWN and behind < UNKNOWN
        gradient[axis] = ahead - behind
    # Behind a surface seen at a flat angle little is known.
    if not known and not (flat and slope_within(x, y, z, tables, distance, weight, gradient)):
        return 0.0
    facing = gradient[0] * d[0] + gradient[1] * d[1] + gradient[2] * d[2]
    return 0.0 if facing >= 0.0 else np.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)


@inlined
def luma_at(x, y, z, tables, color, color_weight):
    """Interpolate the luma at (x, y, z), all cells around which are known; NaN where none of them has a color."""
    root_origin, root, supers = tables
    total, luma = 0.0, 0.0
    ix, iy, iz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
    for corner in range(8):
        ox, oy, oz = corner & 1, (corner >> 1) & 1, corner >> 2
        cell = find_cell(ix + ox, iy + oy, iz + oz, root_origin, root, supers)
        if color_weight[cell] > 0.0:
            w = abs(1 - ox - (x - ix)) * abs(1 - oy - (y - iy)) * abs(1 - oz - (z - iz)) + MIN_SHARE
            total += w
            luma += w * (RED * color[cell, 0] + GREEN * color[cell, 1] + BLUE * color[cell, 2])
    return luma / total if total > 0.0 else np.nan


@kernel
def cast_evidence(rays, numbers, start, stop, T_cells_camera, tiles, cells, flat, view):
    """Cast the rays ``numbers[start:stop]`` into the evidence.

    Parameters
    ----------
    rays
        (n, 2) slopes; `T_cells_camera` (3, 4) leads to shifted cells, t is the depth in meters.
    tiles
        See `threedvc.kernels.render.tiles.Tiles`.
    cells
        See `EvidenceCells`.
    flat
        Whether surfaces that are seen at a flat angle count, of which only the cells around are known.
    view
        See `ViewRays`; written.
    """
    tile_origin, tile_size, tile_near, tile_far = tiles
    voxel_size, tables, distance, weight, color, color_weight = cells
    depth, normal, intensity = view
    T = T_cells_camera
    gradient = np.empty(3)
    for k in range(start, stop):
        r = numbers[k]
        depth[r] = 0.0
        intensity[r] = 0.0
        normal[r, 0], normal[r, 1], normal[r, 2] = 0.0, 0.0, 0.0
        sx, sy = rays[r, 0], rays[r, 1]
        column = min(max(np.int64((sx - tile_origin[0]) / tile_size[0]), 0), tile_near.shape[1] - 1)
        row = min(max(np.int64((sy - tile_origin[1]) / tile_size[1]), 0), tile_near.shape[0] - 1)
        dx = T[0, 0] * sx + T[0, 1] * sy + T[0, 2]
        dy = T[1, 0] * sx + T[1, 1] * sy + T[1, 2]
        dz = T[2, 0] * sx + T[2, 1] * sy + T[2, 2]
        t = march(
            T[0, 3], T[1, 3], T[2, 3], dx, dy, dz, tile_near[row, column], tile_far[row, column], voxel_size, tables,
            distance, weight,
        )  # fmt: skip
        if t <= 0.0:
            continue
        x, y, z = T[0, 3] + t * dx, T[1, 3] + t * dy, T[2, 3] + t * dz
        length = facing_gradient(x, y, z, (dx, dy, dz), flat, tables, distance, weight, gradient)
        if length <= 0.0:
            continue
        depth[r] = t
        scale = np.sqrt(T[0, 0] ** 2 + T[1, 0] ** 2 + T[2, 0] ** 2)
        for axis in range(3):
            normal[r, axis] = (T[0, axis] * gradient[0] + T[1, axis] * gradient[1] + T[2, axis] * gradient[2]) / (
                length * scale
            )
        intensity[r] = luma_at(x, y, z, tables, color, color_weight)


@kernel
def is_even(depth, normal, a, b, c, d):
    """Tell whether four rays at the corners of a square met one nearly plane surface, or nothing known."""
    near, far = min(depth[a], depth[b], depth[c], depth[d]), max(depth[a], depth[b], depth[c], depth[d])
    if near <= 0.0:
        return far <= 0.0
    if far - near > MAX_DEPTH_STEP * near:
        return False
    bend = 1.0 / depth[a] - 1.0 / depth[b] - 1.0 / depth[c] + 1.0 / depth[d]
    if abs(bend) * near > MAX_BEND:
        return False
    across = normal[a, 0] * normal[d, 0] + normal[a, 1] * normal[d, 1] + normal[a, 2] * normal[d, 2]
    athwart = normal[b, 0] * normal[c, 0] + normal[b, 1] * normal[c, 1] + normal[b, 2] * normal[c, 2]
    return min(across, athwart) > MIN_COSINE


@kernel
def fill_from(place, a, b, depth, normal, intensity, done):
    """Interpolate a ray between two others, unless they met nothing."""
    done[place] = 1
    depth[place], intensity[place] = 0.0, 0.0
    normal[place, 0], normal[place, 1], normal[place, 2] = 0.0, 0.0, 0.0
    if depth[a] <= 0.0:
        return
    depth[place] = 2.0 / (1.0 / depth[a] + 1.0 / depth[b])
    x, y, z = normal[a, 0] + normal[b, 0], normal[a, 1] + normal[b, 1], normal[a, 2] + normal[b, 2]
    length = np.sqrt(x * x + y * y + z * z)
    normal[place, 0], normal[place, 1], normal[place, 2] = x / length, y / length, z / length
    intensity[place] = 0.5 * (intensity[a] + intensity[b])


@kernel
def fill_between(start, stop, width, depth, normal, intensity, done):
    """Interpolate rays between those at even rows and columns where these met one even surface, or nothing.

    Squares ``start..stop`` in rows of squares, whose corners are known; the rows of the last lie in the picture.

    Parameters
    ----------
    width
        Rays in a row.
    depth, normal, intensity
        As of `cast_evidence`, updated.
    done
        (n,) uint8: set to 1 where a ray is interpolated.
    """
    for row in range(2 * start, 2 * stop, 2):
        for column in range(0, width - 2, 2):
            a = row * width + column
            b, c = a + 2, a + 2 * width
            if is_even(depth, normal, a, b, c, c + 2):
                fill_from(a + 1, a, b, depth, normal, intensity, done)
                fill_from(a + width, a, c, depth, normal, intensity, done)
                fill_from(a + width + 1, b, c, depth, normal, intensity, done)
