# SPDX-License-Identifier: MIT
"""Regions of interest: where errors of colors count more, and bits go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.color import MAX_STEP, MIN_STEP, ColorSettings
from threedvc.config import RegionOfInterest
from threedvc.model.model_update import ModelUpdate

__all__ = ["object_weight", "roi_weights", "with_roi_weights", "with_steps_scaled"]


def roi_weights(
    focuses: Sequence[RegionOfInterest], number: int, cells: NDArray[np.int32], voxel_size_m: float
) -> NDArray[np.float32]:
    """Return how much the squared error of cells (n, 3) of an object counts, (n,), 1 outside all regions.

    A cell's weight is the product of those of its object and of the boxes that its center lies in.
    """
    weights = np.ones(len(cells), dtype=np.float32)
    for focus in focuses:
        if focus.number == number:
            weights *= np.float32(focus.weight)
        elif focus.box_m is not None and number == 0:
            low, high = np.array(focus.box_m).reshape(3, 2).T
            centers = (cells + 0.5) * voxel_size_m
            weights[np.all((centers >= low) & (centers < high), axis=1)] *= np.float32(focus.weight)
    return weights


def with_roi_weights(
    update: ModelUpdate, settings: ColorSettings, focuses: Sequence[RegionOfInterest], number: int, voxel_size_m: float
) -> tuple[ModelUpdate, ColorSettings]:
    """Return an update and settings with which its colors are coded as finely as the focus asks.

    An error may be as large as one over the root of its weight. Steps are those of the heaviest cell; a lighter
    one gets its coarser values by its lower importance.
    """
    cells = np.concatenate([update.added, update.recolored])
    if not focuses or not len(cells):
        return update, settings
    weights = roi_weights(focuses, number, cells, voxel_size_m)
    heaviest = float(weights.max())
    relative = weights / np.float32(heaviest)
    importance = relative if update.importance is None else update.importance * relative
    return replace(update, importance=importance), with_steps_scaled(settings, heaviest)


def object_weight(focuses: Sequence[RegionOfInterest], number: int) -> float:
    """Return how much the squared error of an object as a whole counts."""
    return float(np.prod([focus.weight for focus in focuses if focus.number == number]))


def with_steps_scaled(settings: ColorSettings, weight: float) -> ColorSettings:
    """Return the settings with which squared errors are smaller by a factor."""
    luma, chroma = (max(step / weight**0.5, MIN_STEP) for step in (settings.luma_step, settings.chroma_step))
    return replace(settings, luma_step=min(luma, MAX_STEP), chroma_step=min(chroma, MAX_STEP))
