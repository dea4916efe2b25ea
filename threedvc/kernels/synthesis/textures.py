# SPDX-License-Identifier: MIT
"""Procedural textures: noise, patterns, pictures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.synthesis.parts import CHECKER, MARBLE, NOISE, PATCHES, PICTURE, WOOD, Vector

__all__ = ["pattern_color"]

OCTAVES = 3
"""Octaves of noise, the last a quarter as wide as the first."""
GRAIN = 35.0
"""Periods of the grain per meter: they are 3 cm wide."""
GRAIN_SEED = 17
"""Added to a part's seed, so that its grain is not its pattern."""


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
    """Interpolate a repeating picture between its four texels; u to the right and v up, in pictures from its center."""
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
    """Return the weight of a pattern's second color, 0..1, at a body point and its texture coordinates."""
    scale = part["scale"]
    pattern, seed = part["pattern"], part["seed"]
    if pattern == CHECKER:
        return float((math.floor(u / scale[0]) + math.floor(v / scale[1])) % 2)
    x, y, z = x / scale[0], y / scale[0], z / scale[0]
    if pattern == NOISE:
        return fractal_noise(x, y, z, seed)
    # How often veins and rings come, and how sharp patches are, is a matter of looks.
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
    """Return the unlit color, 0..255, of a point in body coordinates with texture coordinates (u, v), meters."""
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
        shade = 1.0 + grain * (fractal_noise(GRAIN * x, GRAIN * y, GRAIN * z, part["seed"] + GRAIN_SEED) - 0.5)
        red, green, blue = red * shade, green * shade, blue * shade
    return red, green, blue
