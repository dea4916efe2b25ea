# SPDX-License-Identifier: MIT
"""Analytic ray casting of solid primitives with procedural textures.

Every scene part is one record of `PART`: a primitive in its own frame, its placement in the camera
frame of one picture, and its texture. Distances are solved in closed form (the torus by isolating
the roots of its quartic), in float64, so depth is exact to rounding. Rays are ``origin + t *
direction``; a camera ray has the direction ``(x/z, y/z, 1)``, so its `t` is the depth.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.synthesis.parts import Vector
from threedvc.kernels.synthesis.shapes import hit_distance, surface
from threedvc.kernels.synthesis.textures import pattern_color

__all__ = ["TILE", "mark_hidden", "trace_color", "trace_depth"]

TILE = 8
"""Pixels along a side of a tile, whose parts are selected at once: few beside 64 rays, and still narrow."""
NEAREST_T = 1e-9
"""Depth in meters up to which a hit is the camera itself."""
SHADOW_T = 1e-6
"""Part of the way to a light up to which a hit is the surface itself, by rounding."""
ROUNDING = 1e-9
"""By how much of its radius a bounding sphere is widened, so that rounding leaves no part out."""


@kernel
def moved(T: NDArray[np.float64], x: float, y: float, z: float) -> Vector:
    """Apply a (3, 4) rigid transform to a point."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@kernel
def turned(T: NDArray[np.float64], x: float, y: float, z: float) -> Vector:
    """Apply the rotation of a (3, 4) rigid transform to a direction."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z,
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z,
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z,
    )


@kernel
def hit_part(part: Any, o: Vector, d: Vector, near: float) -> float:
    """Distance along a ray of the camera frame to a part."""
    T = part["T_part_camera"]
    return hit_distance(part["kind"], moved(T, o[0], o[1], o[2]), turned(T, d[0], d[1], d[2]), part["size"], near)


@kernel
def misses_bound(bounds: NDArray[np.float64], i: int, o: Vector, d: Vector) -> bool:
    """Tell whether the line of a ray passes by the bounding sphere of part `i`."""
    x, y, z = bounds[i, 0] - o[0], bounds[i, 1] - o[1], bounds[i, 2] - o[2]
    along = x * d[0] + y * d[1] + z * d[2]
    square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    return bool((x * x + y * y + z * z - bounds[i, 3] * bounds[i, 3]) * square > along * along)


@kernel
def select_parts(bounds: NDArray[np.float64], rays: NDArray[np.float64], selected: NDArray[np.int64]) -> int:
    """List the parts whose bounding spheres the rays of a tile may meet; returns how many.

    With c the unit direction of the tile's middle ray and w the largest ``|e - c|`` over the unit directions e
    of its rays, a ray passes a sphere's center b at no less than ``dist(b, c) - w |b|``.
    """
    height, width = rays.shape[0], rays.shape[1]
    c = unit_direction(rays[height // 2, width // 2])
    square = 0.0
    for row in range(height):
        for column in range(width):
            e = unit_direction(rays[row, column])
            square = max(square, (e[0] - c[0]) ** 2 + (e[1] - c[1]) ** 2 + (e[2] - c[2]) ** 2)
    wide = math.sqrt(square)
    count = 0
    for i in range(bounds.shape[0]):
        x, y, z = bounds[i, 0], bounds[i, 1], bounds[i, 2]
        along = x * c[0] + y * c[1] + z * c[2]
        distance = x * x + y * y + z * z
        aside = math.sqrt(max(distance - along * along, 0.0))
        if aside - wide * math.sqrt(distance) <= bounds[i, 3] * (1.0 + ROUNDING):
            selected[count] = i
            count += 1
    return count


@kernel
def unit_direction(slope: NDArray[np.float64]) -> Vector:
    """Return the unit direction of a camera ray."""
    length = math.sqrt(slope[0] * slope[0] + slope[1] * slope[1] + 1.0)
    return slope[0] / length, slope[1] / length, 1.0 / length


@kernel
def nearest_part(parts: Any, bounds: NDArray[np.float64], selected: NDArray[np.int64], d: Vector) -> tuple[int, float]:
    """Return which of the selected parts a ray from the camera's center meets first (-1: none), and where."""
    found, nearest = -1, np.inf
    origin = (0.0, 0.0, 0.0)
    for i in selected:
        if misses_bound(bounds, i, origin, d):
            continue
        t = hit_part(parts[i], origin, d, NEAREST_T)
        if t < nearest:
            found, nearest = i, t
    return found, nearest


@kernel
def is_blocked(parts: Any, bounds: NDArray[np.float64], p: Vector, to: Vector, background_only: bool) -> bool:
    """Tell whether any part stands between two points of the camera frame."""
    d = (to[0] - p[0], to[1] - p[1], to[2] - p[2])
    for i in range(bounds.shape[0]):
        if misses_bound(bounds, i, p, d) or (background_only and parts[i]["label"] != 0):
            continue
        if hit_part(parts[i], p, d, SHADOW_T) < 1.0:
            return True
    return False


@kernel
def illumination(
    parts: Any,
    bounds: NDArray[np.float64],
    lights: NDArray[np.float64],
    ambient: float,
    casts: bool,
    p: Vector,
    n: Vector,
) -> float:
    """Return ambient plus Lambert light at a point with a normal; the first light is blocked by the background."""
    total = ambient
    for i in range(lights.shape[0]):
        x, y, z = lights[i, 0] - p[0], lights[i, 1] - p[1], lights[i, 2] - p[2]
        cosine = (n[0] * x + n[1] * y + n[2] * z) / math.sqrt(x * x + y * y + z * z)
        if cosine <= 0.0:
            continue
        if casts and i == 0 and is_blocked(parts, bounds, p, (lights[0, 0], lights[0, 1], lights[0, 2]), True):
            continue
        total += lights[i, 3] * cosine
    return total


@kernel
def shaded_color(
    parts: Any,
    bounds: NDArray[np.float64],
    found: int,
    p: Vector,
    texels: NDArray[np.uint8],
    lights: NDArray[np.float64],
    ambient: float,
) -> Vector:
    """Return the lit color, 0..255, of a point of the camera frame on part `found`."""
    part = parts[found]
    T = part["T_part_camera"]
    x, y, z = moved(T, p[0], p[1], p[2])
    nx, ny, nz, u, v = surface(part["kind"], part["size"], x, y, z)
    n = (
        T[0, 0] * nx + T[1, 0] * ny + T[2, 0] * nz,
        T[0, 1] * nx + T[1, 1] * ny + T[2, 1] * nz,
        T[0, 2] * nx + T[1, 2] * ny + T[2, 2] * nz,
    )
    if n[0] * p[0] + n[1] * p[1] + n[2] * p[2] > 0.0:
        n = (-n[0], -n[1], -n[2])
    x, y, z = moved(part["T_body_camera"], p[0], p[1], p[2])
    red, green, blue = pattern_color(part, texels, x, y, z, u, v)
    light = illumination(parts, bounds, lights, ambient, part["label"] == 0, p, n)
    return min(light * red, 255.0), min(light * green, 255.0), min(light * blue, 255.0)


@kernel
def trace_depth(
    start: int,
    stop: int,
    rays: NDArray[np.float64],
    parts: Any,
    bounds: NDArray[np.float64],
    depth: NDArray[np.float64],
    labels: NDArray[np.uint8],
) -> None:
    """Cast one ray through every pixel of the tile rows `start`..`stop`.

    Parameters
    ----------
    start, stop
        Range of rows of `TILE` pixels.
    rays
        (height, width, 2) ray slopes.
    parts
        (n,) records of `PART`, placed in this camera.
    bounds
        (n, 4) bounding spheres of the parts: center in the camera frame and radius, meters.
    depth, labels
        (height, width) outputs: z in meters (0 where the ray meets nothing) and the label of the part.
    """
    selected = np.empty(bounds.shape[0], np.int64)
    for top in range(start * TILE, min(stop * TILE, depth.shape[0]), TILE):
        bottom = min(top + TILE, depth.shape[0])
        for left in range(0, depth.shape[1], TILE):
            right = min(left + TILE, depth.shape[1])
            count = select_parts(bounds, rays[top:bottom, left:right], selected)
            for row in range(top, bottom):
                for column in range(left, right):
                    d = (rays[row, column, 0], rays[row, column, 1], 1.0)
                    found, z = nearest_part(parts, bounds, selected[:count], d)
                    depth[row, column] = z if found >= 0 else 0.0
                    labels[row, column] = parts[found]["label"] if found >= 0 else 0


@kernel
def trace_color(
    start: int,
    stop: int,
    rays: NDArray[np.float64],
    parts: Any,
    bounds: NDArray[np.float64],
    texels: NDArray[np.uint8],
    lights: NDArray[np.float64],
    ambient: float,
    color: NDArray[np.float64],
) -> None:
    """Average the lit colors of n x n rays through every pixel of the tile rows `start`..`stop`.

    Parameters
    ----------
    start, stop
        Range of rows of `TILE` pixels.
    rays
        (n * height, n * width, 2) ray slopes.
    parts
        (m,) records of `PART`, placed in this camera.
    bounds
        (m, 4) bounding spheres of the parts: center in the camera frame and radius, meters.
    texels
        (t, 3) the texels of all pictures, RGB.
    lights
        (l, 4) positions in the camera frame, meters, and strengths; the first one casts shadows.
    ambient
        Strength of the light that comes from everywhere.
    color
        (height, width, 3) output, 0..255; black where a ray meets nothing.
    """
    n = rays.shape[0] // color.shape[0]
    selected = np.empty(bounds.shape[0], np.int64)
    color[start * TILE : stop * TILE] = 0.0
    for top in range(start * TILE, min(stop * TILE, color.shape[0]), TILE):
        bottom = min(top + TILE, color.shape[0])
        for left in range(0, color.shape[1], TILE):
            right = min(left + TILE, color.shape[1])
            count = select_parts(bounds, rays[n * top : n * bottom, n * left : n * right], selected)
            for row in range(n * top, n * bottom):
                for column in range(n * left, n * right):
                    x, y = rays[row, column, 0], rays[row, column, 1]
                    found, z = nearest_part(parts, bounds, selected[:count], (x, y, 1.0))
                    if found >= 0:
                        lit = shaded_color(parts, bounds, found, (z * x, z * y, z), texels, lights, ambient)
                        for channel in range(3):
                            color[row // n, column // n, channel] += lit[channel] / (n * n)


@kernel
def mark_hidden(
    start: int,
    stop: int,
    rays: NDArray[np.float64],
    depth: NDArray[np.float64],
    parts: Any,
    bounds: NDArray[np.float64],
    source: NDArray[np.float64],
    hidden: NDArray[np.bool_],
) -> None:
    """Mark the pixels of rows `start`..`stop` whose surface point is not reached from `source`.

    Parameters
    ----------
    rays, depth
        (height, width, 2) ray slopes and (height, width) z in meters.
    parts
        (n,) records of `PART`, placed in this camera.
    bounds
        (n, 4) bounding spheres of the parts: center in the camera frame and radius, meters.
    source
        (3,) position of the projector in the camera frame, meters.
    hidden
        (height, width) output.
    """
    target = (source[0], source[1], source[2])
    for row in range(start, stop):
        for column in range(rays.shape[1]):
            z = depth[row, column]
            point = (z * rays[row, column, 0], z * rays[row, column, 1], z)
            hidden[row, column] = z > 0.0 and is_blocked(parts, bounds, point, target, False)
