# SPDX-License-Identifier: MIT
"""Where rays meet primitives, in closed form (the torus by isolating the roots of its quartic), and surfaces there."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from threedvc.kernels import kernel
from threedvc.kernels.synthesis.parts import BOX, CAPSULE, ELLIPSOID, FRUSTUM, RECTANGLE, Vector

__all__ = ["hit_distance", "surface"]

BISECTIONS = 60
"""Halvings of an interval: more than the 53 bits of a double."""
WIDER = 1.001
"""By how much the square of a torus's bound is widened, so that the quartic is surely positive at its ends."""


@kernel
def quadratic_roots(a: float, b: float, c: float) -> tuple[float, float]:
    """Return the roots of ``a t^2 + 2 b t + c``, the smaller first; infinities where there are none."""
    discriminant = b * b - a * c
    if discriminant < 0.0 or (a == 0.0 and b == 0.0):
        return np.inf, np.inf
    q = -(b + math.copysign(math.sqrt(discriminant), b))
    if q == 0.0:
        return 0.0, 0.0
    first = q / a if a != 0.0 else np.inf
    second = c / q
    return min(first, second), max(first, second)


@kernel
def earlier(first: float, second: float, near: float) -> float:
    """Return the first of two ordered distances that lies beyond `near`, else infinity."""
    if first > near:
        return first
    return second if second > near else np.inf


@kernel
def hit_rectangle(o: Vector, d: Vector, size: Any, near: float) -> float:
    """Distance to the rectangle ``|x| <= size[0], |y| <= size[1]`` in the plane z = 0."""
    if d[2] == 0.0:
        return np.inf
    t = -o[2] / d[2]
    inside = abs(o[0] + t * d[0]) <= size[0] and abs(o[1] + t * d[1]) <= size[1]
    return t if inside and t > near else np.inf


@kernel
def hit_box(o: Vector, d: Vector, size: Any, near: float) -> float:
    """Distance to the box of half edges `size`."""
    enter, leave = -np.inf, np.inf
    for axis in range(3):
        if d[axis] == 0.0:
            if abs(o[axis]) > size[axis]:
                return np.inf
            continue
        low = (-size[axis] - o[axis]) / d[axis]
        high = (size[axis] - o[axis]) / d[axis]
        enter = max(enter, min(low, high))
        leave = min(leave, max(low, high))
    return earlier(enter, leave, near) if enter <= leave else np.inf


@kernel
def hit_ellipsoid(o: Vector, d: Vector, size: Any, near: float) -> float:
    """Distance to the ellipsoid of semi-axes `size`."""
    a = b = 0.0
    c = -1.0
    for axis in range(3):
        oi = o[axis] / size[axis]
        di = d[axis] / size[axis]
        a += di * di
        b += oi * di
        c += oi * oi
    first, second = quadratic_roots(a, b, c)
    return earlier(first, second, near)


@kernel
def hit_frustum(o: Vector, d: Vector, size: Any, near: float) -> float:
    """Distance to a closed, cut cone about z: bottom and top radius ``size[:2]``, half height ``size[2]``."""
    half = size[2]
    middle = 0.5 * (size[0] + size[1])
    slope = 0.5 * (size[1] - size[0]) / half
    radius = middle + slope * o[2]
    growth = slope * d[2]
    a = d[0] * d[0] + d[1] * d[1] - growth * growth
    b = o[0] * d[0] + o[1] * d[1] - radius * growth
    c = o[0] * o[0] + o[1] * o[1] - radius * radius
    nearest = np.inf
    for t in quadratic_roots(a, b, c):
        # The mirrored half of a cone, where the radius is negative, lies outside the caps.
        if near < t < nearest and abs(o[2] + t * d[2]) <= half:
            nearest = t
    if d[2] != 0.0:
        for side in range(2):
            t = (half * (2 * side - 1) - o[2]) / d[2]
            x = o[0] + t * d[0]
            y = o[1] + t * d[1]
            if near < t < nearest and x * x + y * y <= size[side] * size[side]:
                nearest = t
    return nearest


@kernel
def hit_capsule(o: Vector, d: Vector, size: Any, near: float) -> float:
    """Distance to a capsule about z: radius ``size[0]``, half length ``size[1]`` between the centers of its ends."""
    square = size[0] * size[0]
    half = size[1]
    across = d[0] * d[0] + d[1] * d[1]
    along = o[0] * d[0] + o[1] * d[1]
    offset = o[0] * o[0] + o[1] * o[1] - square
    nearest = np.inf
    for t in quadratic_roots(across, along, offset):
        if near < t < nearest and abs(o[2] + t * d[2]) <= half:
            nearest = t
    for side in range(2):
        end = half * (2 * side - 1)
        z = o[2] - end
        for t in quadratic_roots(across + d[2] * d[2], along + z * d[2], offset + z * z):
            if near < t < nearest and (o[2] + t * d[2] - end) * end >= 0.0:
                nearest = t
    return nearest


@kernel
def bisect(c4: float, c3: float, c2: float, c1: float, c0: float, low: float, high: float) -> float:
    """Return the root of a quartic that is monotone between `low` and `high`, NaN where it has none there."""
    at_low = (((c4 * low + c3) * low + c2) * low + c1) * low + c0
    at_high = (((c4 * high + c3) * high + c2) * high + c1) * high + c0
    if at_low * at_high > 0.0:
        return np.nan
    rising = at_low < 0.0 or (at_low == 0.0 and at_high > 0.0)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        value = (((c4 * middle + c3) * middle + c2) * middle + c1) * middle + c0
        if (value < 0.0) == rising:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def hit_torus(o: Vector, d: Vector, size: Any, near: float) -> float:
    """Distance to a torus about z: ring radius ``size[0]``, tube radius ``size[1]``.

    Measured from the point nearest to the center the quartic is ``s^4 + p s^2 + q s + r``. Between the
    roots of its derivative it is monotone, and so is the derivative between the roots of the second.
    """
    length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    x, y, z = d[0] / length, d[1] / length, d[2] / length
    start = -(o[0] * x + o[1] * y + o[2] * z)
    cx, cy, cz = o[0] + start * x, o[1] + start * y, o[2] + start * z
    square = cx * cx + cy * cy + cz * cz
    reach = WIDER * (size[0] + size[1]) ** 2 - square
    if reach < 0.0:
        return np.inf
    reach = math.sqrt(reach)
    ring = 4.0 * size[0] * size[0]
    k = square + size[0] * size[0] - size[1] * size[1]
    p = 2.0 * k - ring * (x * x + y * y)
    q = -2.0 * ring * (cx * x + cy * y)
    r = k * k - ring * (cx * cx + cy * cy)
    turn = math.sqrt(-p / 6.0) if p < 0.0 else 0.0
    knots = (-reach, -turn, turn, reach)
    low = -reach
    for piece in range(4):
        high = reach
        if piece < 3:
            high = bisect(0.0, 4.0, 0.0, 2.0 * p, q, max(knots[piece], -reach), min(knots[piece + 1], reach))
            if not high > low:
                continue
        root = bisect(1.0, 0.0, p, q, r, low, high)
        low = high
        if (root + start) / length > near:
            return (root + start) / length
    return np.inf


@kernel
def hit_distance(kind: int, o: Vector, d: Vector, size: Any, near: float) -> float:
    """Distance ``t > near`` along a ray to a primitive in its own frame, infinity for a miss.

    Parameters
    ----------
    kind
        One of `RECTANGLE`, `BOX`, `ELLIPSOID`, `FRUSTUM`, `CAPSULE`, `TORUS`.
    o, d
        Origin and direction of the ray in the frame of the primitive, meters.
    size
        (3,) sizes in meters, see the function of each primitive.
    near
        Hits up to this distance are ignored.
    """
    if kind == RECTANGLE:
        return hit_rectangle(o, d, size, near)
    if kind == BOX:
        return hit_box(o, d, size, near)
    if kind == ELLIPSOID:
        return hit_ellipsoid(o, d, size, near)
    if kind == FRUSTUM:
        return hit_frustum(o, d, size, near)
    if kind == CAPSULE:
        return hit_capsule(o, d, size, near)
    return hit_torus(o, d, size, near)


@kernel
def surface(kind: int, size: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the outward unit normal and the texture coordinates (meters) of a surface point of a primitive."""
    if kind == RECTANGLE:
        return 0.0, 0.0, 1.0, x, y
    if kind == BOX:
        fx, fy, fz = abs(x) / size[0], abs(y) / size[1], abs(z) / size[2]
        if fx >= fy and fx >= fz:
            side = math.copysign(1.0, x)
            return side, 0.0, 0.0, side * y, z
        if fy >= fz:
            side = math.copysign(1.0, y)
            return 0.0, side, 0.0, -side * x, z
        return 0.0, 0.0, math.copysign(1.0, z), x, y
    turn = math.atan2(y, x)
    u, v = turn * size[0], z
    if kind == ELLIPSOID:
        nx, ny, nz = x / (size[0] * size[0]), y / (size[1] * size[1]), z / (size[2] * size[2])
    elif kind == FRUSTUM:
        slope = 0.5 * (size[1] - size[0]) / size[2]
        radius = math.sqrt(x * x + y * y)
        beyond_side = (radius - 0.5 * (size[0] + size[1]) - slope * z) / math.sqrt(1.0 + slope * slope)
        if abs(z) - size[2] > beyond_side:
            return 0.0, 0.0, math.copysign(1.0, z), x, y
        nx, ny, nz = x, y, -slope * radius
    elif kind == CAPSULE:
        nx, ny, nz = x, y, z - min(max(z, -size[1]), size[1])
    else:
        radius = math.sqrt(x * x + y * y)
        tube = (radius - size[0]) / radius
        nx, ny, nz = x * tube, y * tube, z
        v = math.atan2(z, radius - size[0]) * size[1]
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length, u, v
