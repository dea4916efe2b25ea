# SPDX-License-Identifier: MIT
"""Samples of the frames' colors on the surfaces of a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats
from threedvc.coding.gains import apply_gain
from threedvc.config import RenderConfig
from threedvc.encoder.appearance.color_field import ColorField
from threedvc.encoder.appearance.lighting import light_at, light_terms
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.kernels.encoder.appearance import gather_colors
from threedvc.kernels.render.shading import MIN_LIGHT
from threedvc.render.ray_grid import RayGrid
from threedvc.render.renderer import Renderer
from threedvc.units import LUMA_WEIGHTS

__all__ = ["FrameSamples", "JoinedSamples", "Sampler", "joined", "rays_at", "shown_shares"]

LUMA = np.array(LUMA_WEIGHTS, dtype=np.float32)
PHASES = ((0, 0), (1, 2), (3, 1), (2, 3))
"""Where the grids of successive frames begin: each in a row and a column of its own."""
SMOOTHING_ROUNDS = 3
"""How often shares are averaged with the neighbors': they are too few to count alone."""
OUTLIER_LEVELS = 50.0
"""Root mean squared error of a sample at which it counts half: far above noise, below the contrast of an outline."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameSamples:
    """Pixels of a frame and what the renderer shows there.

    Attributes
    ----------
    frame
        Number of the frame.
    labels
        (n,) uint8 object numbers.
    points
        (n, 3) float64 points met, in the object's frame, meters.
    numbers, weights
        (n, 8) int32 and uint8, see `ColorField.corners`.
    observed
        (n, 3) uint8 RGB of the frame.
    normals
        (n, 3) float32 normals of the surface in the world, 0 where there is none.
    """

    frame: int
    labels: NDArray[np.uint8]
    points: Doubles
    normals: Floats
    numbers: NDArray[np.int32]
    weights: NDArray[np.uint8]
    observed: NDArray[np.uint8]

    def shown(self, field: ColorField) -> Floats:
        """Return the colors (n, 3) without gain."""
        shown = np.empty((len(self.labels), 3), dtype=np.float32)
        gather_colors(0, len(shown), self.numbers, self.weights, field.values, shown)
        return shown * self.lit(field)[:, None]

    def luma(self, field: ColorField) -> Doubles:
        """Return the luma (n,) without gain."""
        return (self.shown(field) @ LUMA).astype(np.float64)

    def squared_error(self, shown: Floats, units: NDArray[np.int64]) -> float:
        """Return the mean squared error of colors (n, 3) as `shown`, with units (3, 2) of a gain."""
        gain, offset = apply_gain(units)
        return float(np.mean((np.clip(shown * gain + offset, 0, 255) - self.observed) ** 2))

    def lit(self, field: ColorField) -> Floats:
        """Return the light (n,) on the samples."""
        light = np.ones(len(self.labels), dtype=np.float32)
        for number, track in field.lights.items():
            here = self.labels == number
            light[here] += (light_terms(self.normals[here]) @ light_at(track, self.frame)).astype(np.float32)
        return np.asarray(np.maximum(light, np.float32(MIN_LIGHT)))


class Sampler:
    """Casts every n-th pixel of the color camera, other ones from frame to frame.

    Parameters
    ----------
    rig
        Cameras.
    pixels
        About how many pixels to take of a frame.
    threads
        Number of threads.
    """

    def __init__(self, rig: CameraRig, pixels: int, threads: int) -> None:
        self._rig = rig
        camera = rig.color
        self._stride = max(1, int(np.ceil(np.sqrt(camera.width * camera.height / pixels))))
        offsets = sorted({(x % self._stride, y % self._stride) for x, y in PHASES})
        self._grids = [(x, y, RayGrid(camera.every(self._stride, x, y), apart=True)) for x, y in offsets]
        self._renderer = Renderer(rig, RenderConfig(supersample=1, threads=threads))

    @property
    def pixels_per_sample(self) -> int:
        """How many pixels a sample stands for."""
        return self._stride**2

    def sample(
        self, frame: Frame, field: ColorField, poses: Mapping[int, Pose], T_shifted_camera: Pose
    ) -> FrameSamples:
        """Return the samples of a frame whose rays meet a colored cell; `poses` are T_camera_object."""
        x, y, rays = self._grids[frame.index % len(self._grids)]
        T_color_camera = compose(self._rig.T_color_depth, T_shifted_camera)
        in_color = {number: compose(T_color_camera, poses[number]) for number in poses}
        met = self._renderer.cast(rays, field.models, in_color)
        depth, labels = self._renderer.cast_guessed(rays, field.models, in_color, *met)
        count = len(depth)
        points, normals = rays_at(rays.slopes, depth), np.zeros((count, 3))
        numbers, weights = np.zeros((count, 8), np.int32), np.zeros((count, 8), np.uint8)
        for number, T_color_object in in_color.items():
            here = np.flatnonzero((labels == number) & (depth > 0))
            T = inverse(T_color_object)
            points[here] = points[here] @ T[:3, :3].T + T[:3, 3]
            if number:
                R = (inverse(poses[0]) @ poses[number])[:3, :3] if 0 in poses else poses[number][:3, :3]
                normals[here] = field.normals(number, points[here], points[here] - T[:3, 3]) @ R.T
            numbers[here], weights[here] = field.corners(number, points[here])
        usable = weights.any(axis=1)
        return FrameSamples(
            frame=frame.index,
            labels=labels[usable],
            points=points[usable],
            normals=normals[usable].astype(np.float32),
            numbers=numbers[usable],
            weights=weights[usable],
            observed=frame.color[y :: self._stride, x :: self._stride].reshape(-1, 3)[usable],
        )


def rays_at(slopes: Doubles, depth: Floats | Doubles) -> Doubles:
    """Return the points (n, 3) in the camera's frame where rays of slopes (n, 2) have depths (n,)."""
    return np.concatenate([slopes, np.ones((len(depth), 1))], axis=1) * depth[:, None].astype(np.float64)


@dataclass(kw_only=True, eq=False)
class JoinedSamples:
    """Samples of many frames: ``gain * interpolated`` shall be `wanted`; both are scaled by their confidence."""

    numbers: NDArray[np.int32]
    weights: NDArray[np.uint8]
    gain: Floats
    wanted: Floats


def shown_shares(colors: ColorField, samples: Iterable[FrameSamples]) -> Floats:
    """Return how many samples show each numbered cell (n,), averaged with the cells about it.

    Samples are few beside cells: by itself a cell would count by chance.
    """
    shares = np.zeros(len(colors.values))
    for sample in samples:
        weights = sample.weights / np.maximum(sample.weights.sum(axis=1, dtype=np.float64), 1)[:, None]
        shares += np.bincount(sample.numbers.ravel(), weights.ravel(), len(shares))
    count = 1 + np.count_nonzero(colors.neighbors >= 0, axis=1)
    for _ in range(SMOOTHING_ROUNDS):
        shares = (shares + np.append(shares, 0)[colors.neighbors].sum(axis=1)) / count
    return shares.astype(np.float32)


def joined(colors: ColorField, samples: Iterable[tuple[FrameSamples, NDArray[np.int64]]]) -> JoinedSamples:
    """Join the samples of frames and their gains (3, 2); one that the colors so far do not explain counts less."""
    numbers, weights, gains, wanted = [], [], [], []
    for sample, units in samples:
        gain, offset = apply_gain(units)
        numbers.append(sample.numbers)
        weights.append(sample.weights)
        lit = sample.lit(colors)[:, None] * gain
        error = sample.observed - (sample.shown(colors) * gain + offset)
        share = 1 / np.sqrt(1 + (error**2).mean(axis=1, keepdims=True) / np.float32(OUTLIER_LEVELS**2))
        gains.append(share * lit)
        wanted.append(share * (sample.observed.astype(np.float32) - offset))
    return JoinedSamples(
        numbers=np.concatenate(numbers),
        weights=np.concatenate(weights),
        gain=np.concatenate(gains),
        wanted=np.concatenate(wanted),
    )
