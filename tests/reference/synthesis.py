# SPDX-License-Identifier: MIT
"""Slow references for the synthetic scenes: primitives as implicit functions, hits by dense sampling and bisection."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.pose import Pose, inverse
from threedvc.kernels.synthesis.parts import BOX, CAPSULE, ELLIPSOID, FRUSTUM, RECTANGLE
from threedvc.synthesis.scene import Scene
from threedvc.synthesis.shapes import Part, Shape

Array = NDArray[np.float64]

SAMPLES = 1500
BISECTIONS = 60
DIFFERENCE_M = 1e-6


def implicit(shape: Shape, points: Array) -> Array:
    """Evaluate a function that is negative inside a shape and positive outside, at points (..., 3)."""
    a, b, c = shape.size
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    around = np.hypot(x, y)
    if shape.kind == RECTANGLE:
        return z
    if shape.kind == BOX:
        return np.max(np.abs(points) - np.array(shape.size), axis=-1)
    if shape.kind == ELLIPSOID:
        return np.linalg.norm(points / np.array(shape.size), axis=-1) - 1
    if shape.kind == FRUSTUM:
        return np.maximum(around - (a + (b - a) * (z + c) / (2 * c)), np.abs(z) - c)
    if shape.kind == CAPSULE:
        return np.hypot(around, z - np.clip(z, -b, b)) - a
    return np.hypot(around - a, z) - b


def first_hit(shape: Shape, origin: Array, direction: Array, near: float = 1e-7) -> float:
    """Return the first distance beyond `near` at which the implicit function changes sign, or infinity."""
    length = float(np.linalg.norm(direction))
    closest = -float(origin @ direction) / length**2
    reach = shape.radius**2 - float(np.sum((origin + closest * direction) ** 2))
    if reach < 0:
        return np.inf
    half = np.sqrt(reach) / length + 1e-6
    t = np.linspace(max(closest - half, near), max(closest + half, near), SAMPLES)
    values = implicit(shape, origin + t[:, None] * direction)
    for change in np.flatnonzero((values[:-1] < 0) != (values[1:] < 0)):
        hit = _bisected(shape, origin, direction, t[change], t[change + 1])
        point = origin + hit * direction
        if shape.kind != RECTANGLE or bool(np.all(np.abs(point[:2]) <= np.array(shape.size[:2]))):
            return hit
    return np.inf


def normal(shape: Shape, point: Array) -> Array:
    """Return the outward unit normal at a surface point by central differences."""
    steps = DIFFERENCE_M * np.eye(3)
    gradient = implicit(shape, point + steps) - implicit(shape, point - steps)
    return np.asarray(gradient / np.linalg.norm(gradient))


def cast(placed: list[tuple[Part, int, Pose]], direction: Array) -> tuple[int, float]:
    """Return which part a camera ray meets first (-1: none), and where; parts come with T_camera_part."""
    found, nearest = -1, np.inf
    for i, (part, _, T_camera_part) in enumerate(placed):
        T = inverse(T_camera_part)
        t = first_hit(part.shape, T[:3, 3], T[:3, :3] @ direction)
        if t < nearest:
            found, nearest = i, t
    return found, nearest


def blocked(placed: list[tuple[Part, int, Pose]], point: Array, target: Array) -> bool:
    """Tell whether a part stands between two points."""
    for part, _, T_camera_part in placed:
        T = inverse(T_camera_part)
        start, end = T[:3, :3] @ point + T[:3, 3], T[:3, :3] @ target + T[:3, 3]
        if first_hit(part.shape, start, end - start, near=1e-5) < 1:
            return True
    return False


def placed_parts(scene: Scene, index: int, T_camera_world: Pose) -> list[tuple[Part, int, Pose]]:
    """List every part of a scene with its label and T_camera_part in one frame."""
    still = [(part, 0, T_camera_world @ part.T_body_part) for part in scene.background]
    return still + [
        (part, body.label, T_camera_world @ body.T_world_body[index] @ part.T_body_part)
        for body in scene.bodies
        for part in body.parts
    ]


def depth_and_labels(scene: Scene, index: int) -> tuple[Array, NDArray[np.uint8]]:
    """Cast the ray of every pixel of the depth camera."""
    camera = scene.rig.depth
    depth, labels = np.zeros((camera.height, camera.width)), np.zeros((camera.height, camera.width), dtype=np.uint8)
    placed = placed_parts(scene, index, inverse(scene.T_world_camera[index]))
    rays = camera.rays()
    for row, column in np.ndindex(depth.shape):
        found, z = cast(placed, np.array([*rays[row, column], 1.0]))
        if found >= 0:
            depth[row, column], labels[row, column] = z, placed[found][1]
    return depth, labels


def plain_color(scene: Scene, index: int) -> Array:
    """Return the colors of a scene whose textures are all plain and without grain, (height, width, 3), unrounded."""
    camera = scene.rig.color
    T_color_world = scene.rig.T_color_depth @ inverse(scene.T_world_camera[index])
    placed = placed_parts(scene, index, T_color_world)
    still = placed[: len(scene.background)]
    lights = [
        (T_color_world[:3, :3] @ np.array(light.position) + T_color_world[:3, 3], light.strength)
        for light in scene.lights
    ]
    color = np.zeros((camera.height, camera.width, 3))
    offsets = [(x, y) for x in (-0.25, 0.25) for y in (-0.25, 0.25)]
    for row, column in np.ndindex(color.shape[:2]):
        for dx, dy in offsets:
            slope = camera.unproject_pixels(np.array([column + dx, row + dy]))
            found, z = cast(placed, np.array([*slope, 1.0]))
            if found >= 0:
                part, label, T_camera_part = placed[found]
                point = z * np.array([*slope, 1.0])
                light = _light(part, label, T_camera_part, still, lights, scene.ambient, point)
                color[row, column] += np.minimum(light * np.array(part.texture.colors[0]), 255) / len(offsets)
    return color


def _light(
    part: Part,
    label: int,
    T_camera_part: Pose,
    still: list[tuple[Part, int, Pose]],
    lights: list[tuple[Array, float]],
    ambient: float,
    point: Array,
) -> float:
    T = inverse(T_camera_part)
    n = T_camera_part[:3, :3] @ normal(part.shape, T[:3, :3] @ point + T[:3, 3])
    n = -n if n @ point > 0 else n
    total = ambient
    for i, (place, strength) in enumerate(lights):
        cosine = float(n @ (place - point)) / float(np.linalg.norm(place - point))
        if cosine > 0 and not (i == 0 and label == 0 and blocked(still, point, place)):
            total += strength * cosine
    return total


def _bisected(shape: Shape, origin: Array, direction: Array, low: float, high: float) -> float:
    inside = bool(implicit(shape, origin + low * direction) < 0)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if bool(implicit(shape, origin + middle * direction) < 0) == inside:
            low = middle
        else:
            high = middle
    return (low + high) / 2
