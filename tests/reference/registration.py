# SPDX-License-Identifier: MIT
"""Slow, obvious versions of the loops of registration, and scenes whose every pixel is known exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threedvc.arrays import Doubles, Floats
from threedvc.encoder.registration.registration import ModelView
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes ``normals @ p = offsets``; the nearest one along a ray that faces the camera is seen."""

    normals: Doubles
    offsets: Doubles

    def hit(self, origin: Doubles, directions: Doubles) -> tuple[Doubles, Doubles]:
        """Return ray parameters (h, w), infinite where nothing is hit, and normals (h, w, 3)."""
        slopes = directions @ self.normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (self.offsets - self.normals @ origin) / slopes
        t = np.where((t > 0) & (slopes < 0), t, np.inf)
        return t.min(axis=-1), self.normals[t.argmin(axis=-1)]


@dataclass(frozen=True, eq=False)
class Box:
    """A box around the origin with the given half sides."""

    half: Doubles

    def hit(self, origin: Doubles, directions: Doubles) -> tuple[Doubles, Doubles]:
        """Return ray parameters (h, w), infinite where nothing is hit, and normals (h, w, 3)."""
        with np.errstate(divide="ignore"):
            first, second = (-self.half - origin) / directions, (self.half - origin) / directions
        enter, leave = np.minimum(first, second), np.maximum(first, second)
        t, axis = enter.max(axis=-1), enter.argmax(axis=-1)
        t = np.where((t > 0) & (t < leave.min(axis=-1)), t, np.inf)
        return t, -np.sign(np.take_along_axis(directions, axis[..., None], -1)) * np.eye(3)[axis]


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere around the origin."""

    radius: float

    def hit(self, origin: Doubles, directions: Doubles) -> tuple[Doubles, Doubles]:
        """Return ray parameters (h, w), infinite where nothing is hit, and normals (h, w, 3)."""
        a, b = np.sum(directions**2, axis=-1), directions @ origin
        root = b**2 - a * (origin @ origin - self.radius**2)
        t = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
        points = origin + np.where(np.isfinite(t), t, 0.0)[..., None] * directions
        return t, points / self.radius


Shape = Planes | Box | Sphere

ROOM = Planes(np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]]), np.array([-0.9, -0.7, -2.2]))
WALL = Planes(np.array([[0.0, 0, -1.0]]), np.array([-1.5]))


def texture(points: Doubles) -> Doubles:
    """Return a smooth luma pattern (...,) of points (..., 3) in meters."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    coarse = np.sin(23 * x + 5 * z) * np.sin(19 * y - 7 * z)
    fine = np.sin(83 * x + 11 * y) * np.sin(71 * y - 31 * z) + np.sin(67 * z + 29 * x)
    return 128 + 40 * coarse + 20 * fine


def draw(camera: Camera, T_camera_object: Pose, shape: Shape, *, plain: bool = False) -> ModelView:
    """Draw a shape exactly: depth, normals in the camera's frame and luma (constant where `plain`)."""
    T_object_camera = inverse(T_camera_object)
    directions = np.concatenate([camera.rays(), np.ones((camera.height, camera.width, 1))], axis=-1)
    directions = directions @ T_object_camera[:3, :3].T
    origin = T_object_camera[:3, 3]
    z, normals = shape.hit(origin, directions)
    seen = np.isfinite(z)
    depth = np.where(seen, z, 0.0)
    luma = np.full(z.shape, 100.0) if plain else texture(origin + depth[..., None] * directions)
    return ModelView(
        camera=camera,
        T_camera_object=T_camera_object,
        depth=depth.astype(np.float32),
        normals=np.where(seen[..., None], normals @ T_camera_object[:3, :3].T, 0.0).astype(np.float32),
        intensity=np.where(seen, luma, np.nan).astype(np.float32),
    )


def halved(luma: Floats) -> Floats:
    """Mean of the known pixels of every 2x2 where at least three are known, else NaN."""
    result = np.full((luma.shape[0] // 2, luma.shape[1] // 2), np.nan, dtype=np.float32)
    for row, column in np.ndindex(result.shape):
        four = luma[2 * row : 2 * row + 2, 2 * column : 2 * column + 2].ravel()
        known = four[np.isfinite(four)].astype(np.float64)
        if len(known) >= 3:
            result[row, column] = known.sum() / len(known)
    return result


def bilinear(luma: Floats, x: float, y: float) -> float:
    """Bilinear value; beyond the outer pixel centers the last two are continued."""
    height, width = luma.shape
    column, row = min(max(int(np.floor(x)), 0), width - 2), min(max(int(np.floor(y)), 0), height - 2)
    fx, fy = x - column, y - row
    weights = np.outer([1 - fy, fy], [1 - fx, fx])
    return float(np.sum(weights * luma[row : row + 2, column : column + 2].astype(np.float64)))


def associated(
    sample: Doubles, sigma: float, view: ModelView, T_view_frame: Pose, gates: Doubles
) -> tuple[int, float, float]:
    """Associate one sample with a view at full size.

    Returns
    -------
    tuple
        0 unseen, 1 behind or 2 fitting; the distance to the plane and the view's luma, NaN where not fitting.
    """
    nothing = (0, np.nan, np.nan)
    q = T_view_frame[:3, :3] @ sample[:3] + T_view_frame[:3, 3]
    if q[2] <= 0:
        return nothing
    u, v = view.camera.project(q)
    column, row = round(u), round(v)
    if not (0 <= column < view.camera.width and 0 <= row < view.camera.height):
        return nothing
    z = float(view.depth[row, column])
    slopes = view.camera.rays()[row, column]
    if z <= 0 or np.abs(slopes - q[:2] / q[2]).sum() > 0.02:
        return nothing
    normal = view.normals[row, column].astype(np.float64)
    way = q - z * np.append(slopes, 1.0)
    near = np.linalg.norm(way) <= max(gates[0] * z, gates[1] * sigma)
    if not near or normal @ T_view_frame[:3, :3] @ sample[3:6] < gates[2]:
        return 1, np.nan, np.nan
    return 2, float(normal @ way), bilinear(view.intensity, u, v)


def normal_equations(
    rows: Doubles, lumas: Doubles, sigmas: Doubles, center: Doubles, exposure: Doubles, scales: Doubles, bound: float
) -> tuple[Doubles, Doubles]:
    """Matrix (8, 8) and right side (8,) of the weighted equations, built as whole arrays."""
    arms = rows[:, :3] - center
    depth = np.column_stack([np.cross(arms, rows[:, 3:6]), rows[:, 3:6], np.zeros((len(rows), 2))])
    level = lumas - 128
    luma = np.column_stack([np.cross(arms, rows[:, 7:10]), rows[:, 7:10], -level, -np.ones(len(rows))])
    residuals = np.concatenate([rows[:, 6], rows[:, 10] - exposure[0] * level - exposure[1]])
    deviations = np.concatenate([scales[0] * sigmas, np.full(len(rows), scales[1])])
    factors = np.repeat(scales[2:], len(rows))
    inside = np.nan_to_num(np.clip(1 - (residuals / (bound * deviations)) ** 2, 0, 1), nan=0.0)
    weights = factors * inside**2 / deviations**2
    used = weights > 0
    jacobian, weights = np.vstack([depth, luma])[used], weights[used]
    return jacobian.T @ (weights[:, None] * jacobian), jacobian.T @ (weights * residuals[used])
