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

__all__ = [
    "BOX",
    "CAPSULE",
    "CHECKER",
    "ELLIPSOID",
    "FRUSTUM",
    "MARBLE",
    "NOISE",
    "PART",
    "PATCHES",
    "PICTURE",
    "PLAIN",
    "RECTANGLE",
    "TILE",
    "TORUS",
    "WOOD",
    "hit_distance",
    "mark_hidden",
    "pattern_color",
    "surface",
    "trace_color",
    "trace_depth",
]

RECTANGLE, BOX, ELLIPSOID, FRUSTUM, CAPSULE, TORUS = range(6)
PLAIN, CHECKER, NOISE, MARBLE, WOOD, PATCHES, PICTURE = range(7)

PART = np.dtype(
    [
        ("kind", np.int32),
        ("pattern", np.int32),
        ("label", np.int32),
        ("seed", np.int64),
        ("size", np.float64, (3,)),
        ("T_part_camera", np.float64, (3, 4)),
        ("T_body_camera", np.float64, (3, 4)),
        ("colors", np.float64, (2, 3)),
        ("scale", np.float64, (2,)),
        ("grain", np.float64),
        ("picture", np.int64, (3,)),
    ],
    align=True,
)
"""One primitive of one picture.

``size`` in metres as in `threedvc.synthesis.shapes`; ``colors`` in 0..255; ``scale`` is the period of the
pattern along u and v in metres; ``picture`` is the first texel, height and width of a picture.
"""

Vector = tuple[float, float, float]

TILE = 8
NEAREST_T = 1e-9
SHADOW_T = 1e-6
BISECTIONS = 60
OCTAVES = 3
GRAIN = 35.0


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
    """Distance to a capsule about z: radius ``size[0]``, half length ``size[1]`` between the centres of its ends."""
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

    Measured from the point nearest to the centre the quartic is ``s^4 + p s^2 + q s + r``. Between the
    roots of its derivative it is monotone, and so is the derivative between the roots of the second.
    """
    length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    x, y, z = d[0] / length, d[1] / length, d[2] / length
    start = -(o[0] * x + o[1] * y + o[2] * z)
    cx, cy, cz = o[0] + start * x, o[1] + start * y, o[2] + start * z
    square = cx * cx + cy * cy + cz * cz
    # The bound is a little wide, so that the quartic is surely positive at its ends.
    reach = 1.001 * (size[0] + size[1]) ** 2 - square
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
        Origin and direction of the ray in the frame of the primitive, metres.
    size
        (3,) sizes in metres, see the function of each primitive.
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
    of its rays, a ray passes a sphere's centre b at no less than ``dist(b, c) - w |b|``.
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
        if aside - wide * math.sqrt(distance) <= bounds[i, 3] * (1.0 + 1e-9):
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
    """Return which of the selected parts a ray from the camera's centre meets first (-1: none), and where."""
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
def surface(kind: int, size: Any, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the outward unit normal and the texture coordinates (metres) of a surface point of a primitive."""
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


@kernel
def lattice_value(x: int, y: int, z: int, seed: int) -> float:
    """Hash a lattice point to a number in 0..1."""
    h = (x * 374761393 + y * 668265263 + z * 1440662683 + seed * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 739982445) & 0xFFFFFFFF
    h = ((h ^ (h >> 12)) * 695872825) & 0xFFFFFFFF
    return (h ^ (h >> 15)) / 4294967295.0


@kernel
def value_noise(x: float, y: float, z: float, seed: int) -> float:
    """Interpolate the hashed values of the eight lattice points about a point, 0..1."""
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    ix, iy, iz = int(fx), int(fy), int(fz)
    x, y, z = x - fx, y - fy, z - fz
    x, y, z = x * x * (3.0 - 2.0 * x), y * y * (3.0 - 2.0 * y), z * z * (3.0 - 2.0 * z)
    total = 0.0
    for corner in range(8):
        cx, cy, cz = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (x if cx else 1.0 - x) * (y if cy else 1.0 - y) * (z if cz else 1.0 - z)
        total += weight * lattice_value(ix + cx, iy + cy, iz + cz, seed)
    return total


@kernel
def fractal_noise(x: float, y: float, z: float, seed: int) -> float:
    """Sum octaves of value noise, 0..1."""
    total, weight = 0.0, 1.0
    for octave in range(OCTAVES):
        total += weight * value_noise(x, y, z, seed + octave)
        x, y, z, weight = 2.0 * x, 2.0 * y, 2.0 * z, 0.5 * weight
    return total / (2.0 - 2.0 * weight)


@kernel
def texel_color(texels: NDArray[np.uint8], picture: Any, u: float, v: float) -> Vector:
    """Interpolate a repeating picture between its four texels; u to the right and v up, in pictures from its centre."""
    first, height, width = picture[0], picture[1], picture[2]
    column = (u + 0.5) * width - 0.5
    row = (0.5 - v) * height - 0.5
    left, top = math.floor(column), math.floor(row)
    fx, fy = column - left, row - top
    red = green = blue = 0.0
    for corner in range(4):
        dx, dy = corner & 1, corner >> 1
        weight = (fx if dx else 1.0 - fx) * (fy if dy else 1.0 - fy)
        at = first + (int(top) + dy) % height * width + (int(left) + dx) % width
        red += weight * texels[at, 0]
        green += weight * texels[at, 1]
        blue += weight * texels[at, 2]
    return red, green, blue


@kernel
def pattern_mix(part: Any, x: float, y: float, z: float, u: float, v: float) -> float:
    """Return the weight of a pattern's second colour, 0..1, at a body point and its texture coordinates."""
    scale = part["scale"]
    pattern, seed = part["pattern"], part["seed"]
    if pattern == CHECKER:
        return float((math.floor(u / scale[0]) + math.floor(v / scale[1])) % 2)
    x, y, z = x / scale[0], y / scale[0], z / scale[0]
    if pattern == NOISE:
        return fractal_noise(x, y, z, seed)
    if pattern == MARBLE:
        return 0.5 + 0.5 * math.sin(2.0 * (x + y + z) + 9.0 * fractal_noise(x, y, z, seed))
    if pattern == WOOD:
        ring = math.sqrt((y - 7.3) ** 2 + (z - 11.7) ** 2) + 1.5 * value_noise(0.1 * x, y, z, seed)
        ring -= math.floor(ring)
        return ring * ring
    if pattern == PATCHES:
        return min(max(24.0 * (fractal_noise(x, y, z, seed) - 0.53), 0.0), 1.0)
    return 0.0


@kernel
def pattern_color(part: Any, texels: NDArray[np.uint8], x: float, y: float, z: float, u: float, v: float) -> Vector:
    """Return the unlit colour, 0..255, of a point in body coordinates with texture coordinates (u, v), metres."""
    if part["pattern"] == PICTURE:
        red, green, blue = texel_color(texels, part["picture"], u / part["scale"][0], v / part["scale"][1])
    else:
        mix = pattern_mix(part, x, y, z, u, v)
        colors = part["colors"]
        red = colors[0, 0] + mix * (colors[1, 0] - colors[0, 0])
        green = colors[0, 1] + mix * (colors[1, 1] - colors[0, 1])
        blue = colors[0, 2] + mix * (colors[1, 2] - colors[0, 2])
    grain = part["grain"]
    if grain > 0.0:
        shade = 1.0 + grain * (fractal_noise(GRAIN * x, GRAIN * y, GRAIN * z, part["seed"] + 17) - 0.5)
        red, green, blue = red * shade, green * shade, blue * shade
    return red, green, blue


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
    """Return the lit colour, 0..255, of a point of the camera frame on part `found`."""
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
        (n, 4) bounding spheres of the parts: centre in the camera frame and radius, metres.
    depth, labels
        (height, width) outputs: z in metres (0 where the ray meets nothing) and the label of the part.
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
    """Average the lit colours of n x n rays through every pixel of the tile rows `start`..`stop`.

    Parameters
    ----------
    start, stop
        Range of rows of `TILE` pixels.
    rays
        (n * height, n * width, 2) ray slopes.
    parts
        (m,) records of `PART`, placed in this camera.
    bounds
        (m, 4) bounding spheres of the parts: centre in the camera frame and radius, metres.
    texels
        (t, 3) the texels of all pictures, RGB.
    lights
        (l, 4) positions in the camera frame, metres, and strengths; the first one casts shadows.
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
        (height, width, 2) ray slopes and (height, width) z in metres.
    parts
        (n,) records of `PART`, placed in this camera.
    bounds
        (n, 4) bounding spheres of the parts: centre in the camera frame and radius, metres.
    source
        (3,) position of the projector in the camera frame, metres.
    hidden
        (height, width) output.
    """
    target = (source[0], source[1], source[2])
    for row in range(start, stop):
        for column in range(rays.shape[1]):
            z = depth[row, column]
            point = (z * rays[row, column, 0], z * rays[row, column, 1], z)
            hidden[row, column] = z > 0.0 and is_blocked(parts, bounds, point, target, False)
