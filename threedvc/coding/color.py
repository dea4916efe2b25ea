# SPDX-License-Identifier: MIT
"""Lossy coding of cell colors: a hierarchical transform with prediction, level by level."""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.entropy.mixer import new_mixer
from threedvc.coding.entropy.range_coder import RangeCoder, new_counters
from threedvc.coding.octree import Neighborhood, Octree, children_of
from threedvc.errors import ConfigError, CorruptStream
from threedvc.kernels.coding.color_coding import (
    COLOR_MODELS,
    COLOR_SETS,
    COLOR_WEIGHT_ROWS,
    SIGN_COUNTERS,
    Quantizer,
    code_colors,
)
from threedvc.kernels.coding.color_transform import (
    FRACTION_BITS,
    MAX_VALUE,
    ColorLevel,
    from_luma_chroma,
    sum_children,
    to_luma_chroma,
)
from threedvc.kernels.coding.octree import BIT_COUNTS
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS

__all__ = ["MAX_STEP", "MIN_STEP", "ColorSettings", "code_cell_colors"]

STEP_BITS = 4
"""Steps are coded in 2^-4 of a gray level. As the next two, this is part of the format (docs/coding.md)."""
MIN_STEP, MAX_STEP = 2**-STEP_BITS, 255.0
"""From the least that can be coded to the range of a color."""
MIDDLE_GRAY = 128 << FRACTION_BITS
"""Guess of the first mean."""
BYTES_PER_COEFFICIENT = 64
"""Room for one: the costliest takes 46, of 31 adaptive bits at 11 bits each and 21 even ones."""
PRICE = 30
"""What the writer lets a bit save in squared error, in 1/256 of the squared step."""


@dataclass(frozen=True, kw_only=True)
class ColorSettings:
    """How finely colors are coded.

    Attributes
    ----------
    luma_step, chroma_step
        Quantization steps in gray levels, 1/16 to 255; coded in sixteenths.
    gray
        Whether there is luma alone.
    """

    luma_step: float = 24.0
    chroma_step: float = 36.0
    gray: bool = False

    def __post_init__(self) -> None:
        for step in (self.luma_step, self.chroma_step):
            if not MIN_STEP <= step <= MAX_STEP:
                raise ConfigError(f"color step {step} must be within {MIN_STEP}..{MAX_STEP}")

    @property
    def channels(self) -> int:
        """Number of coded channels."""
        return 1 if self.gray else 3

    def code(self, coder: RangeCoder) -> ColorSettings:
        """Code the settings; return them as the decoder sees them."""
        counters = new_counters(NUMBER_COUNTERS)
        gray = coder.bit(self.gray)
        luma = coder.number(round(self.luma_step * 2**STEP_BITS), counters)
        chroma = luma if gray else coder.number(round(self.chroma_step * 2**STEP_BITS), counters)
        if not (1 <= luma <= MAX_STEP * 2**STEP_BITS and 1 <= chroma <= MAX_STEP * 2**STEP_BITS):
            raise CorruptStream(f"color steps {luma}/16, {chroma}/16 are out of range; the stream is damaged")
        return ColorSettings(luma_step=luma / 2**STEP_BITS, chroma_step=chroma / 2**STEP_BITS, gray=gray)

    def steps(self) -> NDArray[np.int64]:
        """Return the steps per channel in fixed point."""
        steps = [self.luma_step, self.chroma_step, self.chroma_step][: self.channels]
        return np.array([round(step * 2**FRACTION_BITS) for step in steps], dtype=np.int64)


class _MeanTree:
    """Mean colors and weights of the nodes of every level of an octree, and of the cells behind them."""

    def __init__(
        self, tree: Octree, colors: NDArray[np.int16], channels: int, importance: NDArray[np.float32] | None = None
    ) -> None:
        values = np.empty((len(colors), 3), dtype=np.int64)
        to_luma_chroma(colors, values)
        sums, weights = values[:, :channels].copy(), np.ones(len(values), dtype=np.int64)
        self.means, self.weights = [sums], [weights]
        important = np.ones(len(colors), dtype=np.float32) if importance is None else importance
        self.importance = [important]
        for level in reversed(tree.levels):
            child_sums, child_weights = sums, weights
            sums = np.empty((len(level.codes), channels), dtype=np.int64)
            weights = np.empty(len(level.codes), dtype=np.int64)
            sum_children(level.masks, child_sums, child_weights, sums, weights)
            self.means.insert(0, (2 * sums + weights[:, None]) // (2 * weights[:, None]))
            self.weights.insert(0, weights)
            sums_of_important = np.add.reduceat(important * child_weights, level.first)
            important = (sums_of_important / weights).astype(np.float32)
            self.importance.insert(0, important)


def code_cell_colors(
    coder: RangeCoder,
    tree: Octree,
    colors: NDArray[np.int16],
    state: Octree,
    state_colors: NDArray[np.int16],
    settings: ColorSettings,
    node_colors: NDArray[np.int16] | None = None,
    coded_levels: int | None = None,
    importance: NDArray[np.float32] | None = None,
) -> NDArray[np.int16]:
    """Code the colors of cells that both sides know.

    Parameters
    ----------
    coder
        Where to write to or to read from.
    tree
        The cells.
    colors
        (n, 3) int16 RGB of the cells in the order of `tree`; of no meaning when reading.
    state, state_colors
        Tree and (m, 3) int16 RGB of the state before, for prediction.
    settings
        Steps.
    node_colors, coded_levels
        (k, 3) int16 RGB of the k nodes of a level of `tree`, if both sides know them, and the number of levels below,
        which alone are coded.
    importance
        (n,) how much an error of each cell counts, 1 if not given; of no meaning when reading.

    Returns
    -------
    colors
        (n, 3) int16 RGB as decoded.

    Raises
    ------
    CorruptStream
        If the data end too early.
    """
    channels = settings.channels
    true, known = _MeanTree(tree, colors, channels, importance), _MeanTree(state, state_colors, channels)
    mixer = new_mixer(COLOR_MODELS, COLOR_SETS, COLOR_WEIGHT_ROWS)
    quantizer = Quantizer(
        settings.steps(), PRICE, new_counters(channels * NUMBER_COUNTERS), new_counters(SIGN_COUNTERS)
    )
    own, beside = Neighborhood(True), Neighborhood(len(state.codes) > 0)
    first = 0 if coded_levels is None else len(tree.levels) - coded_levels
    means = np.empty((0, channels), dtype=np.int64)
    if node_colors is None:
        means = _code_root(coder, true.means[0], known.means[0], int(true.weights[0][0]), quantizer)
    parents, parent_energy = np.zeros(1, dtype=np.int32), np.zeros((1, channels), dtype=np.int32)
    for number, level in enumerate(tree.levels):
        count = int(BIT_COUNTS[level.masks].sum())
        near = own.near
        own.descend(level, level, count)
        beside.descend(level, state.levels[number], count)
        if number < first:
            continue
        if node_colors is not None and number == first:
            values = np.empty((len(node_colors), 3), dtype=np.int64)
            to_luma_chroma(node_colors, values)
            means = np.ascontiguousarray(values[:, :channels])
            parents = np.zeros(len(means), dtype=np.int32)
        stage = ColorLevel(
            masks=level.masks,
            first=level.first,
            parents=parents,
            means=means,
            energy=np.zeros((len(level.masks), channels), dtype=np.int32),
            parent_energy=parent_energy,
            near=near,
            child_weights=true.weights[number + 1],
            child_means=np.zeros((count, channels), dtype=np.int64),
            true_means=true.means[number + 1],
            child_importance=true.importance[number + 1],
            child_near=own.near,
            state_means=known.means[number + 1],
            state_near=beside.near,
        )
        coder.reserve(BYTES_PER_COEFFICIENT * channels * count)
        if not code_colors(coder.coder, mixer, quantizer, stage, len(tree.levels) - 1 - number):
            raise CorruptStream("the colors of a model update end too early; the stream is damaged")
        means, parent_energy = stage.child_means, stage.energy
        parents = children_of(level)[1]
    decoded = np.empty((len(means), 3), dtype=np.int16)
    from_luma_chroma(np.pad(means, ((0, 0), (0, 3 - channels))), decoded)
    return decoded


def _code_root(
    coder: RangeCoder,
    true: NDArray[np.int64],
    known: NDArray[np.int64],
    weight: int,
    quantizer: Quantizer,
) -> NDArray[np.int64]:
    """Code the mean color (1, channels) of all cells, predicted by that of the state."""
    guess = known[0] if len(known) else np.array([MIDDLE_GRAY, 0, 0], dtype=np.int64)[: true.shape[1]]
    counters = new_counters(NUMBER_COUNTERS)
    means = np.empty_like(true)
    for channel, step in enumerate(quantizer.steps.tolist()):
        fine = max(1, isqrt(step * step // weight))
        value = coder.signed(round((int(true[0, channel]) - int(guess[channel])) / fine), counters)
        means[0, channel] = min(max(int(guess[channel]) + value * fine, -MAX_VALUE), MAX_VALUE)
    return means
