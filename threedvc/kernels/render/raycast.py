# SPDX-License-Identifier: MIT
"""First-opacity ray casting of decoded models.

Coordinates are in cells, shifted by half a cell so that integers are cell centers. Around a point the
surface is the zero of the weighted mean of the signed distances to the planes of the eight nearest
cells; the weights are trilinear and count occupied cells only. A ray is stopped where that mean changes
sign, if enough of the eight cells are occupied there or before the sign changes back.

Planes have no outside of their own. Where a ray comes near a surface they are turned against the ray, and
from there on each is turned as those before it along the ray: so a ray that passes beside a rim stays
outside, although the surface behind the rim turns its back on it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import inlined, kernel
from threedvc.kernels.blocks import BLOCK_SIDE, MISSING_SUPER, SUPER_SIDE, find_block
from threedvc.kernels.render.render_blocks import PLANE_SCALE

__all__ = ["FAR", "OPACITY", "CastBlocks", "Line", "cast_rays", "surface_at"]

OPACITY = 0.3
"""Weight of the occupied cells among eight that stops a ray: so outlines are round, and holes of one cell close
(decision 0003). As all numbers here, every reader must use it."""
FAR = 1e9
"""No surface, as a distance in cells or a depth in meters: nothing is drawn that far away."""
GRAZE = 0.4
"""Cells from a surface within which a ray is stopped that slips through the shell. Measured on the kitchen: where it
goes on .134 of the depth is lost instead of .050 (decision 0003)."""
RIM = 0.15
"""The same beside a rim, where most rays that come near pass by: outlines would be too fat."""
FRONTAL = 0.3
"""Cosine between a surface and the way back along the ray above which it still faces the ray, 73 degrees."""
MAX_DISTANCE = 2.0
"""Cells that a distance counts for at most in a secant step: planes that far away say little of the way to the hit."""
NEAR_END = 0.95
"""Part of the way through a cube where it is looked at if no cell of the face at its end is occupied: there weights
would be 0."""
SECANT_STEPS = 2
MIN_NORMAL = 1.0
"""Square of the length of a mean of normals, 127 long each, that tells a direction: of less they cancel out."""
MIN_DIRECTION = 1e-9
"""A component of a direction that is smaller is taken for this, which can be divided by."""
BLOCK_NUDGE, RAY_NUDGE = 1e-9, 1e-6
"""How far in cells a ray is pushed over the boundary of cells, or blocks, so that it lies behind it when rounded."""
ROUNDING = 1e-15
"""Some rounding errors of a 64-bit number, as a share of it: a push is no shorter, or cells a million cells away would
hold a ray for ever."""
LOWEST = np.array([0] + [(bits & -bits).bit_length() - 1 for bits in range(1, 256)])
"""Place of the lowest bit that is set."""


class CastBlocks(NamedTuple):
    """Render blocks of one object.

    Attributes
    ----------
    tables
        Their index, see `threedvc.kernels.blocks`.
    skip
        (blocks, 512) uint8: how many cells away the nearest cube with an occupied corner is.
    corners
        (blocks, 512) uint8: a bit for each occupied corner of a cube, that of x lowest.
    plane
        (blocks, 729, 4) int8 planes of the cells, border cells included.
    """

    tables: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]
    skip: NDArray[np.uint8]
    corners: NDArray[np.uint8]
    plane: NDArray[np.int8]


class Line(NamedTuple):
    """A ray in cells: its origin, its direction per unit of t, and that direction at unit length."""

    origin: tuple[float, float, float]
    direction: tuple[float, float, float]
    unit: tuple[float, float, float]


class Passage(NamedTuple):
    """What a ray takes from cube to cube and from block to block.

    Attributes
    ----------
    nearest_at, nearest
        Parameter and distance of the nearest approach to a surface that the ray has not crossed; distance FAR: none.
        A ray that leaves the neighborhood of a surface may be stopped there, else a shell of one cell would have
        streaks.
    crossed_at
        Parameter at which the ray has crossed a surface where too little is opaque, or FAR: if enough is further on,
        before the ray comes out again, it was stopped there.
    outward
        A direction that planes shall face, see `surface_at`.
    """

    nearest_at: float
    nearest: float
    crossed_at: float
    outward: tuple[float, float, float]


@inlined
def surface_at(corners, plane, block, base, point, unit, outward):
    """Measure the signed distance in cells at a point within the cube at `base`; FAR where no cell counts.

    Parameters
    ----------
    corners
        Bits of the corners that count: those occupied, on a face of the cube only those of that face.
    plane, block
        (render blocks, 729, 4) planes, and the number of the block.
    point
        Relative to the corner cell of the cube.
    unit
        Unit direction of the ray.
    outward
        A direction that planes shall face.

    Returns
    -------
    distance, normal, total
        Distance, the mean of the normals so turned, and how much of the weight the corners that count have.
    """
    x, y, z = point
    ux, uy, uz = unit
    gx, gy, gz = outward
    total, mean = 0.0, 0.0
    mx, my, mz = 0.0, 0.0, 0.0
    while corners:
        k = LOWEST[corners]
        corners &= corners - 1
        ix, iy, iz = k & 1, (k >> 1) & 1, k >> 2
        cell = base + ix + 9 * iy + 81 * iz
        ax, ay, az = x - ix, y - iy, z - iz
        w = (1.0 - abs(ax)) * (1.0 - abs(ay)) * (1.0 - abs(az))
        nx, ny, nz = (
            np.float64(plane[block, cell, 0]),
            np.float64(plane[block, cell, 1]),
            np.float64(plane[block, cell, 2]),
        )
        s = nx * ax + ny * ay + nz * az - plane[block, cell, 3]
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            s = -PLANE_SCALE * (ux * ax + uy * ay + uz * az)
        sign = -1.0 if nx * gx + ny * gy + nz * gz < 0.0 else 1.0
        signed = sign * w
        mx += signed * nx
        my += signed * ny
        mz += signed * nz
        mean += signed * s
        total += w
    return (mean / (total * PLANE_SCALE) if total > 0.0 else FAR), (mx, my, mz), total


@inlined
def point_on(line, t):
    """Return the point of a line at a parameter."""
    (ax, ay, az), (dx, dy, dz) = line.origin, line.direction
    return ax + t * dx, ay + t * dy, az + t * dz


@kernel
def next_crossing(o, d, i):
    """Return the ray parameter at which coordinate ``o + t d`` leaves the unit interval at `i`."""
    if d > 0.0:
        return (i + 1 - o) / d
    if d < 0.0:
        return (i - o) / d
    return FAR


@kernel
def away_from_zero(d):
    """Return a component of a direction, or a tiny one in place of nothing, which could not be divided by."""
    return d if abs(d) > MIN_DIRECTION else MIN_DIRECTION


@inlined
def refine_hit(corners, plane, block, base, line, outward, low, f_low, high, f_high):
    """Find the sign change between `low` and `high` by secant steps; return it, and the weight that counts there.

    The origin of the line is relative to the corner cell of the cube.
    """
    hit, opaque = low, 0.0
    for _ in range(SECANT_STEPS):
        hit = low + (high - low) * f_low / (f_low - f_high)
        f, _normal, opaque = surface_at(corners, plane, block, base, point_on(line, hit), line.unit, outward)
        if f > 0.0:
            low, f_low = hit, min(f, MAX_DISTANCE)
        else:
            high, f_high = hit, f
    return hit, opaque


@kernel
def is_stopped(distance, outward, unit):
    """Tell whether a ray is stopped that leaves the neighborhood of a surface without having crossed it.

    It has slipped through a shell of one cell if it came near and the surface still faces it where it leaves; beside
    a rim, behind which the surface turns away, it must have come much nearer.
    """
    if distance >= GRAZE:
        return False
    (gx, gy, gz), (ux, uy, uz) = outward, unit
    frontal = -(gx * ux + gy * uy + gz * uz) > FRONTAL * np.sqrt(gx * gx + gy * gy + gz * gz)
    return distance < (GRAZE if frontal else RIM)


@kernel
def leaving_face(axis, point, direction):
    """Put a point of a cube onto the face across `axis` by which a ray leaves; return it, and the face's corners."""
    (x, y, z), (dx, dy, dz) = point, direction
    if axis == 0:
        return ((1.0, y, z), 0b10101010) if dx > 0.0 else ((0.0, y, z), 0b01010101)
    if axis == 1:
        return ((x, 1.0, z), 0b11001100) if dy > 0.0 else ((x, 0.0, z), 0b00110011)
    return ((x, y, 1.0), 0b11110000) if dz > 0.0 else ((x, y, 0.0), 0b00001111)


@inlined
def pass_cube(occupied, axis, plane, block, base, line, t, t_out, before, opacity, passage):
    """Pass a cube with occupied corners from `t` to `t_out`.

    Parameters
    ----------
    occupied
        A bit for each occupied corner.
    axis
        Along which the ray leaves.
    line
        The ray, its origin relative to the corner cell of the cube.
    before
        Distance at `t` by the face that is shared with the cube before; FAR: not known.
    passage
        See `Passage`.

    Returns
    -------
    hit, before, passage
        The hit or FAR, and what the next cube takes.
    """
    nearest_at, nearest, crossed, outward = passage
    hit, last = FAR, t_out
    point, face = leaving_face(axis, point_on(line, last), line.direction)
    after, normal, opaque = surface_at(occupied & face, plane, block, base, point, line.unit, outward)
    if after == FAR:
        last = t + NEAR_END * (t_out - t)
        after, normal, opaque = surface_at(occupied, plane, block, base, point_on(line, last), line.unit, outward)
        opaque = 0.0
    if after > 0.0:
        crossed = FAR
        if after < nearest:
            nearest_at, nearest = last, after
    else:
        if before == FAR:
            before, _normal, _weight = surface_at(occupied, plane, block, base, point_on(line, t), line.unit, outward)
        if before > 0.0:
            crossed, opaque = refine_hit(
                occupied, plane, block, base, line, outward, t, min(before, MAX_DISTANCE), last, after
            )
        elif crossed == FAR:
            crossed = last
        if opaque > opacity:
            hit = crossed
        else:
            nearest = FAR
    nx, ny, nz = normal
    if nx * nx + ny * ny + nz * nz > MIN_NORMAL:
        outward = normal
    return hit, (after if last == t_out else FAR), Passage(nearest_at, nearest, crossed, outward)


@inlined
def cast_in_block(skip, corners, plane, block, line, inverse, t, t_end, opacity, passage):
    """Walk the cells of one render block from `t` to `t_end`.

    Parameters
    ----------
    skip, corners, plane
        See `CastBlocks`.
    block
        The number of the block.
    line
        The ray, its origin relative to the block, in cells.
    inverse
        One over each component of its direction, none of which is 0.
    passage
        See `Passage`.

    Returns
    -------
    hit, passage
        The parameter of the hit, or FAR, and what the next block takes.
    """
    (px, py, pz), (dx, dy, dz) = line.origin, line.direction
    inverse_x, inverse_y, inverse_z = inverse
    abs_x, abs_y, abs_z = abs(inverse_x), abs(inverse_y), abs(inverse_z)
    nudge = max(BLOCK_NUDGE * min(abs_x, abs_y, abs_z), ROUNDING * t_end)
    step_x, step_y, step_z = 1 if dx > 0.0 else -1, 1 if dy > 0.0 else -1, 1 if dz > 0.0 else -1
    qx, qy, qz = (px if dx <= 0.0 else px - 1.0), (py if dy <= 0.0 else py - 1.0), (pz if dz <= 0.0 else pz - 1.0)
    hit, inside = FAR, True
    while inside:
        before, began = FAR, t
        ix = min(max(np.int64(np.floor(px + t * dx)), 0), 7)
        iy = min(max(np.int64(np.floor(py + t * dy)), 0), 7)
        iz = min(max(np.int64(np.floor(pz + t * dz)), 0), 7)
        tx, ty, tz = (ix - qx) * inverse_x, (iy - qy) * inverse_y, (iz - qz) * inverse_z
        while inside and skip[block, ix + 8 * iy + 64 * iz] == 0:
            t_out = min(tx, ty, tz)
            axis = 0 if t_out == tx else (1 if t_out == ty else 2)
            occupied, base = np.int64(corners[block, ix + 8 * iy + 64 * iz]), ix + 9 * iy + 81 * iz
            within = Line((px - ix, py - iy, pz - iz), line.direction, line.unit)
            hit, before, passage = pass_cube(
                occupied, axis, plane, block, base, within, t, t_out, before, opacity, passage
            )
            t = t_out
            if axis == 0:
                ix += step_x
                tx = (ix - qx) * inverse_x
            elif axis == 1:
                iy += step_y
                ty = (iy - qy) * inverse_y
            else:
                iz += step_z
                tz = (iz - qz) * inverse_z
            inside = hit == FAR and t < t_end and min(ix, iy, iz) >= 0 and max(ix, iy, iz) <= 7
        if inside:
            if is_stopped(passage.nearest, passage.outward, line.unit):
                hit = passage.nearest_at
            passage = fresh_passage(passage.nearest_at, line.unit)
            free = skip[block, ix + 8 * iy + 64 * iz] - 1
            t = min(tx + free * abs_x, ty + free * abs_y, tz + free * abs_z) + nudge
            # Were a ray that far away set back by rounding, it could go round for ever.
            inside = hit == FAR and began < t < t_end
    return hit, passage


@inlined
def fresh_passage(nearest_at, unit):
    """Return the passage of a ray that no surface is near: planes shall face it."""
    ux, uy, uz = unit
    return Passage(nearest_at, FAR, FAR, (-ux, -uy, -uz))


@kernel
def cast_rays(rays, order, start, stop, T_cells_camera, tiles, blocks, label, opacity, depth, labels):
    """Cast rays ``order[start:stop]`` into one object and keep what is nearer than `depth` already holds.

    Parameters
    ----------
    rays
        (n, 2) float64 slopes.
    T_cells_camera
        (3, 4) from the camera to shifted cell coordinates; t of a ray is its depth in meters.
    tiles
        See `threedvc.kernels.render.tiles.Tiles`.
    blocks
        See `CastBlocks`.
    depth, labels
        (n,) float32 meters, 0 = nothing; (n,) uint8; updated.
    """
    tile_origin, tile_size, tile_near, tile_far = tiles
    tables, skip, corners, plane = blocks
    root_origin, root, supers = tables
    T = T_cells_camera
    ox, oy, oz = T[0, 3], T[1, 3], T[2, 3]
    for n in range(start, stop):
        r = order[n]
        sx, sy = rays[r, 0], rays[r, 1]
        column = min(max(np.int64((sx - tile_origin[0]) / tile_size[0]), 0), tile_near.shape[1] - 1)
        row = min(max(np.int64((sy - tile_origin[1]) / tile_size[1]), 0), tile_near.shape[0] - 1)
        t, t_far = tile_near[row, column], min(tile_far[row, column], FAR)
        if depth[r] > 0.0:
            t_far = min(t_far, np.float64(depth[r]))
        dx = away_from_zero(T[0, 0] * sx + T[0, 1] * sy + T[0, 2])
        dy = away_from_zero(T[1, 0] * sx + T[1, 1] * sy + T[1, 2])
        dz = away_from_zero(T[2, 0] * sx + T[2, 1] * sy + T[2, 2])
        inverse = 1.0 / dx, 1.0 / dy, 1.0 / dz
        nudge = max(RAY_NUDGE * min(abs(inverse[0]), abs(inverse[1]), abs(inverse[2])), ROUNDING * t_far)
        norm = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        unit = dx * norm, dy * norm, dz * norm
        passage = fresh_passage(FAR, unit)
        hit = FAR
        while t < t_far and hit == FAR:
            at = t + nudge
            bx = np.int64(np.floor((ox + at * dx) / BLOCK_SIDE))
            by = np.int64(np.floor((oy + at * dy) / BLOCK_SIDE))
            bz = np.int64(np.floor((oz + at * dz) / BLOCK_SIDE))
            number = find_block(bx, by, bz, root_origin, root, supers)
            size, shift = (float(SUPER_SIDE), 3) if number == MISSING_SUPER else (float(BLOCK_SIDE), 0)
            leave = min(
                (((bx >> shift) + (dx > 0.0)) * size - ox) * inverse[0],
                (((by >> shift) + (dy > 0.0)) * size - oy) * inverse[1],
                (((bz >> shift) + (dz > 0.0)) * size - oz) * inverse[2],
            )
            if number >= 0:
                line = Line((ox - bx * BLOCK_SIDE, oy - by * BLOCK_SIDE, oz - bz * BLOCK_SIDE), (dx, dy, dz), unit)
                hit, passage = cast_in_block(skip, corners, plane, number, line, inverse, at, leave, opacity, passage)
            elif is_stopped(passage.nearest, passage.outward, unit):
                hit = passage.nearest_at
            else:
                passage = fresh_passage(passage.nearest_at, unit)
            t = max(leave, at)
        if hit < t_far:
            depth[r] = hit
            labels[r] = label
