# SPDX-License-Identifier: MIT
"""Surfaces with the colors of a fit, and how much each of these counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threedvc.arrays import Floats
from threedvc.encoder.appearance.fit_state import FitState
from threedvc.encoder.appearance.samples import shown_shares
from threedvc.encoder.fusion.surface_extraction import Surface

__all__ = ["fitted_surfaces", "pixels_per_cell"]

MIN_IMPORTANCE = np.float32(0.02)
"""Of a cell, over the mean: cells that hardly a frame shows get some color, too."""


def fitted_surfaces(state: FitState, *, background_apart: bool = False) -> dict[int, Surface]:
    """Return the surfaces with the colors so far, and how much these count, on an average 1.

    The background can have an average of its own, as is right where its colors may not be sent.
    """
    surfaces = state.all_surfaces
    groups = [[0], [number for number in surfaces if number]] if background_apart else [list(surfaces)]
    importance = _importance(state, surfaces, groups)
    return {
        number: replace(surface, colors=state.colors.cell_colors(number)[1], importance=importance.get(number))
        for number, surface in surfaces.items()
    }


def _importance(state: FitState, surfaces: dict[int, Surface], groups: list[list[int]]) -> dict[int, Floats]:
    """Return how much the frames show of each cell (n,) of objects without texels, over the mean of their group."""
    colors, importance = state.colors, dict[int, Floats]()
    seen = shown_shares(colors, state.samples)
    for group in groups:
        plain = [number for number in group if number in surfaces and not colors.textured(number)]
        numbers = {number: colors.numbers_of(number, surfaces[number].cells) for number in plain}
        cells = {number: mine for number, mine in numbers.items() if len(mine)}
        mean = float(seen[np.concatenate(list(cells.values()))].mean()) if cells else 0.0
        if mean:
            importance |= {number: np.maximum(seen[mine] / mean, MIN_IMPORTANCE) for number, mine in cells.items()}
    return importance


def pixels_per_cell(state: FitState, *, without_background: bool) -> float:
    """Return how many pixels of a frame show a cell, on an average over all frames."""
    chosen = [number for number in state.surfaces if number or not without_background] or [0]
    cells = sum(len(state.surfaces[number].cells) for number in chosen)
    shown = sum(
        np.count_nonzero(np.isin(sample.labels, chosen)) * state.pixels_per_sample(sample.frame)
        for sample in state.samples
    )
    return shown / max(len(state.samples) * cells, 1)
