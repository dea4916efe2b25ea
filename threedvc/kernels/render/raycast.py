# SPDX-License-Identifier: MIT
"""First-opacity ray casting of decoded models.

Coordinates are in cells, shifted by half a cell so that integers are cell centres. Around a point the
surface is the zero of the weighted mean of the signed distances to the planes of the eight nearest
cells; the weights are trilinear and count occupied cells only. A ray is stopped where that mean changes
sign, if enough of the eight cells are occupied there or before the sign changes back.

Planes have no outside of their own. Where a ray comes near a surface they are turned against the ray, and
from there on each is turned as those before it along the ray: so a ray that passes beside a rim stays
outside, although the surface behind the rim turns its back on it.
"""

from __future__ import annotations

import numpy as np

from threedvc.kernels import inlined, kernel
from threedvc.kernels.blocks import find_block

__all__ = ["cast_rays", "surface_at", "tile_ranges"]

OPACITY = 0.3
FAR = 1e9
"""No surface, as a distance in cells or a depth in metres: nothing is drawn that far away."""
GRAZE = 0.4
RIM = 0.15
FRONTAL = 0.3
MAX_DISTANCE = 2.0
NEAR_END = 0.95
PLANE_SCALE = 127.0
LEAST_NORMAL = 1.0
BLOCK_NUDGE, RAY_NUDGE = 1e-9, 1e-6
"""How far in cells a ray is pushed over the boundary of cells, or blocks, so that it lies behind it when rounded."""
ROUNDING = 1e-15
"""Some rounding errors of a 64-bit number, as a share of it: a push is no shorter, or cells a million cells away would
hold a ray for ever."""
LOWEST = np.array([0] + [(bits & -bits).bit_length() - 1 for bits in range(1, 256)])
"""Place of the lowest bit that is set."""


@kernel
def tile_ranges(coords, count, T_camera_cells, tile_origin, tile_size, near, far):
    """Widen the depth range of every tile of the slope plane by the blocks that it can see.

    Parameters
    ----------
    coords
        (blocks, 3) block coordinates; the first `count` are in use.
    T_camera_cells
        (3, 4) from shifted cell coordinates to the camera.
    tile_origin, tile_size
        (2,) slope of the first tile's corner, and extent of a tile, along x and y.
    near, far
        (rows, columns) float64, updated.
    """
    T = T_camera_cells
    scale = np.sqrt(T[0, 0] * T[0, 0] + T[1, 0] * T[1, 0] + T[2, 0] * T[2, 0])
    radius = 8.0 * 0.8661 * scale
    rows, columns = near.shape
    for b in range(count):
        cx, cy, cz = coords[b, 0] * 8.0 + 4.0, coords[b, 1] * 8.0 + 4.0, coords[b, 2] * 8.0 + 4.0
        z = T[2, 0] * cx + T[2, 1] * cy + T[2, 2] * cz + T[2, 3]
        if z < -radius:
            continue
        front, back = max(z - radius, 0.0), z + radius
        left, right, top, bottom = 0, columns - 1, 0, rows - 1
        if front > 0.1 * radius:
            x = T[0, 0] * cx + T[0, 1] * cy + T[0, 2] * cz + T[0, 3]
            y = T[1, 0] * cx + T[1, 1] * cy + T[1, 2] * cz + T[1, 3]
            low_x, high_x = (
                min((x - radius) / front, (x - radius) / back),
                max((x + radius) / front, (x + radius) / back),
            )
            low_y, high_y = (
                min((y - radius) / front, (y - radius) / back),
                max((y + radius) / front, (y + radius) / back),
            )
            left = max(left, np.int64(np.floor(max(min((low_x - tile_origin[0]) / tile_size[0], 1e6), -1e6))))
            right = min(right, np.int64(np.floor(max(min((high_x - tile_origin[0]) / tile_size[0], 1e6), -1e6))))
            top = max(top, np.int64(np.floor(max(min((low_y - tile_origin[1]) / tile_size[1], 1e6), -1e6))))
            bottom = min(bottom, np.int64(np.floor(max(min((high_y - tile_origin[1]) / tile_size[1], 1e6), -1e6))))
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                near[row, column] = min(near[row, column], front)
                far[row, column] = max(far[row, column], back)


@inlined
def surface_at(corners, plane, block, base, x, y, z, ux, uy, uz, gx, gy, gz):
    """Measure the signed distance in cells at (x, y, z) within the cube at `base`; FAR where no cell counts.

    Parameters
    ----------
    corners
        Bits of the corners that count: those occupied, on a face of the cube only those of that face.
    plane
        (render blocks, 729, 4) planes.
    ux, uy, uz
        Unit direction of the ray.
    gx, gy, gz
        Outward: a direction that planes shall face.

    Returns
    -------
    distance, mx, my, mz, total
        Distance, the mean of the normals so turned, and how much of the weight the corners that count have.
    """
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
        turn = -1.0 if nx * gx + ny * gy + nz * gz < 0.0 else 1.0
        turned = turn * w
        mx += turned * nx
        my += turned * ny
        mz += turned * nz
        mean += turned * s
        total += w
    return (mean / (total * PLANE_SCALE) if total > 0.0 else FAR), mx, my, mz, total


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
    return d if abs(d) > 1e-9 else 1e-9


@inlined
def refine_hit(corners, plane, block, base, ax, ay, az, dx, dy, dz, ux, uy, uz, gx, gy, gz, low, f_low, high, f_high):
    """Find the sign change between `low` and `high` by two secant steps; return it, and the weight that counts there.

    (ax, ay, az) is the ray's origin relative to the corner cell of the cube, (dx, dy, dz) its direction.
    """
    hit, opaque = low, 0.0
    for _ in range(2):
        hit = low + (high - low) * f_low / (f_low - f_high)
        f, _x, _y, _z, opaque = surface_at(
            corners, plane, block, base, ax + hit * dx, ay + hit * dy, az + hit * dz, ux, uy, uz, gx, gy, gz
        )
        if f > 0.0:
            low, f_low = hit, min(f, MAX_DISTANCE)
        else:
            high, f_high = hit, f
    return hit, opaque


@kernel
def is_stopped(distance, gx, gy, gz, ux, uy, uz):
    """Tell whether a ray is stopped that leaves the neighbourhood of a surface without having crossed it.

    It has slipped through a shell of one cell if it came near and the surface still faces it where it leaves; beside
    a rim, behind which the surface turns away, it must have come much nearer.
    """
    if distance >= GRAZE:
        return False
    frontal = -(gx * ux + gy * uy + gz * uz) > FRONTAL * np.sqrt(gx * gx + gy * gy + gz * gz)
    return distance < (GRAZE if frontal else RIM)


@kernel
def leaving_face(axis, x, y, z, dx, dy, dz):
    """Put a point of a cube onto the face across `axis` by which a ray leaves; return it, and the face's corners."""
    if axis == 0:
        return (1.0, y, z, 0b10101010) if dx > 0.0 else (0.0, y, z, 0b01010101)
    if axis == 1:
        return (x, 1.0, z, 0b11001100) if dy > 0.0 else (x, 0.0, z, 0b00110011)
    return (x, y, 1.0, 0b11110000) if dz > 0.0 else (x, y, 0.0, 0b00001111)


@inlined
def pass_cube(
    occupied, axis, plane, block, base, ax, ay, az, dx, dy, dz, ux, uy, uz, t, t_out, before, opacity,
    passed_at, passed, crossed, gx, gy, gz,
):  # fmt: skip
    """Pass a cube with occupied corners from `t` to `t_out`.

    Parameters
    ----------
    occupied
        A bit for each occupied corner.
    axis
        Along which the ray leaves.
    ax, ay, az
        Origin of the ray relative to the corner cell of the cube.
    before
        Distance at `t` by the face that is shared with the cube before; FAR: not known.
    passed_at, passed, crossed, gx, gy, gz
        See `cast_in_block`.

    Returns
    -------
    hit, before, passed_at, passed, crossed, gx, gy, gz
        The hit or FAR, and what the next cube takes.
    """
    hit, last = FAR, t_out
    x, y, z, face = leaving_face(axis, ax + last * dx, ay + last * dy, az + last * dz, dx, dy, dz)
    after, nx, ny, nz, opaque = surface_at(
        occupied & face, plane, block, base, x, y, z, ux, uy, uz, gx, gy, gz
    )  # fmt: skip
    if after == FAR:
        last = t + NEAR_END * (t_out - t)
        after, nx, ny, nz, opaque = surface_at(
            occupied, plane, block, base, ax + last * dx, ay + last * dy, az + last * dz, ux, uy, uz, gx, gy, gz
        )
        opaque = 0.0
    if after > 0.0:
        crossed = FAR
        if after < passed:
            passed_at, passed = last, after
    else:
        if before == FAR:
            before, _x, _y, _z, _w = surface_at(
                occupied, plane, block, base, ax + t * dx, ay + t * dy, az + t * dz, ux, uy, uz, gx, gy, gz
            )
        if before > 0.0:
            crossed, opaque = refine_hit(
                occupied, plane, block, base, ax, ay, az, dx, dy, dz, ux, uy, uz, gx, gy, gz,
                t, min(before, MAX_DISTANCE), last, after,
            )  # fmt: skip
        elif crossed == FAR:
            crossed = last
        if opaque > opacity:
            hit = crossed
        else:
            passed = FAR
    if nx * nx + ny * ny + nz * nz > LEAST_NORMAL:
        gx, gy, gz = nx, ny, nz
    return hit, (after if last == t_out else FAR), passed_at, passed, crossed, gx, gy, gz


@inlined
def cast_in_block(
    skip, corners, plane, block, px, py, pz, dx, dy, dz, inverse_x, inverse_y, inverse_z, ux, uy, uz, t, t_end,
    opacity, passed_at, passed, crossed, gx, gy, gz,
):  # fmt: skip
    """Walk the cells of one render block from `t` to `t_end`.

    Parameters
    ----------
    skip
        (render blocks, 512) uint8: how many cells away the nearest cube with an occupied corner is.
    corners
        (render blocks, 512) uint8: a bit for each occupied corner of a cube, that of x lowest.
    plane, block
        (render blocks, 729, 4) int8, and the number of the block.
    px, py, pz
        Origin of the ray relative to the block, in cells; directions, none of them 0, are per unit of t.
    passed_at, passed
        Parameter and distance of the nearest approach to a surface that the ray has not crossed; distance FAR: none.
        A ray that leaves the neighbourhood of a surface may be stopped there, else a shell of one cell would have
        streaks.
    crossed
        Parameter at which the ray has crossed a surface where too little is opaque, or FAR: if enough is further on,
        before the ray comes out again, it was stopped there.
    gx, gy, gz
        Outward, see `surface_at`.

    Returns
    -------
    hit, passed_at, passed, crossed, gx, gy, gz
        The parameter of the hit, or FAR, and what the next block takes.
    """
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
            hit, before, passed_at, passed, crossed, gx, gy, gz = pass_cube(
                np.int64(corners[block, ix + 8 * iy + 64 * iz]), axis, plane, block, ix + 9 * iy + 81 * iz,
                px - ix, py - iy, pz - iz, dx, dy, dz, ux, uy, uz, t, t_out, before, opacity,
                passed_at, passed, crossed, gx, gy, gz,
            )  # fmt: skip
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
            if is_stopped(passed, gx, gy, gz, ux, uy, uz):
                hit = passed_at
            passed = crossed = FAR
            gx, gy, gz = -ux, -uy, -uz
            free = skip[block, ix + 8 * iy + 64 * iz] - 1
            t = min(tx + free * abs_x, ty + free * abs_y, tz + free * abs_z) + nudge
            # Were a ray that far away set back by rounding, it could go round for ever.
            inside = hit == FAR and began < t < t_end
    return hit, passed_at, passed, crossed, gx, gy, gz


@kernel
def cast_rays(
    rays, order, start, stop, T_cells_camera, tile_origin, tile_size, tile_near, tile_far, tables, skip,
    corners, plane, label, opacity, depth, labels,
):  # fmt: skip
    """Cast rays ``order[start:stop]`` into one object and keep what is nearer than `depth` already holds.

    Parameters
    ----------
    rays
        (n, 2) float64 slopes.
    T_cells_camera
        (3, 4) from the camera to shifted cell coordinates; t of a ray is its depth in metres.
    tables, skip, corners, plane
        Render blocks and their index.
    depth, labels
        (n,) float32 metres, 0 = nothing; (n,) uint8; updated.
    """
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
        inverse_x, inverse_y, inverse_z = 1.0 / dx, 1.0 / dy, 1.0 / dz
        nudge = max(RAY_NUDGE * min(abs(inverse_x), abs(inverse_y), abs(inverse_z)), ROUNDING * t_far)
        norm = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        ux, uy, uz = dx * norm, dy * norm, dz * norm
        passed_at, passed, crossed, gx, gy, gz = FAR, FAR, FAR, -ux, -uy, -uz
        hit = FAR
        while t < t_far and hit == FAR:
            at = t + nudge
            bx = np.int64(np.floor((ox + at * dx) / 8.0))
            by = np.int64(np.floor((oy + at * dy) / 8.0))
            bz = np.int64(np.floor((oz + at * dz) / 8.0))
            number = find_block(bx, by, bz, root_origin, root, supers)
            size, shift = (64.0, 3) if number == -2 else (8.0, 0)
            leave = min(
                (((bx >> shift) + (dx > 0.0)) * size - ox) * inverse_x,
                (((by >> shift) + (dy > 0.0)) * size - oy) * inverse_y,
                (((bz >> shift) + (dz > 0.0)) * size - oz) * inverse_z,
            )
            if number >= 0:
                hit, passed_at, passed, crossed, gx, gy, gz = cast_in_block(
                    skip, corners, plane, number, ox - bx * 8, oy - by * 8, oz - bz * 8, dx, dy, dz,
                    inverse_x, inverse_y, inverse_z, ux, uy, uz, at, leave, opacity,
                    passed_at, passed, crossed, gx, gy, gz,
                )  # fmt: skip
            elif is_stopped(passed, gx, gy, gz, ux, uy, uz):
                hit = passed_at
            else:
                passed, crossed, gx, gy, gz = FAR, FAR, -ux, -uy, -uz
            t = max(leave, at)
        if hit < t_far:
            depth[r] = hit
            labels[r] = label
