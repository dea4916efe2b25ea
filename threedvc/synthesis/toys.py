# SPDX-License-Identifier: MIT
"""Things made of primitives: the toys that move, and the furniture that stands in a room.

Each function returns the parts of one thing in its own frame, in meters with z up. Toys have their
origin in their middle, furniture has it on the floor below its middle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threedvc.geometry.pose import Pose
from threedvc.synthesis import textures
from threedvc.synthesis.shapes import (
    Part,
    at,
    ball,
    box,
    capsule_between,
    cylinder,
    ellipsoid,
    frustum,
    frustum_between,
    torus,
    turned,
)
from threedvc.synthesis.textures import RGB, Texture

__all__ = [
    "COW_HOOF_Z",
    "MUG_BOTTOM_Z",
    "TRUCK_WHEEL_Z",
    "books",
    "cone",
    "cow",
    "floor_lamp",
    "globe",
    "mug",
    "placed",
    "ring",
    "sofa",
    "stool",
    "table",
    "truck",
    "vase",
]

COW_HOOF_Z = -0.155
"""Lowest point of the cow in its own frame, by which it is put on a table."""
MUG_BOTTOM_Z = -0.06
"""That of the mug."""
TRUCK_WHEEL_Z = -0.075
"""That of the truck."""

BROWN: RGB = (124, 84, 50)
DARK_BROWN: RGB = (84, 54, 32)
DARK: RGB = (44, 42, 46)
CREAM: RGB = (238, 232, 218)
RED: RGB = (196, 44, 40)
"""Colors that several things share, these five; by taste."""


def placed(parts: tuple[Part, ...], pose: Pose) -> tuple[Part, ...]:
    """Move a thing into another frame: ``p_outer = pose @ p_inner``."""
    return tuple(replace(part, T_body_part=pose @ part.T_body_part) for part in parts)


def cow(seed: int) -> tuple[Part, ...]:
    """Return a spotted toy cow, 0.37 m long, nose along x; blots and hide follow the seed."""
    hide = textures.patches(CREAM, DARK, 0.09, seed)
    pink, horn, hoof = textures.plain((226, 158, 140)), textures.plain((176, 112, 60)), textures.plain((70, 58, 52))
    body = (
        Part(shape=ellipsoid(0.118, 0.070, 0.074), texture=hide, T_body_part=at(-0.04, 0, -0.015)),
        capsule_between((0.03, 0, 0.0), (0.09, 0, 0.06), 0.046, hide),
        Part(shape=ellipsoid(0.054, 0.048, 0.050), texture=hide, T_body_part=at(0.108, 0, 0.078)),
        Part(shape=ellipsoid(0.034, 0.036, 0.028), texture=pink, T_body_part=at(0.153, 0, 0.060)),
        Part(shape=ellipsoid(0.034, 0.026, 0.020), texture=pink, T_body_part=at(-0.06, 0, -0.082)),
        capsule_between((-0.150, 0, 0.02), (-0.180, 0, -0.06), 0.008, hide),
        Part(shape=ball(0.016), texture=hoof, T_body_part=at(-0.181, 0, -0.068)),
    )
    sides = tuple(part for side in (-1.0, 1.0) for part in _cow_side(side, hide, horn, hoof))
    return body + sides


def _cow_side(side: float, hide: Texture, horn: Texture, hoof: Texture) -> tuple[Part, ...]:
    legs = tuple(
        part
        for x in (-0.11, 0.025)
        for part in (
            capsule_between((x, 0.042 * side, -0.05), (x, 0.045 * side, -0.115), 0.024, hide),
            Part(shape=frustum(0.029, 0.025, 0.032), texture=hoof, T_body_part=at(x, 0.045 * side, COW_HOOF_Z + 0.016)),
        )
    )
    return (
        *legs,
        Part(
            shape=ellipsoid(0.012, 0.034, 0.018),
            texture=hide,
            T_body_part=at(0.095, 0.066 * side, 0.092, turned(x=20 * side)),
        ),
        frustum_between((0.098, 0.024 * side, 0.115), (0.104, 0.040 * side, 0.158), 0.013, 0.003, horn),
        Part(shape=ball(0.011), texture=textures.plain(DARK), T_body_part=at(0.146, 0.027 * side, 0.094)),
        Part(shape=ball(0.006), texture=textures.plain((110, 60, 60)), T_body_part=at(0.183, 0.013 * side, 0.066)),
    )


def mug(first: RGB, second: RGB) -> tuple[Part, ...]:
    """Return a checkered mug with a handle, 0.12 m high, filled with coffee."""
    around = 2 * np.pi * 0.045
    glaze = textures.plain(first)
    return (
        Part(shape=cylinder(0.045, 0.118), texture=textures.checker(first, second, around / 12, 0.024)),
        Part(shape=cylinder(0.041, 0.004), texture=textures.plain((74, 44, 26)), T_body_part=at(0, 0, 0.058)),
        Part(shape=torus(0.043, 0.004), texture=glaze, T_body_part=at(0, 0, 0.059)),
        Part(shape=torus(0.032, 0.008), texture=glaze, T_body_part=at(0.048, 0, 0, turned(x=90))),
    )


def truck(body_color: RGB, seed: int) -> tuple[Part, ...]:
    """Return a wooden toy truck, 0.30 m long, front along x, with a marble drum as its load."""
    paint, tyre, hub = textures.plain(body_color), textures.plain(DARK), textures.plain((222, 190, 60))
    timber = textures.wood((214, 168, 108), (158, 108, 60), 0.012, seed)
    parts = [
        Part(shape=box(0.29, 0.09, 0.03), texture=timber, T_body_part=at(0, 0, -0.035)),
        Part(shape=box(0.08, 0.10, 0.10), texture=paint, T_body_part=at(0.085, 0, 0.03)),
        Part(shape=box(0.04, 0.09, 0.045), texture=paint, T_body_part=at(0.135, 0, 0.0)),
        Part(shape=box(0.084, 0.076, 0.035), texture=textures.plain((150, 196, 214)), T_body_part=at(0.085, 0, 0.052)),
        Part(
            shape=frustum(0.048, 0.034, 0.15),
            texture=textures.marble((70, 120, 168), (236, 236, 226), 0.05, seed + 5),
            T_body_part=at(-0.05, 0, 0.03, turned(y=-80)),
        ),
    ]
    for x in (-0.095, 0.095):
        for side in (-1.0, 1.0):
            wheel = at(x, 0.052 * side, TRUCK_WHEEL_Z + 0.034, turned(x=90))
            parts.append(Part(shape=torus(0.022, 0.012), texture=tyre, T_body_part=wheel))
            parts.append(Part(shape=cylinder(0.022, 0.014), texture=hub, T_body_part=wheel))
    return tuple(parts)


def table(width: float, depth: float, height: float, top: Texture) -> tuple[Part, ...]:
    """Return a table on four legs under a cloth."""
    leg = textures.wood(BROWN, DARK_BROWN, 0.02, 3)
    x, y = width / 2 - 0.06, depth / 2 - 0.06
    return (
        Part(shape=box(width, depth, 0.03), texture=top, T_body_part=at(0, 0, height - 0.015)),
        Part(shape=box(width - 0.08, depth - 0.08, 0.07), texture=leg, T_body_part=at(0, 0, height - 0.065)),
        *(
            frustum_between((sx * x, sy * y, 0), (sx * x, sy * y, height - 0.03), 0.022, 0.036, leg)
            for sx in (-1, 1)
            for sy in (-1, 1)
        ),
    )


def stool(color: RGB) -> tuple[Part, ...]:
    """Return a round stool on three splayed legs, 0.45 m high."""
    leg = textures.wood((206, 164, 110), (160, 112, 64), 0.015, 8)
    angles = np.radians([30, 150, 270])
    return (
        Part(shape=cylinder(0.17, 0.03), texture=leg, T_body_part=at(0, 0, 0.42)),
        Part(shape=ellipsoid(0.165, 0.165, 0.03), texture=textures.plain(color, 0.3), T_body_part=at(0, 0, 0.435)),
        *(
            capsule_between(
                (0.18 * np.cos(a), 0.18 * np.sin(a), 0.014), (0.1 * np.cos(a), 0.1 * np.sin(a), 0.41), 0.014, leg
            )
            for a in angles
        ),
    )


def sofa(color: RGB, pillow: Texture) -> tuple[Part, ...]:
    """Return a sofa 1.5 m wide with round arms and two cushions; it faces -y."""
    fabric, dark = textures.plain(color, 0.35), textures.plain((60, 44, 36))
    arms = tuple(
        part
        for side in (-1.0, 1.0)
        for part in (
            Part(shape=box(0.16, 0.72, 0.42), texture=fabric, T_body_part=at(0.67 * side, 0, 0.27)),
            capsule_between((0.67 * side, -0.28, 0.49), (0.67 * side, 0.28, 0.49), 0.085, fabric),
            Part(shape=cylinder(0.03, 0.06), texture=dark, T_body_part=at(0.67 * side, -0.3, 0.03)),
            Part(
                shape=ellipsoid(0.19, 0.08, 0.17),
                texture=pillow,
                T_body_part=at(0.40 * side, 0.08, 0.60, turned(x=-14, z=16 * side)),
            ),
        )
    )
    return (
        Part(shape=box(1.3, 0.72, 0.34), texture=fabric, T_body_part=at(0, 0, 0.25)),
        Part(shape=box(1.3, 0.18, 0.5), texture=fabric, T_body_part=at(0, 0.27, 0.60)),
        capsule_between((-0.62, 0.27, 0.85), (0.62, 0.27, 0.85), 0.09, fabric),
        *arms,
    )


def floor_lamp() -> tuple[Part, ...]:
    """Return a lamp 1.6 m high with a striped shade."""
    metal = textures.plain((92, 88, 84))
    return (
        Part(shape=frustum(0.15, 0.12, 0.04), texture=metal, T_body_part=at(0, 0, 0.02)),
        capsule_between((0, 0, 0.03), (0, 0, 1.4), 0.014, metal),
        Part(
            shape=frustum(0.22, 0.13, 0.28),
            texture=textures.stripes((244, 226, 178), (214, 172, 104), 0.22 * np.pi / 9, upright=True),
            T_body_part=at(0, 0, 1.46),
        ),
    )


def vase(seed: int) -> tuple[Part, ...]:
    """Return a bulging vase of marble, 0.30 m high."""
    stone = textures.marble((60, 112, 116), (222, 226, 206), 0.06, seed)
    return (
        Part(shape=frustum(0.045, 0.035, 0.04), texture=stone, T_body_part=at(0, 0, 0.02)),
        Part(shape=ellipsoid(0.085, 0.085, 0.10), texture=stone, T_body_part=at(0, 0, 0.125)),
        Part(shape=frustum(0.038, 0.030, 0.09), texture=stone, T_body_part=at(0, 0, 0.235)),
        Part(shape=torus(0.034, 0.009), texture=stone, T_body_part=at(0, 0, 0.282)),
    )


def globe(seed: int) -> tuple[Part, ...]:
    """Return a globe with continents on a stand, 0.30 m high."""
    brass, sea = textures.plain((176, 138, 66)), textures.patches((62, 118, 178), (120, 158, 84), 0.09, seed)
    return (
        Part(shape=frustum(0.07, 0.05, 0.02), texture=brass, T_body_part=at(0, 0, 0.01)),
        capsule_between((0, 0, 0.01), (0, 0, 0.07), 0.01, brass),
        Part(shape=ball(0.105), texture=sea, T_body_part=at(0, 0, 0.175)),
        Part(shape=torus(0.118, 0.006), texture=brass, T_body_part=at(0, 0, 0.175, turned(x=90, z=20))),
    )


def cone() -> tuple[Part, ...]:
    """Return a traffic cone with stripes, 0.46 m high."""
    band = textures.stripes((226, 92, 36), (240, 238, 230), 0.1)
    return (
        Part(shape=box(0.28, 0.28, 0.03), texture=textures.plain((206, 80, 34)), T_body_part=at(0, 0, 0.015)),
        Part(shape=frustum(0.115, 0.022, 0.43), texture=band, T_body_part=at(0, 0, 0.245)),
    )


def ring(radius: float, tube: float, first: RGB, second: RGB) -> tuple[Part, ...]:
    """Return a striped swimming ring that lies on the floor."""
    band = textures.stripes(first, second, radius * np.pi / 5, upright=True)
    return (Part(shape=torus(radius, tube), texture=band, T_body_part=at(0, 0, tube)),)


def books(count: int, rng: np.random.Generator) -> tuple[Part, ...]:
    """Return a row of upright books along x, from x = 0 on, backs towards -y."""
    parts, x = [], 0.0
    for _ in range(count):
        width, depth, height = rng.uniform(0.025, 0.055), rng.uniform(0.13, 0.17), rng.uniform(0.19, 0.27)
        cover = textures.parcel(width, height, rng)
        parts.append(Part(shape=box(width, depth, height), texture=cover, T_body_part=at(x + width / 2, 0, height / 2)))
        x += width + 0.002
    return tuple(parts)
