# SPDX-License-Identifier: MIT
"""Region-adaptive hierarchical transform of cell colors with prediction, compiled.

A node of the octree stands for the mean of its cells, in fixed point. Its children are paired along
x, then y, then z; a pair is replaced by its weighted mean and its difference. The decoder goes the
other way: the means of a level are known, the differences are read. A difference of cells of weight
a and b is quantized with the step ``step * sqrt((a + b) / (a b))``, which is the uniform quantizer
of the orthonormal transform. Differences are predicted from the means around the node.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.coding.octree import BIT_COUNTS

__all__ = [
    "FRACTION_BITS",
    "MAX_VALUE",
    "ColorLevel",
    "from_luma_chroma",
    "load_children",
    "merge_importance",
    "merge_pairs",
    "predict_child",
    "rounded_ratio",
    "split_pairs",
    "step_of_pair",
    "store_children",
    "sum_children",
    "to_luma_chroma",
]

FRACTION_BITS = 10
"""Bits below the point of colors: rounding in all levels of a tree adds up to far less than a gray level. As all
numbers here, it is part of the format (docs/coding.md)."""
MAX_VALUE = 1 << (FRACTION_BITS + 10)
"""Bound of means, four times what colors of 8 bits can be: no product leaves 63 bits."""
MIN_COLOR, MAX_COLOR = -256, 511
"""Range of decoded colors: what a fit asks of cells may lie a range of 8 bits beyond it, on either side."""


class ColorLevel(NamedTuple):
    """One level of a color tree whose children are to be coded.

    Attributes
    ----------
    masks, first, parents
        (n,) child masks, first children and parents of the nodes.
    means
        (n, channels) int64 reconstructed means of the nodes.
    energy, parent_energy
        (n, channels) int32 sums of quantized magnitudes, of the nodes (written) and of the level above.
    near
        (n, 27) int32 nodes around the nodes.
    child_weights
        (m,) int64 weights of the children.
    child_means
        (m, channels) int64 reconstructed means of the children (written).
    true_means, child_importance
        (m, channels) int64 means of the children before coding, and (m,) float32 how much the error of their cells
        counts on an average; of no meaning to a reader.
    child_near
        (m, 27) int32 children around the children.
    state_means, state_near
        (k, channels) means of the children's level in the state before, and (m, 27) indices into it.
    """

    masks: NDArray[np.uint8]
    first: NDArray[np.int32]
    parents: NDArray[np.int32]
    means: NDArray[np.int64]
    energy: NDArray[np.int32]
    parent_energy: NDArray[np.int32]
    near: NDArray[np.int32]
    child_weights: NDArray[np.int64]
    child_means: NDArray[np.int64]
    true_means: NDArray[np.int64]
    child_importance: NDArray[np.float32]
    child_near: NDArray[np.int32]
    state_means: NDArray[np.int64]
    state_near: NDArray[np.int32]


def _around() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return, per child, the 8 nodes about it, their trilinear weights, and the squared lengths of the 27 offsets."""
    places = np.zeros((8, 8), dtype=np.int64)
    weights = np.zeros(8, dtype=np.int64)
    for octant in range(8):
        for k in range(8):
            side = [(2 * (octant >> a & 1) - 1) * (k >> a & 1) + 1 for a in range(3)]
            places[octant, k] = side[0] + 3 * side[1] + 9 * side[2]
            weights[k] = 3 ** (3 - bin(k).count("1"))
    squares = np.array([sum((d // 3**a % 3 - 1) ** 2 for a in range(3)) for d in range(27)], dtype=np.int64)
    return places, weights, squares


AROUND, TRILINEAR, SQUARED_DISTANCE = _around()
"""See `_around`."""
NEAR_WEIGHT = np.array([96, 14, 4, 1], dtype=np.int64)
"""Weights of means at the same place, in face, edge and corner contact."""


@kernel
def rounded_ratio(a: int, b: int) -> int:
    """Return a / b for b > 0, rounded to the nearest integer, halves up."""
    return (2 * a + b) // (2 * b)


@kernel
def integer_root(value: int) -> int:
    """Return the integer part of a square root; value < 2^62."""
    root = np.int64(np.sqrt(np.float64(value)))
    while root * root > value:
        root -= 1
    while (root + 1) * (root + 1) <= value:
        root += 1
    return root


@kernel
def to_luma_chroma(colors: NDArray[np.int16], values: NDArray[np.int64]) -> None:
    """Write Y, Co, Cg (n, 3) of RGB (n, 3), in units of 2^-FRACTION_BITS gray levels."""
    for i in range(len(colors)):
        r, g, b = np.int64(colors[i, 0]), np.int64(colors[i, 1]), np.int64(colors[i, 2])
        values[i, 0] = (r + 2 * g + b) << (FRACTION_BITS - 2)
        values[i, 1] = (r - b) << (FRACTION_BITS - 1)
        values[i, 2] = (2 * g - r - b) << (FRACTION_BITS - 2)


@kernel
def from_luma_chroma(values: NDArray[np.int64], colors: NDArray[np.int16]) -> None:
    """Write RGB (n, 3) of Y, Co, Cg (n, 3), rounded and clamped to -256..511."""
    half = 1 << (FRACTION_BITS - 1)
    for i in range(len(values)):
        y, co, cg = values[i, 0], values[i, 1], values[i, 2]
        colors[i, 0] = min(max((y + co - cg + half) >> FRACTION_BITS, MIN_COLOR), MAX_COLOR)
        colors[i, 1] = min(max((y + cg + half) >> FRACTION_BITS, MIN_COLOR), MAX_COLOR)
        colors[i, 2] = min(max((y - co - cg + half) >> FRACTION_BITS, MIN_COLOR), MAX_COLOR)


@kernel
def sum_children(
    masks: NDArray[np.uint8],
    child_sums: NDArray[np.int64],
    child_weights: NDArray[np.int64],
    sums: NDArray[np.int64],
    weights: NDArray[np.int64],
) -> None:
    """Add up colors (n, 3) and weights (n,) of the children of every node."""
    child = 0
    sums.fill(0)
    weights.fill(0)
    for i in range(len(masks)):
        for _ in range(BIT_COUNTS[masks[i]]):
            for channel in range(sums.shape[1]):
                sums[i, channel] += child_sums[child, channel]
            weights[i] += child_weights[child]
            child += 1


@kernel
def step_of_pair(step: int, a: int, b: int) -> int:
    """Return the quantizer step of the difference of a pair of weights a and b; `step` < 2^18."""
    return max(np.int64(1), integer_root(step * step * (a + b) // (a * b)))


@kernel
def merge_pairs(
    means: NDArray[np.int64], weights: NDArray[np.int64], left: NDArray[np.int64], right: NDArray[np.int64]
) -> None:
    """Replace the means (8, channels) of the children by differences in places 1..7 and the mean in place 0.

    `left` and `right` (8,) receive the weights of the pair whose difference stands at a place; there is a difference
    where both are positive. `weights` (8,), zero for absent children, is used up.
    """
    for axis in range(3):
        reach = 1 << axis
        for a in range(0, 8, 2 * reach):
            b = a + reach
            left[b], right[b] = weights[a], weights[b]
            total = left[b] + right[b]
            if total == 0:
                continue
            for channel in range(means.shape[1]):
                difference = means[b, channel] - means[a, channel]
                mean = rounded_ratio(means[a, channel] * left[b] + means[b, channel] * right[b], total)
                means[a, channel] = mean
                means[b, channel] = difference
            weights[a] = total


@kernel
def merge_importance(importance: NDArray[np.float64], left: NDArray[np.int64], right: NDArray[np.int64]) -> None:
    """Turn how much errors of the children (8,) count into how much those of the differences of `merge_pairs` count.

    An error of a difference is shared by the pair in inverse proportion to their weights.
    """
    for axis in range(3):
        reach = 1 << axis
        for a in range(0, 8, 2 * reach):
            b = a + reach
            total = left[b] + right[b]
            if total == 0:
                continue
            first, second = importance[a], importance[b]
            importance[a] = (left[b] * first + right[b] * second) / total
            importance[b] = (right[b] * first + left[b] * second) / total


@kernel
def split_pairs(means: NDArray[np.int64], left: NDArray[np.int64], right: NDArray[np.int64]) -> None:
    """Turn the mean in place 0 and the differences in places 1..7 back into means (8, channels); see `merge_pairs`."""
    for axis in range(2, -1, -1):
        reach = 1 << axis
        for a in range(0, 8, 2 * reach):
            b = a + reach
            total = left[b] + right[b]
            if total == 0:
                continue
            for channel in range(means.shape[1]):
                if left[b] == 0 or right[b] == 0:
                    means[b, channel] = means[a, channel]
                    continue
                lower = means[a, channel] - rounded_ratio(means[b, channel] * right[b], total)
                means[a, channel] = lower
                means[b, channel] += lower


@kernel
def load_children(
    level: ColorLevel,
    node: int,
    given: NDArray[np.int64],
    weights: NDArray[np.int64],
    importance: NDArray[np.float64],
) -> None:
    """Write the true means of a node's children behind the predicted ones in `given` (8, 2 * channels), and weights.

    `weights` and `importance` (8,) are zero for absent children.
    """
    channels = level.means.shape[1]
    row = level.first[node]
    for octant in range(8):
        weights[octant] = 0
        importance[octant] = 0.0
        if level.masks[node] >> octant & 1:
            weights[octant] = level.child_weights[row]
            importance[octant] = level.child_importance[row]
            for channel in range(channels):
                given[octant, channels + channel] = level.true_means[row, channel]
            row += 1


@kernel
def store_children(level: ColorLevel, node: int, values: NDArray[np.int64]) -> None:
    """Write the reconstructed means of a node's children, clamped to what a color can be."""
    row = level.first[node]
    for octant in range(8):
        if level.masks[node] >> octant & 1:
            for channel in range(values.shape[1]):
                level.child_means[row, channel] = min(max(values[octant, channel], -MAX_VALUE), MAX_VALUE)
            row += 1


@kernel
def predict_child(level: ColorLevel, node: int, octant: int, child: int, predicted: NDArray[np.int64]) -> None:
    """Predict row `octant` of `predicted` (8, 2 * channels), the mean of a child, from the known means around it.

    Known are the level of its parent, the children of earlier nodes, and the child's own level in
    the state before the update.
    """
    total = np.int64(0)
    channels = level.means.shape[1]
    for channel in range(channels):
        predicted[octant, channel] = 0
    for k in range(8):
        other = level.near[node, AROUND[octant, k]]
        if other >= 0:
            total += TRILINEAR[k]
            for channel in range(channels):
                predicted[octant, channel] += TRILINEAR[k] * level.means[other, channel]
    for d in range(27):
        weight = NEAR_WEIGHT[SQUARED_DISTANCE[d]]
        other = level.child_near[child, d]
        if 0 <= other < level.first[node]:
            total += weight
            for channel in range(channels):
                predicted[octant, channel] += weight * level.child_means[other, channel]
        other = level.state_near[child, d]
        if other >= 0:
            total += weight
            for channel in range(channels):
                predicted[octant, channel] += weight * level.state_means[other, channel]
    for channel in range(channels):
        predicted[octant, channel] = rounded_ratio(predicted[octant, channel], total)
