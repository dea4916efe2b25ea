# SPDX-License-Identifier: MIT
"""Least squares of the colors of cells, gains of the camera, and light."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats
from threedvc.coding.gains import NEUTRAL, apply_gain, quantized_gain
from threedvc.encoder.appearance.color_field import ColorField
from threedvc.encoder.appearance.lighting import LightEquations, light_terms, light_track
from threedvc.encoder.appearance.photometric_alignment import MIN_POINTS
from threedvc.encoder.appearance.samples import FrameSamples, JoinedSamples
from threedvc.kernels.encoder.appearance import gather_colors, gather_neighbors, scatter_colors
from threedvc.parallel import for_ranges

__all__ = ["solve_colors", "solve_gain", "solve_light"]

SMOOTHNESS = 0.3
"""Weight of the difference from each neighbor against a sample of weight one: decides where hardly any sample does."""
ANCHOR = 1e-3
"""Weight of the color so far: decides only where neither a sample nor a neighbor does."""
CONJUGATE_STEPS = 12
"""Steps of conjugate gradients each time; colors and gains in turn converge slower than these do."""
MIN_CURVATURE = 1e-20
"""Keeps steps finite where nothing is left to be fitted."""
SUM_PARTS = 4
"""In which samples are summed up, whatever the number of threads; each takes as much memory as all colors."""
GAIN_SHRINK = 4.0
"""Variance, in squared levels, that draws a gain to 1: on an even picture nothing tells it from an offset."""
MEDIANS_OF_OUTLIER = 4.0
"""Squared error, in medians of all samples, at which one counts a quarter for the gain."""
GAIN_ROUNDS = 3
"""How often samples are weighed anew by what the gain so far leaves of their error."""


def solve_light(
    colors: ColorField, number: int, samples: Iterable[tuple[FrameSamples, NDArray[np.int64]]], epoch: int
) -> None:
    """Set the lights on an object to those with which its colors fit the samples and gains best.

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
        unlit = (values[here] * gain).astype(np.float64)
        residual = sample.observed[here] - offset - unlit
        equations = LightEquations.of(light_terms(sample.normals[here]), unlit, residual)
        first = sample.frame // epoch * epoch
        epochs[first] = epochs[first] + equations if first in epochs else equations
    if epochs:
        colors.lights[number] = light_track(epochs)


class _NormalEquations:
    """The symmetric system of the least squares, applied without being formed."""

    def __init__(self, samples: JoinedSamples, neighbors: NDArray[np.int32], count: int, threads: int) -> None:
        self._samples, self._neighbors, self._count, self._threads = samples, neighbors, count, threads
        self._bounds = np.linspace(0, len(samples.numbers), SUM_PARTS + 1).astype(int)
        self._rows = np.empty((len(samples.numbers), 3), dtype=np.float32)

    def scatter_add(self, rows: Floats, power: int = 1) -> Floats:
        """Return the sums (cells, 3) of rows (n, 3) over the cells that they are interpolated from.

        In a fixed number of parts, so that the result does not depend on the number of threads.
        """
        sums = np.zeros((SUM_PARTS, self._count, 3), dtype=np.float32)

        def part_range(start: int, stop: int) -> None:
            for part in range(start, stop):
                scatter_colors(
                    self._bounds[part], self._bounds[part + 1], self._samples.numbers, self._samples.weights, rows,
                    power, sums[part],
                )  # fmt: skip

        for_ranges(part_range, SUM_PARTS, self._threads)
        return np.asarray(sums.sum(axis=0), dtype=np.float32)

    def apply(self, values: Floats) -> Floats:
        """Return the system's product with colors (cells, 3)."""
        samples, rows = self._samples, self._rows

        def row_range(start: int, stop: int) -> None:
            gather_colors(start, stop, samples.numbers, samples.weights, values, rows)
            rows[start:stop] *= samples.gain[start:stop] ** 2

        for_ranges(row_range, len(rows), self._threads)
        result = self.scatter_add(rows) + np.float32(ANCHOR) * values
        gather_neighbors(self._neighbors, values, np.float32(SMOOTHNESS), result)
        return result

    def diagonal(self) -> Floats:
        """Return the diagonal (cells, 3)."""
        degrees = np.count_nonzero(self._neighbors >= 0, axis=1)[:, None]
        smoothness = np.float32(SMOOTHNESS) * degrees + np.float32(ANCHOR)
        return np.asarray(self.scatter_add(np.square(self._samples.gain), 2) + smoothness, dtype=np.float32)


def solve_colors(colors: ColorField, samples: JoinedSamples, threads: int) -> None:
    """Set the colors of a field to those whose interpolation fits the samples best."""
    system = _NormalEquations(samples, colors.neighbors, len(colors.values), threads)
    values, scale = colors.values.copy(), np.asarray(1 / system.diagonal(), dtype=np.float32)
    residual = system.scatter_add(samples.gain * samples.wanted) + np.float32(ANCHOR) * values - system.apply(values)
    direction = scale * residual
    slope = _dot(residual, direction)
    for _ in range(CONJUGATE_STEPS):
        product = system.apply(direction)
        step = (slope / np.maximum(_dot(direction, product), MIN_CURVATURE)).astype(np.float32)
        values += step * direction
        residual -= step * product
        descent = scale * residual
        before, slope = slope, _dot(residual, descent)
        direction = descent + (slope / np.maximum(before, MIN_CURVATURE)).astype(np.float32) * direction
    colors.values = values


def _dot(a: Floats, b: Floats) -> Doubles:
    return np.asarray(np.einsum("ij,ij->j", a, b, dtype=np.float64))


def solve_gain(sample: FrameSamples, shown: Floats, gray: bool) -> NDArray[np.int64]:
    """Return the gain (3, 2) with which shown colors (n, 3) come nearest to the observed ones."""
    if len(shown) < MIN_POINTS:
        return NEUTRAL.copy()
    observed = sample.observed.astype(np.float64)
    values = shown.astype(np.float64)
    if gray:
        observed = np.repeat(observed.mean(axis=1, keepdims=True), 3, axis=1)
        values = np.repeat(values.mean(axis=1, keepdims=True), 3, axis=1)
    weight = np.ones(len(values))
    gain, offset = np.ones(3), np.zeros(3)
    for _ in range(GAIN_ROUNDS):
        total = weight.sum()
        mean, wanted = weight @ values / total, weight @ observed / total
        variance = weight @ (values - mean) ** 2 / total
        gain = (weight @ ((values - mean) * (observed - wanted)) / total + GAIN_SHRINK) / (variance + GAIN_SHRINK)
        offset = wanted - gain * mean
        error = ((values * gain + offset - observed) ** 2).mean(axis=1)
        weight = 1 / (1 + error / (MEDIANS_OF_OUTLIER * np.median(error) + 1)) ** 2
    return quantized_gain(gain, offset)
