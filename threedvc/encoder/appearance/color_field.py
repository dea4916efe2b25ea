# SPDX-License-Identifier: MIT
"""Appearance of a finished scene: colours, gains and poses with which the decoder redraws the frames best.

The geometry is fixed here. What the renderer shows at a pixel is a weighted mean of the colours around the point
that the pixel's ray meets, times the gain of the frame: linear in the colours, so they follow by least squares
from all frames at once (conjugate gradients, with a little smoothness for what is hardly seen). Poses and gains
of a frame follow by Gauss-Newton steps that bring the points to where the picture shows their luma and the depth
map their depth. The two are repeated in turn.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.coding.gains import NEUTRAL, apply_gain, quantised_gain
from threedvc.coding.relief import encode_relief
from threedvc.config import RenderConfig
from threedvc.encoder.appearance.lighting import LightEquations, LightScript, light_at, light_script, light_terms
from threedvc.encoder.fusion.surface_extraction import Surface
from threedvc.frames.frame import Frame
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, inverse, make_pose, rotation_from_vector
from threedvc.kernels.encoder.appearance import (
    add_depth_equations,
    add_luma_equations,
    find_corners,
    gather_colors,
    gather_neighbours,
    scatter_colors,
)
from threedvc.kernels.render.shading import LEAST_LIGHT, find_normals
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.parallel import for_ranges
from threedvc.render.ray_grid import RayGrid
from threedvc.render.renderer import Renderer, RenderModel

__all__ = [
    "ColorField",
    "FrameSamples",
    "Sampler",
    "aligned_pose",
    "aligned_shift",
    "fit_colors",
    "fit_gain",
    "fit_light",
    "joined",
    "shown_shares",
]

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

PHASES = ((0, 0), (1, 2), (3, 1), (2, 3))
SMOOTHNESS = 0.3
ANCHOR = 1e-3
STEPS = 12
SPREADS = 3
PARTS = 4
LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)
BLURS_PX = (2.0, 1.0)
POSE_STEPS = 5
LUMA_OUTLIER = 12.0
LUMA_NOISE = 3.0
DEPTH_LIMIT = 0.03
SAMPLES_PER_WITNESS = 30
"""Neighbouring samples are not independent; so many of them count as one against the prior."""
STEP_PRIOR = np.array([0.01, 0.01, 0.01, 0.003, 0.003, 0.003, np.inf, np.inf])
"""Deviation of one step of the shift (m), the turn (rad), gain and offset."""
SHIFT_PRIOR = np.array([0.01, 0.01, 0.01, 0.01, 0.01, 0.01])
"""Deviation of the colour picture's shift (m) and turn (rad)."""
GAIN_DAMPING = np.array([0, 0, 0, 0, 0, 0, 1e-6, 1e-6])
CONVERGED = 1e-4
MIN_POINTS = 100
GAIN_SHRINK = 4.0
OUTLIER_LEVELS = 50.0


class ColorField:
    """Coloured cells or texels of all objects, numbered through, as the decoder will hold them.

    Parameters
    ----------
    surfaces
        Cells of each object, by number.
    voxel_size_m
        Edge of a cell of each object.
    texture_scale
        Texels along an edge of a cell; 1: the cells themselves are coloured.
    threads
        Number of threads.
    guessed
        Numbers of the objects whose shape is a guess.
    relief_bits
        How finely the others tell where the surface passes in a cell.

    Attributes
    ----------
    models
        The objects in the form that rays walk through.
    values
        (n, 3) float32 RGB of the numbered cells; first the mean colours of the surfaces.
    lights
        The lights on objects, by number; none at first.
    """

    def __init__(
        self,
        surfaces: Mapping[int, Surface],
        voxel_size_m: Mapping[int, float],
        texture_scale: Mapping[int, int],
        threads: int,
        guessed: frozenset[int] = frozenset(),
        relief_bits: int = 0,
    ) -> None:
        self.models: dict[int, RenderModel] = {}
        self._numbers: dict[int, NDArray[np.int32]] = {}
        values, neighbours, first = [], [], 0
        for number, surface in surfaces.items():
            is_guess = number in guessed
            model = _model_of(
                surface, voxel_size_m[number], texture_scale[number], is_guess, 0 if is_guess else relief_bits
            )
            self.models[number] = RenderModel(model)
            self.models[number].refresh(threads)
            numbers, cells, own = _numbered(model)
            values.append(own)
            neighbours.append(_neighbours(model, cells, numbers, first))
            numbers[numbers >= 0] += first
            self._numbers[number] = numbers
            first += len(own)
        self.values: Floats = np.concatenate(values) if values else np.zeros((0, 3), np.float32)
        self.lights: dict[int, LightScript] = {}
        self.neighbours = np.concatenate(neighbours) if neighbours else np.zeros((0, 6), np.int32)

    def corners(self, number: int, points: Doubles) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Return the numbers and weights (n, 8) of the cells around points (n, 3) of an object, in metres."""
        grid = self.models[number].model.color_grids()[0]
        numbers, weights = np.empty((len(points), 8), np.int32), np.empty((len(points), 8), np.uint8)
        find_corners(points / grid.cell_size_m - 0.5, grid.tables, self._numbers[number], numbers, weights)
        return numbers, weights

    def normals(self, number: int, points: Doubles, directions: Doubles) -> Doubles:
        """Return the normals (n, 3) at points (n, 3) of an object, in metres, turned against directions (n, 3)."""
        model, normals = self.models[number].model, np.zeros((len(points), 3))
        find_normals(
            points / model.voxel_size_m - 0.5, directions, model.index.tables, model.occupied.reshape(-1),
            model.planes.reshape(-1, 4), normals,
        )  # fmt: skip
        return normals

    def cell_colors(self, number: int) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
        """Return the cells (n, 3) of an object in Morton order and their colours (n, 3): means of their texels."""
        model = self.models[number].model
        cells, colors = model.cells()
        if model.texture is None:
            return cells, _rounded(self.values[self.numbers_of(number, cells)])
        texels, values = self._texels(number)
        owners = model.index.locate(texels // model.texture.scale)
        count = np.bincount(owners, minlength=model.occupied.size)
        sums = np.stack([np.bincount(owners, values[:, k], model.occupied.size) for k in range(3)], axis=1)
        here = model.index.locate(cells)
        means = sums[here] / np.maximum(count[here], 1)[:, None]
        return cells, np.where(count[here][:, None] > 0, _rounded(means), colors)

    def textured(self, number: int) -> bool:
        """Tell whether an object's colours are those of texels."""
        return self.models[number].model.texture is not None

    def numbers_of(self, number: int, cells: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the numbers (n,) of cells (n, 3) of an object without texels."""
        return self._numbers[number][self.models[number].model.index.locate(cells)]

    def recolor(self, number: int, cells: NDArray[np.int32], colors: NDArray[np.int16]) -> None:
        """Set the colours (n, 3) of cells (n, 3) of an object without texels."""
        self.values[self.numbers_of(number, cells)] = colors

    def texel_colors(self, number: int, texels: NDArray[np.int32], default: NDArray[np.int16]) -> NDArray[np.int16]:
        """Return the colours (n, 3) of texels (n, 3); `default` where the field has none."""
        model = self.models[number].model
        assert model.texture is not None
        positions = model.texture.index.locate(texels)
        found = np.where(positions >= 0, self._numbers[number][positions], -1)
        return np.where(found[:, None] >= 0, _rounded(self.values[found]), default)

    def _texels(self, number: int) -> tuple[NDArray[np.int32], Floats]:
        texture = self.models[number].model.texture
        assert texture is not None
        texels, _ = texture.texels()
        return texels, self.values[self._numbers[number][texture.index.locate(texels)]]


def _rounded(values: NDArray[np.floating]) -> NDArray[np.int16]:
    return np.asarray(np.clip(np.rint(values), -256, 511), dtype=np.int16)


def _model_of(
    surface: Surface, voxel_size_m: float, texture_scale: int, guessed: bool, relief_bits: int
) -> DecodedModel:
    """Return a decoded model with the cells and the relief of a surface, and texels coloured as their cells."""
    model = DecodedModel(voxel_size_m, texture_scale, guessed=guessed, relief_bits=relief_bits)
    model.apply(ModelUpdate.adding(surface.cells, surface.colors))
    if relief_bits and len(surface.cells):
        encode_relief(model, surface.crossings_of(model.untold_cells()[0]))
    if model.texture is not None:
        texels = model.bare_texels()
        model.texture.paint(texels, model.color.reshape(-1, 3)[model.index.locate(texels // texture_scale)])
    return model


def _numbered(model: DecodedModel) -> tuple[NDArray[np.int32], NDArray[np.int32], Floats]:
    """Return the number of every coloured cell by position (-1: none), and these cells with their colours."""
    index = model.index if model.texture is None else model.texture.index
    grid = model.color_grids()[0]
    cells, colors = model.cells() if model.texture is None else model.texture.texels()
    numbers = np.full(len(grid.colored), -1, dtype=np.int32)
    numbers[index.locate(cells)] = np.arange(len(cells))
    return numbers, cells, colors.astype(np.float32)


def _neighbours(
    model: DecodedModel, cells: NDArray[np.int32], numbers: NDArray[np.int32], first: int
) -> NDArray[np.int32]:
    """Return the numbers (n, 6) of the cells that share a face with each cell, counted from `first`; -1: none."""
    index = model.index if model.texture is None else model.texture.index
    neighbours = np.empty((len(cells), 6), dtype=np.int32)
    for k in range(6):
        step = np.zeros(3, dtype=np.int32)
        step[k // 2] = 1 - 2 * (k % 2)
        positions = index.locate(cells + step)
        found = np.where(positions >= 0, numbers[positions], -1)
        neighbours[:, k] = np.where(found >= 0, found + first, -1)
    return neighbours


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
        (n, 3) float64 points met, in the object's frame, metres.
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
        """Return the colours (n, 3) without gain."""
        shown = np.empty((len(self.labels), 3), dtype=np.float32)
        gather_colors(0, len(shown), self.numbers, self.weights, field.values, shown)
        return shown * self.lit(field)[:, None]

    def lit(self, field: ColorField) -> Floats:
        """Return the light (n,) on the samples."""
        light = np.ones(len(self.labels), dtype=np.float32)
        for number, script in field.lights.items():
            here = self.labels == number
            light[here] += (light_terms(self.normals[here]) @ light_at(script, self.frame)).astype(np.float32)
        return np.asarray(np.maximum(light, np.float32(LEAST_LIGHT)))


class Sampler:
    """Casts every n-th pixel of the colour camera, other ones from frame to frame.

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
        """Return the samples of a frame whose rays meet a coloured cell; `poses` are T_camera_object."""
        x, y, rays = self._grids[frame.index % len(self._grids)]
        T_color_camera = compose(self._rig.T_color_depth, T_shifted_camera)
        moved = {number: compose(T_color_camera, poses[number]) for number in poses}
        met = self._renderer.cast(rays, field.models, moved)
        depth, labels = self._renderer.cast_guessed(rays, field.models, moved, *met)
        count = len(depth)
        points = np.concatenate([rays.slopes, np.ones((count, 1))], axis=1) * depth[:, None].astype(np.float64)
        numbers, weights = np.zeros((count, 8), np.int32), np.zeros((count, 8), np.uint8)
        normals = np.zeros((count, 3))
        for number in moved:
            here = np.flatnonzero((labels == number) & (depth > 0))
            T = inverse(moved[number])
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
    count = 1 + np.count_nonzero(colors.neighbours >= 0, axis=1)
    for _ in range(SPREADS):
        shares = (shares + np.append(shares, 0)[colors.neighbours].sum(axis=1)) / count
    return shares.astype(np.float32)


def fit_light(
    colors: ColorField, number: int, samples: Iterable[tuple[FrameSamples, NDArray[np.int64]]], epoch: int
) -> None:
    """Set the lights on an object to those with which its colours fit the samples and gains best.

    They may change every `epoch` frames.
    """
    epochs: dict[int, LightEquations] = {}
    for sample, units in samples:
        here = sample.labels == number
        if not here.any():
            continue
        gain, offset = apply_gain(units)
        values = np.empty((len(here), 3), dtype=np.float32)
        gather_colors(0, len(here), sample.numbers, sample.weights, colors.values, values)
        base = (values[here] * gain).astype(np.float64)
        rest = sample.observed[here] - offset - base
        equations, first = (
            LightEquations.of(light_terms(sample.normals[here]), base, rest),
            sample.frame // epoch * epoch,
        )
        epochs[first] = epochs[first] + equations if first in epochs else equations
    if epochs:
        colors.lights[number] = light_script(epochs)


def joined(colors: ColorField, samples: Iterable[tuple[FrameSamples, NDArray[np.int64]]]) -> JoinedSamples:
    """Join the samples of frames and their gains (3, 2); one that the colours so far do not explain counts less."""
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


class _NormalEquations:
    """The symmetric system of the least squares, applied without being formed."""

    def __init__(self, samples: JoinedSamples, neighbours: NDArray[np.int32], count: int, threads: int) -> None:
        self._samples, self._neighbours, self._count, self._threads = samples, neighbours, count, threads
        self._bounds = np.linspace(0, len(samples.numbers), PARTS + 1).astype(int)
        self._rows = np.empty((len(samples.numbers), 3), dtype=np.float32)

    def spread(self, rows: Floats, power: int = 1) -> Floats:
        """Return the sums (cells, 3) of rows (n, 3) over the cells that they are interpolated from.

        In a fixed number of parts, so that the result does not depend on the number of threads.
        """
        sums = np.zeros((PARTS, self._count, 3), dtype=np.float32)

        def part_range(start: int, stop: int) -> None:
            for part in range(start, stop):
                scatter_colors(
                    self._bounds[part], self._bounds[part + 1], self._samples.numbers, self._samples.weights, rows,
                    power, sums[part],
                )  # fmt: skip

        for_ranges(part_range, PARTS, self._threads)
        return np.asarray(sums.sum(axis=0), dtype=np.float32)

    def apply(self, values: Floats) -> Floats:
        """Return the system's product with colours (cells, 3)."""
        samples, rows = self._samples, self._rows

        def row_range(start: int, stop: int) -> None:
            gather_colors(start, stop, samples.numbers, samples.weights, values, rows)
            rows[start:stop] *= samples.gain[start:stop] ** 2

        for_ranges(row_range, len(rows), self._threads)
        result = self.spread(rows) + np.float32(ANCHOR) * values
        gather_neighbours(self._neighbours, values, np.float32(SMOOTHNESS), result)
        return result

    def diagonal(self) -> Floats:
        """Return the diagonal (cells, 3)."""
        degrees = np.count_nonzero(self._neighbours >= 0, axis=1)[:, None]
        smoothness = np.float32(SMOOTHNESS) * degrees + np.float32(ANCHOR)
        return np.asarray(self.spread(np.square(self._samples.gain), 2) + smoothness, dtype=np.float32)


def fit_colors(colors: ColorField, samples: JoinedSamples, threads: int) -> None:
    """Set the colours of a field to those whose interpolation fits the samples best."""
    system = _NormalEquations(samples, colors.neighbours, len(colors.values), threads)
    values, scale = colors.values.copy(), np.asarray(1 / system.diagonal(), dtype=np.float32)
    residual = system.spread(samples.gain * samples.wanted) + np.float32(ANCHOR) * values - system.apply(values)
    along = scale * residual
    slope = _dot(residual, along)
    for _ in range(STEPS):
        product = system.apply(along)
        step = (slope / np.maximum(_dot(along, product), 1e-20)).astype(np.float32)
        values += step * along
        residual -= step * product
        ahead = scale * residual
        before, slope = slope, _dot(residual, ahead)
        along = ahead + (slope / np.maximum(before, 1e-20)).astype(np.float32) * along
    colors.values = values


def _dot(a: Floats, b: Floats) -> Doubles:
    return np.asarray(np.einsum("ij,ij->j", a, b, dtype=np.float64))


def fit_gain(sample: FrameSamples, shown: Floats, grey: bool) -> NDArray[np.int64]:
    """Return the gain (3, 2) with which shown colours (n, 3) come nearest to the observed ones."""
    if len(shown) < MIN_POINTS:
        return NEUTRAL.copy()
    observed = sample.observed.astype(np.float64)
    values = shown.astype(np.float64)
    if grey:
        observed = np.repeat(observed.mean(axis=1, keepdims=True), 3, axis=1)
        values = np.repeat(values.mean(axis=1, keepdims=True), 3, axis=1)
    weight = np.ones(len(values))
    gain, offset = np.ones(3), np.zeros(3)
    for _ in range(3):
        total = weight.sum()
        mean, wanted = weight @ values / total, weight @ observed / total
        spread = weight @ (values - mean) ** 2 / total
        gain = (weight @ ((values - mean) * (observed - wanted)) / total + GAIN_SHRINK) / (spread + GAIN_SHRINK)
        offset = wanted - gain * mean
        error = ((values * gain + offset - observed) ** 2).mean(axis=1)
        weight = 1 / (1 + error / (4 * np.median(error) + 1)) ** 2
    return quantised_gain(gain, offset)


def aligned_pose(
    frame: Frame,
    rig: CameraRig,
    T_camera_object: Pose,
    points: Doubles,
    luma: Doubles,
    *,
    sensor: SensorModel,
) -> Pose:
    """Move an object so that its points fit the frame's picture and depth.

    Parameters
    ----------
    frame
        The frame.
    rig
        Cameras.
    T_camera_object
        The pose to start from.
    points, luma
        (n, 3) points of the object in metres, and (n,) their luma.
    sensor
        Noise of the depth.

    Returns
    -------
    Pose
        The start where there are too few points.
    """
    return _aligned(frame, rig, T_camera_object, points, luma, sensor, None)


def aligned_shift(
    frame: Frame, rig: CameraRig, T_camera_object: Pose, points: Doubles, luma: Doubles, T_shifted_camera: Pose
) -> Pose:
    """Return the shift of the depth camera with which points fit the picture alone; see `aligned_pose`."""
    start = compose(T_shifted_camera, T_camera_object)
    end = _aligned(frame, rig, start, points, luma, None, T_camera_object)
    return compose(end, inverse(T_camera_object))


def _aligned(
    frame: Frame,
    rig: CameraRig,
    pose: Pose,
    points: Doubles,
    luma: Doubles,
    sensor: SensorModel | None,
    anchor: Pose | None,
) -> Pose:
    """Take Gauss-Newton steps; without `sensor` the depth does not count, with an `anchor` the pose keeps near it."""
    if len(points) < MIN_POINTS:
        return pose
    picture = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY).astype(np.float32)
    gain, offset = 1.0, 0.0
    for blur in BLURS_PX:
        smooth = cv2.GaussianBlur(picture, (0, 0), blur)
        slopes = [np.asarray(cv2.Sobel(smooth, cv2.CV_32F, *axes, ksize=3, scale=0.125)) for axes in ((1, 0), (0, 1))]
        for _ in range(POSE_STEPS):
            matrix, side = np.zeros((8, 8)), np.zeros(8)
            total, count = add_luma_equations(
                points, luma, pose, rig.T_color_depth, rig.color.parameters(), smooth, slopes[0], slopes[1], gain,
                offset, LUMA_OUTLIER, matrix, side,
            )  # fmt: skip
            share = 1 / (SAMPLES_PER_WITNESS * max(total / max(count, 1.0), LUMA_NOISE**2))
            matrix, side = matrix * share, side * share
            if sensor is not None:
                depth_matrix, depth_side = _depth_equations(frame, rig, sensor, pose, points)
                matrix, side = matrix + depth_matrix, side + depth_side
            if anchor is not None:
                matrix[range(6), range(6)] += SHIFT_PRIOR**-2
                side[:6] += SHIFT_PRIOR**-2 * _twist(compose(pose, inverse(anchor)))
            full = matrix + np.triu(matrix, 1).T + np.diag(STEP_PRIOR**-2 + GAIN_DAMPING)
            step = -np.linalg.solve(full, side)
            pose = compose(make_pose(rotation_from_vector(step[3:6]), step[:3]), pose)
            gain, offset = gain + step[6], offset + step[7]
            if np.abs(step[:6]).max() < CONVERGED:
                break
    return pose


def _depth_equations(
    frame: Frame, rig: CameraRig, sensor: SensorModel, pose: Pose, points: Doubles
) -> tuple[Doubles, Doubles]:
    noise = np.array([sensor.s0_m, sensor.s1, sensor.s2_per_m, sensor.quantum_per_m])
    matrix, side = np.zeros((8, 8)), np.zeros(8)
    total, count = add_depth_equations(
        points, pose, rig.depth.parameters(), frame.depth, noise, DEPTH_LIMIT, matrix, side
    )
    share = 1 / (SAMPLES_PER_WITNESS * max(total / max(count, 1.0), 1.0))
    return matrix * share, side * share


def _twist(T: Pose) -> Doubles:
    """Return shift and turn (6,) of a small motion."""
    turn = [T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]]
    return np.concatenate([T[:3, 3], 0.5 * np.array(turn)])
