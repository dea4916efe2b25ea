# SPDX-License-Identifier: MIT
"""Exact pictures of a synthetic scene by analytic ray casting.

The color of a body depends on where it stands through the Lambert light alone: only background parts
cast shadows, and only on the background, so that a moving body never changes another surface's color.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, identity, inverse
from threedvc.kernels.synthesis.parts import PART
from threedvc.kernels.synthesis.ray_tracing import TILE, mark_hidden, trace_color, trace_depth
from threedvc.parallel import default_threads, for_ranges
from threedvc.synthesis.scene import Scene
from threedvc.synthesis.shapes import Part
from threedvc.units import LUMA_WEIGHTS

__all__ = ["Picture", "SceneRenderer"]

SAMPLES = 2
"""Rays along each side of a pixel of the color picture: outlines are smooth at four times the work of one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """What the cameras of a scene see in one frame, before any sensor.

    Attributes
    ----------
    color
        (height, width, 3) uint8 RGB in the color camera, 2 x 2 rays per pixel.
    depth
        (height, width) float64 meters along z in the depth camera, by the ray through each pixel's center;
        0 where it meets nothing.
    labels
        (height, width) uint8 labels in the depth camera, by the same rays.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float64]
    labels: NDArray[np.uint8]


class SceneRenderer:
    """Draws the frames of a scene, in any order.

    Parameters
    ----------
    scene
        What to draw.
    threads
        Number of threads, or None for one per processor; pictures do not depend on it.
    """

    def __init__(self, scene: Scene, threads: int | None = None) -> None:
        self.scene = scene
        self._threads = threads or default_threads()
        self._depth_rays = scene.rig.depth.rays()
        self._color_rays = _sample_rays(scene.rig.color)
        bodies = [(body.label, part) for body in scene.bodies for part in body.parts]
        labeled = [(0, part) for part in scene.background] + bodies
        self._parts, self._texels = _part_table(labeled)
        self._radii = np.array([part.shape.radius for _, part in labeled])
        self._T_body_part = np.stack([part.T_body_part for _, part in labeled])
        self._lights = np.array([[*light.position, light.strength] for light in scene.lights]).reshape(-1, 4)

    def picture(self, index: int) -> Picture:
        """Draw frame `index`."""
        depth, labels = self.depth(index)
        return Picture(color=self.color(index), depth=depth, labels=labels)

    def depth(self, index: int) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Return depth and labels of frame `index`, see `Picture`."""
        rays = self._depth_rays
        depth, labels = np.empty(rays.shape[:2]), np.empty(rays.shape[:2], dtype=np.uint8)
        parts, bounds = self._placed(index, inverse(self.scene.T_world_camera[index]))
        for_ranges(
            lambda start, stop: trace_depth(start, stop, rays, parts, bounds, depth, labels),
            -(-len(depth) // TILE),
            self._threads,
        )
        return depth, labels

    def color(self, index: int) -> NDArray[np.uint8]:
        """Return the color picture of frame `index`, see `Picture`."""
        rays, texels, ambient = self._color_rays, self._texels, self.scene.ambient
        T_color_world = self.scene.rig.T_color_depth @ inverse(self.scene.T_world_camera[index])
        parts, bounds = self._placed(index, T_color_world)
        lights = self._lights.copy()
        lights[:, :3] = self._lights[:, :3] @ T_color_world[:3, :3].T + T_color_world[:3, 3]
        color = np.empty((rays.shape[0] // SAMPLES, rays.shape[1] // SAMPLES, 3))
        for_ranges(
            lambda start, stop: trace_color(start, stop, rays, parts, bounds, texels, lights, ambient, color),
            -(-len(color) // TILE),
            self._threads,
        )
        if self.scene.gray:
            color[...] = (color @ np.array(LUMA_WEIGHTS))[..., None]
        return np.asarray(np.rint(color), dtype=np.uint8)

    def hidden_from(self, index: int, depth: NDArray[np.float64], source: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which surface points of a frame are not reached from a point such as an infra-red projector.

        Parameters
        ----------
        index
            Frame.
        depth
            (height, width) exact depth of that frame.
        source
            (3,) place in the depth camera's frame, meters.

        Returns
        -------
        (height, width) bool
        """
        hidden = np.empty(depth.shape, dtype=np.bool_)
        rays, place = self._depth_rays, np.asarray(source, dtype=np.float64)
        parts, bounds = self._placed(index, inverse(self.scene.T_world_camera[index]))
        for_ranges(
            lambda start, stop: mark_hidden(start, stop, rays, depth, parts, bounds, place, hidden),
            len(depth),
            self._threads,
        )
        return hidden

    def _placed(self, index: int, T_camera_world: Pose) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Return the parts with their transforms to one camera in frame `index`, and their bounding spheres."""
        scene = self.scene
        bodies = [body.T_world_body[index] for body in scene.bodies for _ in body.parts]
        T_camera_body = T_camera_world @ np.stack([identity()] * len(scene.background) + bodies)
        T_camera_part = T_camera_body @ self._T_body_part
        parts = self._parts.copy()
        parts["T_part_camera"] = _inverses(T_camera_part)
        parts["T_body_camera"] = _inverses(T_camera_body)
        return parts, np.column_stack([T_camera_part[:, :3, 3], self._radii])


def _sample_rays(camera: Camera) -> NDArray[np.float64]:
    """Return the ray slopes of the samples of every pixel, (SAMPLES * height, SAMPLES * width, 2)."""
    offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    x = (np.arange(camera.width)[:, None] + offsets).ravel()
    y = (np.arange(camera.height)[:, None] + offsets).ravel()
    return camera.unproject_pixels(np.stack(np.meshgrid(x, y), axis=-1))


def _inverses(transforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert (n, 4, 4) rigid transforms to (n, 3, 4)."""
    rotations = transforms[:, :3, :3].transpose(0, 2, 1)
    return np.concatenate([rotations, -rotations @ transforms[:, :3, 3:]], axis=2)


def _part_table(labeled: list[tuple[int, Part]]) -> tuple[NDArray[Any], NDArray[np.uint8]]:
    """Return the records of all parts, not yet placed, and the texels of their pictures."""
    parts = np.zeros(len(labeled), dtype=PART)
    pictures: dict[int, tuple[int, int, int]] = {}
    texels = [np.zeros((1, 3), dtype=np.uint8)]
    filled = 1
    for record, (label, part) in zip(parts, labeled, strict=True):
        texture = part.texture
        record["kind"], record["size"] = part.shape.kind, part.shape.size
        record["label"], record["seed"] = label, texture.seed
        record["pattern"], record["colors"] = texture.pattern, texture.colors
        record["scale"], record["grain"] = texture.scale_m, texture.grain
        if texture.image is None:
            continue
        if id(texture.image) not in pictures:
            height, width = texture.image.shape[:2]
            pictures[id(texture.image)] = (filled, height, width)
            texels.append(texture.image.reshape(-1, 3))
            filled += height * width
        record["picture"] = pictures[id(texture.image)]
    return parts, np.concatenate(texels)
