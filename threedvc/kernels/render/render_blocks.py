# SPDX-License-Identifier: MIT
"""What the ray caster needs of a model: blocks with a border, and a plane for every occupied cell.

A render block holds the 9x9x9 cells from its own first cell on, so that the eight cells around any
point between cell centers lie in one block.
"""

from __future__ import annotations

import numpy as np

from threedvc.kernels import kernel
from threedvc.kernels.blocks import BLOCK_CELLS, BLOCK_SIDE, find_cell

__all__ = [
    "BORDERED_CELLS",
    "BORDERED_SIDE",
    "PLANE_SCALE",
    "build_block",
    "fit_plane",
    "fit_planes",
    "spread_distance",
]

REACH = 2
"""Cells along each axis to which a plane is fitted: the mean of some twenty finds a surface to a fraction of a cell
(decision 0003). As all numbers here, every reader must use it."""
PATCH_SIDE = 2 * REACH + 1
SQUARINGS = 5
"""Squarings of the adjugate: its largest eigenvalue then stands out by the power of 32."""
MIN_TRACE = 1e-9
"""Of an adjugate, in cells to the power of four: less is rounding, the cells lie on a line or in a point."""
PLANE_SCALE = 127.0
"""What stands for 1 in the signed bytes of planes."""
EMPTY = -1
"""No relief: there is no cell."""
BORDERED_SIDE = BLOCK_SIDE + 1
BORDERED_CELLS = BORDERED_SIDE**3
"""Cells of a render block, border included."""
FAR_AWAY = BLOCK_SIDE
"""Steps to the nearest cube with an occupied cell where a block has none: as far as its other end."""


@kernel
def fit_plane(counts, moments, products, plane):
    """Fit a plane to weighted cells around a cell; write its normal and offset as int8.

    The normal is the eigenvector of the smallest eigenvalue of the covariance, found as the largest
    of its adjugate by squaring that matrix five times: + - * / and sqrt alone, so that every machine
    gets the same plane.

    Parameters
    ----------
    counts
        Sum of weights.
    moments, products
        Sums of weight times (x, y, z) and times (xx, yy, zz, xy, xz, yz), in cells from the cell's center.
    plane
        (4,) int8 output: normal * 127, offset of the plane from the center along it * 127; all 0 where
        the cells span no plane.
    """
    mx, my, mz = moments[0] / counts, moments[1] / counts, moments[2] / counts
    xx, yy, zz = products[0] / counts - mx * mx, products[1] / counts - my * my, products[2] / counts - mz * mz
    xy, xz, yz = products[3] / counts - mx * my, products[4] / counts - mx * mz, products[5] / counts - my * mz
    a, d, f = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    b, c, e = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - yz * xx
    for k in range(4):
        plane[k] = 0
    for _ in range(SQUARINGS):
        trace = a + d + f
        if not trace > MIN_TRACE:
            return
        a, b, c, d, e, f = a / trace, b / trace, c / trace, d / trace, e / trace, f / trace
        a, b, c, d, e, f = (
            a * a + b * b + c * c, a * b + b * d + c * e, a * c + b * e + c * f,
            b * b + d * d + e * e, b * c + d * e + e * f, c * c + e * e + f * f,
        )  # fmt: skip
    if a >= d and a >= f:
        nx, ny, nz = a, b, c
    elif d >= f:
        nx, ny, nz = b, d, e
    else:
        nx, ny, nz = c, e, f
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    offset = min(max(nx * mx + ny * my + nz * mz, -1.0), 1.0)
    plane[0] = np.int8(np.floor(nx * PLANE_SCALE + 0.5))
    plane[1] = np.int8(np.floor(ny * PLANE_SCALE + 0.5))
    plane[2] = np.int8(np.floor(nz * PLANE_SCALE + 0.5))
    plane[3] = np.int8(np.floor(offset * PLANE_SCALE + 0.5))


@kernel
def fit_planes(numbers, start, stop, coords, tables, occupied, relief, places, weights, planes):
    """Fit the planes of the occupied cells of blocks ``numbers[start:stop]`` into `planes` (blocks, 512, 4) int8.

    A cell counts with the point of it, of `places` (256, 3) in cells from its center, that its relief (blocks, 512)
    names; `weights` (5,) float64 weighs it by the distance of its center along each axis.
    """
    root_origin, root, supers = tables
    side = BLOCK_SIDE + 2 * REACH
    patch = np.zeros((side, side, side), dtype=np.int16)
    flat, flat_relief = occupied.reshape(-1), relief.reshape(-1)
    moments, products = np.empty(3), np.empty(6)
    for n in range(start, stop):
        b = numbers[n]
        x0 = coords[b, 0] * BLOCK_SIDE - REACH
        y0, z0 = coords[b, 1] * BLOCK_SIDE - REACH, coords[b, 2] * BLOCK_SIDE - REACH
        for z in range(side):
            for y in range(side):
                for x in range(side):
                    cell = find_cell(x0 + x, y0 + y, z0 + z, root_origin, root, supers)
                    patch[z, y, x] = flat_relief[cell] if cell >= 0 and flat[cell] != 0 else EMPTY
        for i in range(BLOCK_CELLS):
            if not occupied[b, i]:
                continue
            cx, cy, cz = i & 7, (i >> 3) & 7, i >> 6
            counts = 0.0
            moments[:] = 0.0
            products[:] = 0.0
            for dz in range(PATCH_SIDE):
                for dy in range(PATCH_SIDE):
                    for dx in range(PATCH_SIDE):
                        place = patch[cz + dz, cy + dy, cx + dx]
                        if place != EMPTY:
                            w = weights[dx] * weights[dy] * weights[dz]
                            x, y, z = float(dx - REACH), float(dy - REACH), float(dz - REACH)
                            x, y, z = x + places[place, 0], y + places[place, 1], z + places[place, 2]
                            counts += w
                            moments[0] += w * x
                            moments[1] += w * y
                            moments[2] += w * z
                            products[0] += w * x * x
                            products[1] += w * y * y
                            products[2] += w * z * z
                            products[3] += w * x * y
                            products[4] += w * x * z
                            products[5] += w * y * z
            fit_plane(counts, moments, products, planes[b, i])


@kernel
def build_block(targets, blocks, start, stop, tables, occupied, planes, skip, corners, cell_plane):
    """Fill render blocks ``start..stop`` of the list `blocks` (n, 3) at places `targets` (n,).

    Parameters
    ----------
    skip
        (render blocks, 512) uint8: how many steps away, along any axis or diagonal, the nearest cube within the
        block is that has an occupied cell at a corner; 8 where there is none.
    corners
        (render blocks, 512) uint8: a bit for each occupied corner of a cube, that of x lowest.
    cell_plane
        (render blocks, 729, 4) int8.
    """
    root_origin, root, supers = tables
    flat, flat_plane = occupied.reshape(-1), planes.reshape(-1, 4)
    state = np.empty(BORDERED_CELLS, dtype=np.bool_)
    for n in range(start, stop):
        t = targets[n]
        for i in range(BORDERED_CELLS):
            cell = find_cell(
                blocks[n, 0] * BLOCK_SIDE + i % BORDERED_SIDE,
                blocks[n, 1] * BLOCK_SIDE + i // BORDERED_SIDE % BORDERED_SIDE,
                blocks[n, 2] * BLOCK_SIDE + i // BORDERED_SIDE**2,
                root_origin, root, supers,
            )  # fmt: skip
            here = cell >= 0 and flat[cell] != 0
            state[i] = here
            for k in range(4):
                cell_plane[t, i, k] = flat_plane[cell, k] if here else 0
        for i in range(BLOCK_CELLS):
            base = (i & 7) + 9 * ((i >> 3) & 7) + 81 * (i >> 6)
            bits = 0
            for k in range(8):
                if state[base + (k & 1) + 9 * ((k >> 1) & 1) + 81 * (k >> 2)]:
                    bits |= 1 << k
            corners[t, i] = bits
            skip[t, i] = 0 if bits else FAR_AWAY
        spread_distance(skip[t])


@kernel
def spread_distance(skip):
    """Turn 0 and 8 in a block (512,) into Chebyshev distances to the nearest 0, in two sweeps."""
    for sweep in range(2):
        for i in range(BLOCK_CELLS):
            cell = i if sweep == 0 else BLOCK_CELLS - 1 - i
            x, y, z = cell & 7, (cell >> 3) & 7, cell >> 6
            for k in range(13):
                dx, dy, dz = k % 3 - 1, k // 3 % 3 - 1, k // 9 - 1
                if sweep:
                    dx, dy, dz = -dx, -dy, -dz
                nx, ny, nz = x + dx, y + dy, z + dz
                if 0 <= nx < 8 and 0 <= ny < 8 and 0 <= nz < 8:
                    skip[cell] = min(skip[cell], skip[nx + 8 * ny + 64 * nz] + 1)
