# SPDX-License-Identifier: MIT
"""Primitives of synthetic scenes, and bodies made of them.

A body is a union of parts. Seen from outside, the first hit of any part is the surface of the union,
so no other solid geometry is needed. Lengths are in meters; a body's frame has z up.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from threedvc.errors import ConfigError
from threedvc.geometry.pose import Pose, identity, make_pose
from threedvc.kernels.synthesis.parts import BOX, CAPSULE, ELLIPSOID, FRUSTUM, RECTANGLE, TORUS
from threedvc.synthesis.textures import Texture

__all__ = [
    "Part",
    "Shape",
    "at",
    "ball",
    "box",
    "capsule",
    "capsule_between",
    "cylinder",
    "ellipsoid",
    "frustum",
    "frustum_between",
    "rectangle",
    "torus",
    "turned",
]


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A primitive centered in its own frame.

    Attributes
    ----------
    kind
        One of the primitives of `threedvc.kernels.synthesis.parts`.
    size
        Three sizes in meters; what they mean depends on the kind, see the functions that make shapes.
    radius
        Radius of the smallest sphere about the origin that holds the shape, meters.

    Raises
    ------
    ConfigError
        If a size is negative or not finite.
    """

    kind: int
    size: tuple[float, float, float]
    radius: float

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.size)) or min(self.size) < 0 or not 0 < self.radius < np.inf:
            raise ConfigError(f"sizes {self.size} of a shape must be finite, not negative, and not all zero")


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A textured shape at its place in a body: ``p_body = T_body_part @ p_part``."""

    shape: Shape
    texture: Texture
    T_body_part: Pose = field(default_factory=identity)


def rectangle(width: float, height: float) -> Shape:
    """Return a rectangle in the plane z = 0; it is seen from both sides."""
    return Shape(kind=RECTANGLE, size=(width / 2, height / 2, 0.0), radius=float(np.hypot(width, height)) / 2)


def box(x: float, y: float, z: float) -> Shape:
    """Return a box with these edges."""
    return Shape(kind=BOX, size=(x / 2, y / 2, z / 2), radius=float(np.linalg.norm([x, y, z])) / 2)


def ellipsoid(x: float, y: float, z: float) -> Shape:
    """Return an ellipsoid with these semi-axes."""
    return Shape(kind=ELLIPSOID, size=(x, y, z), radius=max(x, y, z))


def ball(radius: float) -> Shape:
    """Return a sphere."""
    return ellipsoid(radius, radius, radius)


def frustum(bottom_radius: float, top_radius: float, height: float) -> Shape:
    """Return a closed, cut cone about z; a full cone has one radius 0."""
    radius = float(np.hypot(max(bottom_radius, top_radius), height / 2))
    return Shape(kind=FRUSTUM, size=(bottom_radius, top_radius, height / 2), radius=radius)


def cylinder(radius: float, height: float) -> Shape:
    """Return a closed cylinder about z."""
    return frustum(radius, radius, height)


def capsule(radius: float, length: float) -> Shape:
    """Return a capsule about z; `length` is between the centers of its round ends."""
    return Shape(kind=CAPSULE, size=(radius, length / 2, 0.0), radius=radius + length / 2)


def torus(ring_radius: float, tube_radius: float) -> Shape:
    """Return a ring about z."""
    return Shape(kind=TORUS, size=(ring_radius, tube_radius, 0.0), radius=ring_radius + tube_radius)


def turned(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    """Return the (3, 3) rotation by degrees about the fixed axes x, then y, then z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians([x, y, z])), np.sin(np.radians([x, y, z]))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x, dtype=np.float64)


def at(x: float, y: float, z: float, rotation: NDArray[np.float64] | None = None) -> Pose:
    """Return the transform to a place, turned by `rotation` there."""
    return make_pose(np.eye(3) if rotation is None else rotation, np.array([x, y, z], dtype=np.float64))


def capsule_between(start: ArrayLike, end: ArrayLike, radius: float, texture: Texture) -> Part:
    """Return a capsule whose round ends are centered at two points of the body."""
    length, pose = _between(start, end)
    return Part(shape=capsule(radius, length), texture=texture, T_body_part=pose)


def frustum_between(start: ArrayLike, end: ArrayLike, start_radius: float, end_radius: float, texture: Texture) -> Part:
    """Return a cut cone whose caps are centered at two points of the body."""
    length, pose = _between(start, end)
    return Part(shape=frustum(start_radius, end_radius, length), texture=texture, T_body_part=pose)


def _between(start: ArrayLike, end: ArrayLike) -> tuple[float, Pose]:
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(b - a))
    z = (b - a) / length
    aside = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(aside, z)
    x /= np.linalg.norm(x)
    return length, make_pose(np.stack([x, np.cross(z, x), z], axis=1), (a + b) / 2)
