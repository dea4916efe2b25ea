# SPDX-License-Identifier: MIT
"""Appearance of a finished scene: colors, gains and poses with which the decoder redraws the frames best.

The geometry is fixed here. What the renderer shows at a pixel is a weighted mean of the colors around the point
that the pixel's ray meets, times the gain of the frame: linear in the colors, so they follow by least squares
from all frames at once (conjugate gradients, with a little smoothness for what is hardly seen). Poses and gains
of a frame follow by Gauss-Newton steps that bring the points to where the picture shows their luma and the depth
map their depth. The two are repeated in turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats
from threedvc.coding.relief import encode_relief
from threedvc.encoder.appearance.lighting import LightTrack
from threedvc.encoder.fusion.surface_extraction import Surface
from threedvc.kernels.encoder.appearance import find_corners
from threedvc.kernels.render.shading import find_normals
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.render.render_model import RenderModel

__all__ = ["ColorField", "FieldObject"]

MIN_COLOR, MAX_COLOR = -256, 511
"""The renderer clips after gain and light: before, a color may lie beyond 0 to 255 by as much again."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FieldObject:
    """What a field is made of: an object's cells, and how the decoder will hold them.

    Attributes
    ----------
    surface
        The cells.
    voxel_size_m
        Edge of a cell.
    texture_scale
        Texels along an edge of a cell; 1: the cells themselves are colored.
    relief_bits
        How finely it tells where the surface passes in a cell.
    inferred
        Whether its shape is inferred, not measured.
    """

    surface: Surface
    voxel_size_m: float
    texture_scale: int = 1
    relief_bits: int = 0
    inferred: bool = False

    def model(self) -> DecodedModel:
        """Return a decoded model with the cells and the relief, and texels colored as their cells."""
        surface, scale = self.surface, self.texture_scale
        model = DecodedModel(self.voxel_size_m, scale, guessed=self.inferred, relief_bits=self.relief_bits)
        model.apply(ModelUpdate.adding(surface.cells, surface.colors))
        if self.relief_bits and len(surface.cells):
            encode_relief(model, surface.offsets_at(model.cells_without_offset()[0]))
        if model.texture is not None:
            texels = model.uncolored_texels()
            model.texture.paint(texels, model.color.reshape(-1, 3)[model.index.locate(texels // scale)])
        return model


class ColorField:
    """Colored cells or texels of all objects, numbered through, as the decoder will hold them.

    Parameters
    ----------
    objects
        The objects, by number.
    threads
        Number of threads.

    Attributes
    ----------
    models
        The objects in the form that rays walk through.
    values
        (n, 3) float32 RGB of the numbered cells; first the mean colors of the surfaces.
    neighbors
        (n, 6) int32 numbers of the cells that share a face with each; -1: none.
    lights
        The lights on objects, by number; none at first.
    """

    def __init__(self, objects: Mapping[int, FieldObject], threads: int) -> None:
        self.models: dict[int, RenderModel] = {}
        self._numbers: dict[int, NDArray[np.int32]] = {}
        values, neighbors, first = [], [], 0
        for number, item in objects.items():
            model = item.model()
            self.models[number] = RenderModel(model)
            self.models[number].refresh(threads)
            numbers, cells, own = _numbered(model)
            values.append(own)
            neighbors.append(_neighbors(model, cells, numbers, first))
            numbers[numbers >= 0] += first
            self._numbers[number] = numbers
            first += len(own)
        self.values: Floats = np.concatenate(values) if values else np.zeros((0, 3), np.float32)
        self.lights: dict[int, LightTrack] = {}
        self.neighbors = np.concatenate(neighbors) if neighbors else np.zeros((0, 6), np.int32)

    def corners(self, number: int, points: Doubles) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Return the numbers and weights (n, 8) of the cells around points (n, 3) of an object, in meters."""
        grid = self.models[number].model.color_grids()[0]
        numbers, weights = np.empty((len(points), 8), np.int32), np.empty((len(points), 8), np.uint8)
        find_corners(points / grid.cell_size_m - 0.5, grid.tables, self._numbers[number], numbers, weights)
        return numbers, weights

    def normals(self, number: int, points: Doubles, directions: Doubles) -> Doubles:
        """Return the normals (n, 3) at points (n, 3) of an object, in meters, turned against directions (n, 3)."""
        model, normals = self.models[number].model, np.zeros((len(points), 3))
        find_normals(
            points / model.voxel_size_m - 0.5, directions, model.index.tables, model.occupied.reshape(-1),
            model.planes.reshape(-1, 4), normals,
        )  # fmt: skip
        return normals

    def cell_colors(self, number: int) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
        """Return the cells (n, 3) of an object in Morton order and their colors (n, 3): means of their texels."""
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
        """Tell whether an object's colors are those of texels."""
        return self.models[number].model.texture is not None

    def numbers_of(self, number: int, cells: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the numbers (n,) of cells (n, 3) of an object without texels."""
        return self._numbers[number][self.models[number].model.index.locate(cells)]

    def recolor(self, number: int, cells: NDArray[np.int32], colors: NDArray[np.int16]) -> None:
        """Set the colors (n, 3) of cells (n, 3) of an object without texels."""
        self.values[self.numbers_of(number, cells)] = colors

    def texel_colors(self, number: int, texels: NDArray[np.int32], default: NDArray[np.int16]) -> NDArray[np.int16]:
        """Return the colors (n, 3) of texels (n, 3); `default` where the field has none."""
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
    return np.asarray(np.clip(np.rint(values), MIN_COLOR, MAX_COLOR), dtype=np.int16)


def _numbered(model: DecodedModel) -> tuple[NDArray[np.int32], NDArray[np.int32], Floats]:
    """Return the number of every colored cell by position (-1: none), and these cells with their colors."""
    index = model.index if model.texture is None else model.texture.index
    grid = model.color_grids()[0]
    cells, colors = model.cells() if model.texture is None else model.texture.texels()
    numbers = np.full(len(grid.colored), -1, dtype=np.int32)
    numbers[index.locate(cells)] = np.arange(len(cells))
    return numbers, cells, colors.astype(np.float32)


def _neighbors(
    model: DecodedModel, cells: NDArray[np.int32], numbers: NDArray[np.int32], first: int
) -> NDArray[np.int32]:
    """Return the numbers (n, 6) of the cells that share a face with each cell, counted from `first`; -1: none."""
    index = model.index if model.texture is None else model.texture.index
    neighbors = np.empty((len(cells), 6), dtype=np.int32)
    for k in range(6):
        step = np.zeros(3, dtype=np.int32)
        step[k // 2] = 1 - 2 * (k % 2)
        positions = index.locate(cells + step)
        found = np.where(positions >= 0, numbers[positions], -1)
        neighbors[:, k] = np.where(found >= 0, found + first, -1)
    return neighbors
