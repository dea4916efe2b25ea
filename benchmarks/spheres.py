# SPDX-License-Identifier: MIT
"""Draw the cells of a model as small shaded spheres, as the figures of the 1995 paper do.

Spheres are splatted one by one into a depth buffer under parallel projection, once from the viewer and
once from the light, which gives the shadows. The radius of a sphere grows with P(occupied).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["Spheres", "View", "draw", "spheres_of_cells"]

Floats = NDArray[np.float64]

SUPERSAMPLE = 2
"""Pixels along each side that make one of the figure: smooth outlines."""
SHADOW_SIDE_PX = 1000
"""Of the picture that the light sees: about a pixel for one of the figure."""
SHADOW_TAPS_PX = (-3, -1, 1, 3)
"""Offsets, down and right, over whose mean the edge of a shadow is soft."""
MARGIN = 1.05
"""Times the size of the spheres: they do not touch the border."""
UP = np.array([0.0, 0.0, 1.0])
"""In the world."""
# A cell that is certainly occupied reaches a little over its edges, so that a plane of them closes.
LARGEST_RADIUS_CELLS = 0.62

TOP_RGB = np.array([252.0, 252.0, 252.0])
"""Of the background, which fades downwards to the next; by taste."""
BOTTOM_RGB = np.array([214.0, 219.0, 226.0])
"""A cool gray."""
# Directions to the lights in the axes of the view: x right, y down, z forward.
KEY_LIGHT = np.array([-0.48, -0.65, -0.60])
FILL_LIGHT = np.array([0.80, -0.10, -0.60])
AMBIENT, KEY, FILL, GLOSS = 0.50, 0.85, 0.22, 40.0
"""Shares of light from everywhere, from both lights, and of the gloss in levels; by taste."""
SHINE = 30
"""Exponent of the gloss: small lights on a smooth surface; by taste."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Spheres:
    """Spheres in the frame of the object.

    Attributes
    ----------
    centers
        (n, 3) meters.
    radii
        (n,) meters.
    colors
        (n, 3) RGB, 0..255.
    """

    centers: Floats
    radii: Floats
    colors: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A parallel projection into a picture.

    Attributes
    ----------
    axes
        (3, 3), rows right, down and forward in the frame of the object.
    center
        (3,) point in the middle of the picture, meters.
    scale
        Pixels per meter.
    width, height
        Size of the picture in pixels.
    """

    axes: Floats
    center: Floats
    scale: float
    width: int
    height: int

    @classmethod
    def around(cls, spheres: Spheres, forward: Floats, width: int) -> View:
        """Return the view along `forward` (3,), z upwards, that the spheres fill from left to right."""
        low = (spheres.centers - spheres.radii[:, None]).min(axis=0)
        high = (spheres.centers + spheres.radii[:, None]).max(axis=0)
        center = (low + high) / 2
        axes = _axes(forward, -UP)
        offsets = np.abs((spheres.centers - center) @ axes[:2].T) + spheres.radii[:, None]
        half_width_m, half_height_m = MARGIN * offsets.max(axis=0)
        height = round(width * half_height_m / half_width_m)
        return cls(axes=axes, center=center, scale=width / (2 * half_width_m), width=width, height=height)

    def place(self, points: Floats) -> Floats:
        """Return (n, 3) column and row in pixels and depth in meters of points (n, 3)."""
        placed = (points - self.center) @ self.axes.T
        middle = np.array([self.width / 2, self.height / 2])
        return np.column_stack([placed[:, :2] * self.scale + middle, placed[:, 2]])

    def points(self, rows: NDArray[np.intp], columns: NDArray[np.intp], depth: Floats) -> Floats:
        """Return the points (n, 3) that the centers of pixels show at given depths."""
        right = (columns + 0.5 - self.width / 2) / self.scale
        down = (rows + 0.5 - self.height / 2) / self.scale
        return np.asarray(np.column_stack([right, down, depth]) @ self.axes + self.center, dtype=np.float64)

    def enlarged(self, times: int) -> View:
        """Return the same view with more pixels."""
        return replace(self, scale=self.scale * times, width=self.width * times, height=self.height * times)


def spheres_of_cells(
    cells: NDArray[np.int32], probability: Floats, colors: NDArray[np.floating], voxel_size_m: float
) -> Spheres:
    """Return a sphere for every cell that is more likely occupied than not.

    Its volume grows in proportion to what was learned, from nothing at P(occupied) = 1/2.

    Parameters
    ----------
    cells
        (n, 3) indices.
    probability
        (n,) P(occupied).
    colors
        (n, 3) RGB, 0..255.
    voxel_size_m
        Edge of a cell.
    """
    learned = 2 * np.asarray(probability, dtype=np.float64) - 1
    shown = learned > 0
    return Spheres(
        centers=(cells[shown].astype(np.float64) + 0.5) * voxel_size_m,
        radii=LARGEST_RADIUS_CELLS * voxel_size_m * np.cbrt(learned[shown]),
        colors=colors[shown].astype(np.float64),
    )


def draw(spheres: Spheres, view: View) -> NDArray[np.uint8]:
    """Draw a picture.

    Returns
    -------
    (height, width, 3) uint8 RGB
    """
    fine = view.enlarged(SUPERSAMPLE)
    depth, owner = _splat(spheres, fine)
    rows, columns = np.nonzero(owner >= 0)
    seen = owner[rows, columns]
    points = fine.points(rows, columns, depth[rows, columns])
    normals = (points - spheres.centers[seen]) / spheres.radii[seen, None]
    picture = _backdrop(fine)
    picture[rows, columns] = _shade(spheres.colors[seen], normals @ fine.axes.T, _lit(spheres, view, points))
    small = cv2.resize(picture, (view.width, view.height), interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(small), dtype=np.uint8)


def _axes(forward: Floats, down: Floats) -> Floats:
    """Return right, down and forward as rows; `down` need not be at right angles to `forward`."""
    ahead = forward / np.linalg.norm(forward)
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])


def _splat(spheres: Spheres, view: View) -> tuple[Floats, NDArray[np.int32]]:
    """Return the depth in meters and the sphere at every pixel; infinity and -1 where there is none."""
    depth = np.full((view.height, view.width), np.inf)
    owner = np.full((view.height, view.width), -1, dtype=np.int32)
    for number, ((x, y, z), radius) in enumerate(zip(view.place(spheres.centers), spheres.radii, strict=True)):
        reach = radius * view.scale
        left, right = _span(x, reach, view.width)
        top, bottom = _span(y, reach, view.height)
        across = (np.arange(left, right) + 0.5 - x) / view.scale
        along = (np.arange(top, bottom) + 0.5 - y) / view.scale
        height = radius**2 - across**2 - along[:, None] ** 2
        front = z - np.sqrt(np.maximum(height, 0))
        nearer = (height > 0) & (front < depth[top:bottom, left:right])
        depth[top:bottom, left:right][nearer] = front[nearer]
        owner[top:bottom, left:right][nearer] = number
    return depth, owner


def _span(middle: float, reach: float, limit: int) -> tuple[int, int]:
    """Return the first pixel within reach of a place and the one after the last, inside a picture."""
    return min(max(int(middle - reach), 0), limit), min(max(int(middle + reach) + 2, 0), limit)


def _lit(spheres: Spheres, view: View, points: Floats) -> Floats:
    """Tell how much of the key light reaches points (n, 3): 0 in shadow, 1 in the open."""
    reach_m = float(np.linalg.norm(spheres.centers - view.center, axis=1).max() + spheres.radii.max())
    light = View(
        axes=_axes(-KEY_LIGHT @ view.axes, view.axes[1]),
        center=view.center,
        scale=SHADOW_SIDE_PX / (2 * reach_m),
        width=SHADOW_SIDE_PX,
        height=SHADOW_SIDE_PX,
    )
    depth, _ = _splat(spheres, light)
    x, y, z = light.place(points).T
    column, row = x.astype(np.intp), y.astype(np.intp)
    # Averaging outcomes, not depths, gives soft edges; the offset keeps a point from shading itself.
    limit = z - 0.35 * float(spheres.radii.max())
    reached = np.zeros(len(points))
    for down in SHADOW_TAPS_PX:
        for right in SHADOW_TAPS_PX:
            at = np.clip(row + down, 0, SHADOW_SIDE_PX - 1), np.clip(column + right, 0, SHADOW_SIDE_PX - 1)
            reached += depth[at] > limit
    return reached / len(SHADOW_TAPS_PX) ** 2


def _shade(colors: Floats, normals: Floats, lit: Floats) -> Floats:
    """Return the RGB (n, 3) of surface points with normals (n, 3) in the axes of the view."""
    key, fill = (light / np.linalg.norm(light) for light in (KEY_LIGHT, FILL_LIGHT))
    halfway = key - np.array([0.0, 0.0, 1.0])
    halfway /= np.linalg.norm(halfway)
    ambient = AMBIENT * (0.8 - 0.2 * normals[:, 1])
    diffuse = ambient + KEY * lit * np.clip(normals @ key, 0, None) + FILL * np.clip(normals @ fill, 0, None)
    gloss = GLOSS * lit * np.clip(normals @ halfway, 0, None) ** SHINE
    return np.asarray(np.clip(colors * diffuse[:, None] + gloss[:, None], 0, 255), dtype=np.float64)


def _backdrop(view: View) -> NDArray[np.float32]:
    fade = np.linspace(0, 1, view.height)[:, None, None]
    return np.repeat(TOP_RGB * (1 - fade) + BOTTOM_RGB * fade, view.width, axis=1).astype(np.float32)
