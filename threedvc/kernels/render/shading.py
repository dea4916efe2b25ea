# SPDX-License-Identifier: MIT
"""Color of surface points: trilinear interpolation between the colored cells around them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.blocks import find_cell

__all__ = [
    "LIGHT_TERMS",
    "MIN_WEIGHT",
    "SurfaceCells",
    "find_normals",
    "interpolation",
    "light_bases",
    "light_basis",
    "relight",
    "round_colors",
    "shade",
    "shade_from_picture",
]

MIN_WEIGHT = 1e-9
"""Added to weights, so that at a cell's center the others do not weigh nothing at all. As the next two, every reader
must use it."""
LIGHT_TERMS = 8
"""Linear and quadratic terms of a direction, the constant being the color itself."""
MIN_LIGHT = 0.05
"""Factor of colors at least, so that a fit's undershoot makes nothing black, or negative."""


class SurfaceCells(NamedTuple):
    """Cells of an object, and the surface in them.

    Attributes
    ----------
    tables
        Index of the cells, see `threedvc.kernels.blocks`.
    occupied
        (cells,) uint8.
    planes
        (cells, 4) int8 of `threedvc.kernels.render.render_blocks.fit_plane`.
    """

    tables: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]
    occupied: NDArray[np.uint8]
    planes: NDArray[np.int8]


@kernel
def interpolation(x, y, z, tables, colored, positions, weights):
    """Find the colored cells around a point and their weights, which sum up to one; return False if there are none.

    Parameters
    ----------
    x, y, z
        The point in cells; integers are cell centers.
    tables, colored
        Index of the cells, and (cells,) uint8: which of them have a color.
    positions, weights
        (8,) int64 and (8,) float64 outputs; a weight is 0 where there is no cell.
    """
    root_origin, root, supers = tables
    ix, iy, iz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
    x, y, z = x - ix, y - iy, z - iz
    total = 0.0
    for k in range(8):
        kx, ky, kz = k & 1, (k >> 1) & 1, k >> 2
        cell = find_cell(ix + kx, iy + ky, iz + kz, root_origin, root, supers)
        weights[k] = 0.0
        positions[k] = 0
        if cell >= 0 and colored[cell]:
            positions[k] = cell
            weights[k] = (x if kx else 1.0 - x) * (y if ky else 1.0 - y) * (z if kz else 1.0 - z) + MIN_WEIGHT
            total += weights[k]
    if total <= 0.0:
        return False
    for k in range(8):
        weights[k] /= total
    return True


@kernel
def shade(start, stop, slopes, depth, labels, label, T_cells_camera, tables, colored, colors, color, known):
    """Color the rays ``start..stop`` that met one object.

    Parameters
    ----------
    slopes
        (n, 2) float64 slopes of the rays.
    depth, labels
        (n,) float32 meters along z and (n,) uint8: what the rays met.
    T_cells_camera
        (3, 4) from the camera to cells whose centers are integers.
    tables, colored, colors
        Index of the cells, (cells,) uint8 and (cells, 3) int16 RGB.
    color, known
        (n, 3) float32 and (n,) uint8, written where the object was met and has a colored cell.
    """
    T = T_cells_camera
    root_origin, root, supers = tables
    for n in range(start, stop):
        if labels[n] != label or depth[n] <= 0.0 or known[n]:
            continue
        z = np.float64(depth[n])
        x, y = slopes[n, 0] * z, slopes[n, 1] * z
        px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        ix, iy, iz = np.int64(np.floor(px)), np.int64(np.floor(py)), np.int64(np.floor(pz))
        px, py, pz = px - ix, py - iy, pz - iz
        in_one_block = (ix & 7) < 7 and (iy & 7) < 7 and (iz & 7) < 7
        first = find_cell(ix, iy, iz, root_origin, root, supers)
        if in_one_block and first < 0:
            continue
        total, red, green, blue = 0.0, 0.0, 0.0, 0.0
        for k in range(8):
            kx, ky, kz = k & 1, (k >> 1) & 1, k >> 2
            if in_one_block:
                cell = first + kx + 8 * ky + 64 * kz
            else:
                cell = find_cell(ix + kx, iy + ky, iz + kz, root_origin, root, supers)
            if cell >= 0 and colored[cell]:
                w = (px if kx else 1.0 - px) * (py if ky else 1.0 - py) * (pz if kz else 1.0 - pz) + MIN_WEIGHT
                total += w
                red += w * colors[cell, 0]
                green += w * colors[cell, 1]
                blue += w * colors[cell, 2]
        if total > 0.0:
            color[n, 0], color[n, 1], color[n, 2] = red / total, green / total, blue / total
            known[n] = 1


@kernel
def round_colors(start, stop, values, gain, offset, picture):
    """Write rows ``start..stop`` of values (h, w, 3) float32, times a gain (3,) plus an offset (3,), as uint8."""
    for y in range(start, stop):
        for x in range(values.shape[1]):
            for channel in range(3):
                value = values[y, x, channel] * gain[channel] + offset[channel]
                picture[y, x, channel] = np.uint8(min(max(value, np.float32(0)), np.float32(255)) + np.float32(0.5))


@kernel
def shade_from_picture(start, stop, slopes, depth, labels, T_picture_camera, camera, picture, beyond, color, known):
    """Color the rays ``start..stop`` that met the background (label 0) from a picture of it.

    Parameters
    ----------
    slopes, depth, labels, color, known
        See `shade`.
    T_picture_camera
        (3, 4) from the camera to the camera of the picture.
    camera
        (9,) ``fx, fy, cx, cy, k1, k2, p1, p2, k3`` of the picture's camera.
    picture
        (h, w, 3) uint8 RGB.
    beyond
        Whether rays that met nothing take their color from the picture, too, as if it lay infinitely far away.
    """
    T = T_picture_camera
    height, width = picture.shape[0], picture.shape[1]
    k1, k2, p1, p2, k3 = camera[4], camera[5], camera[6], camera[7], camera[8]
    for n in range(start, stop):
        if labels[n] != 0 or known[n] or (depth[n] <= 0.0 and not beyond):
            continue
        x, y, z, at = slopes[n, 0], slopes[n, 1], 1.0, 0.0
        if depth[n] > 0.0:
            z, at = np.float64(depth[n]), 1.0
            x, y = x * z, y * z
        px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + at * T[0, 3]
        py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + at * T[1, 3]
        pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + at * T[2, 3]
        if pz <= 0.0:
            continue
        px, py = px / pz, py / pz
        r2 = px * px + py * py
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = camera[0] * (px * radial + 2.0 * p1 * px * py + p2 * (r2 + 2.0 * px * px)) + camera[2]
        v = camera[1] * (py * radial + p1 * (r2 + 2.0 * py * py) + 2.0 * p2 * px * py) + camera[3]
        if not (u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5):
            continue
        u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
        iu, iv = min(np.int64(u), max(width - 2, 0)), min(np.int64(v), max(height - 2, 0))
        ju, jv = min(iu + 1, width - 1), min(iv + 1, height - 1)
        fu, fv = u - iu, v - iv
        for k in range(3):
            above = picture[iv, iu, k] * (1.0 - fu) + picture[iv, ju, k] * fu
            below = picture[jv, iu, k] * (1.0 - fu) + picture[jv, ju, k] * fu
            color[n, k] = above * (1.0 - fv) + below * fv
        known[n] = 1


@kernel
def normal_at(x, y, z, dx, dy, dz, tables, occupied, planes, positions, weights, normal):
    """Interpolate the normal (3,) of the surface at a point, turned against a direction; return False if there is none.

    Parameters
    ----------
    x, y, z
        The point in cells; integers are cell centers.
    tables, occupied, planes
        Index of the cells, (cells,) uint8 and (cells, 4) int8.
    positions, weights
        (8,) int64 and (8,) float64 of no meaning to the caller.
    """
    if not interpolation(x, y, z, tables, occupied, positions, weights):
        return False
    nx, ny, nz = 0.0, 0.0, 0.0
    for k in range(8):
        cell = positions[k]
        ax, ay, az = np.float64(planes[cell, 0]), np.float64(planes[cell, 1]), np.float64(planes[cell, 2])
        w = -weights[k] if ax * dx + ay * dy + az * dz > 0.0 else weights[k]
        nx, ny, nz = nx + w * ax, ny + w * ay, nz + w * az
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if length <= 0.0:
        return False
    normal[0], normal[1], normal[2] = nx / length, ny / length, nz / length
    return True


@kernel
def find_normals(points, directions, tables, occupied, planes, normals):
    """Write the normals (n, 3) at points (n, 3) in cells, turned against directions (n, 3); 0 where there is none."""
    positions, weights = np.empty(8, dtype=np.int64), np.empty(8)
    for i in range(points.shape[0]):
        normals[i] = 0.0
        normal_at(
            points[i, 0], points[i, 1], points[i, 2], directions[i, 0], directions[i, 1], directions[i, 2],
            tables, occupied, planes, positions, weights, normals[i],
        )  # fmt: skip


@kernel
def light_basis(x, y, z, terms):
    """Write the linear and quadratic terms (8,) of a direction by which light differs from all around."""
    terms[0], terms[1], terms[2] = x, y, z
    terms[3], terms[4], terms[5] = x * y, y * z, z * x
    terms[6], terms[7] = x * x - y * y, 3.0 * z * z - 1.0


@kernel
def light_bases(normals, terms):
    """Write the terms (n, 8) of `light_basis` for normals (n, 3)."""
    for i in range(normals.shape[0]):
        light_basis(normals[i, 0], normals[i, 1], normals[i, 2], terms[i])


@kernel
def relight(start, stop, slopes, depth, labels, label, T_cells_camera, R_world_object, light, cells, color):
    """Multiply the colors of rays ``start..stop`` that met an object by the light on its surface there.

    Parameters
    ----------
    slopes, depth, labels, color
        See `shade`.
    T_cells_camera
        (3, 4) from the camera to cells of the model.
    R_world_object
        (3, 3) turn of the object in the world, where the light stands still.
    light
        (8,) factors of the terms of `light_basis`; none of them: 1 everywhere.
    cells
        See `SurfaceCells`.
    """
    tables, occupied, planes = cells
    T, R = T_cells_camera, R_world_object
    positions, weights = np.empty(8, dtype=np.int64), np.empty(8)
    normal, terms = np.empty(3), np.empty(LIGHT_TERMS)
    for n in range(start, stop):
        if labels[n] != label or depth[n] <= 0.0:
            continue
        z = np.float64(depth[n])
        x, y = slopes[n, 0] * z, slopes[n, 1] * z
        dx = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z
        dy = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z
        dz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z
        if not normal_at(
            dx + T[0, 3], dy + T[1, 3], dz + T[2, 3], dx, dy, dz, tables, occupied, planes, positions, weights, normal
        ):
            continue
        light_basis(
            R[0, 0] * normal[0] + R[0, 1] * normal[1] + R[0, 2] * normal[2],
            R[1, 0] * normal[0] + R[1, 1] * normal[1] + R[1, 2] * normal[2],
            R[2, 0] * normal[0] + R[2, 1] * normal[1] + R[2, 2] * normal[2],
            terms,
        )
        factor = 1.0
        for k in range(LIGHT_TERMS):
            factor += light[k] * terms[k]
        factor = max(factor, MIN_LIGHT)
        for k in range(3):
            color[n, k] = color[n, k] * factor
