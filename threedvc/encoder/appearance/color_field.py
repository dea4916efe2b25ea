# SPDX-License-Identifier: MIT
"""Appearance of a finished scene: colours, gains and poses with which the decoder redraws the frames best.

The geometry is fixed here. What the renderer shows at a pixel is a weighted mean of the colours around the point
that the pixel's ray meets, times the gain of the frame: linear in the colours, so they follow by least squares
from all frames at once (conjugate gradients, with a little smoothness for what is hardly seen). Poses and gains
of a frame follow by Gauss-Newton steps that bring the points to where the picture shows their luma and the depth
map their depth. The two are repeated in turn.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats
from threedvc.coding.relief import encode_relief
from threedvc.encoder.appearance.lighting import LightScript
from threedvc.encoder.fusion.surface_extraction import Surface
from threedvc.kernels.encoder.appearance import (
    find_corners,
)
from threedvc.kernels.render.shading import find_normals
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.render.render_model import RenderModel
from threedvc.units import LUMA_WEIGHTS

__all__ = [
    "ColorField",
]


LUMA = np.array(LUMA_WEIGHTS, dtype=np.float32)


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
