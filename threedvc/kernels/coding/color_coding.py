# SPDX-License-Identifier: MIT
"""Quantization and entropy coding of the transformed colors of one level, compiled.

The same traversal writes and reads. When it writes, it also chooses every quantized value so that
squared error plus a price on bits is smallest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.coding.color_transform import (
    MAX_VALUE,
    ColorLevel,
    load_children,
    merge_importance,
    merge_pairs,
    predict_child,
    split_pairs,
    step_of_pair,
    store_children,
)
from threedvc.kernels.coding.mixing import UNIT_INPUT, Mixer, code_mixed_bit, hash_pair, mixed_log_odds, squash
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS, READING, Coder, code_adaptive_bit, code_number, overrun

__all__ = ["COLOR_MODELS", "COLOR_SETS", "COLOR_WEIGHT_ROWS", "SIGN_COUNTERS", "Quantizer", "code_colors"]

COLOR_MODELS = 7
"""Contexts of `set_contexts`. All numbers here but the last are part of the format (docs/coding.md)."""
COLOR_SETS = 2
"""Selectors of weights of `set_contexts`."""
COLOR_WEIGHT_ROWS = 128
"""More rows than any selector has values: 24 of channel and magnitude, 64 of height and energy."""
ESCAPE_MAGNITUDE = 6
"""Magnitudes from this on are coded as numbers: they are rare."""
DAMPING = 236
"""Part, of 256, of a predicted difference that is taken: a guess with noise in it is best taken smaller."""
SIGN_COUNTERS = 3 * 3 * 4 * 9
"""By channel, sign of the guess, its size, and signs of luma and Co, see `code_sign`."""
CODING_ORDER = (4, 2, 6, 1, 3, 5, 7)
"""Places of differences: those between the largest parts of a node come first."""
MAX_ENERGY = 1000
"""What the magnitudes of a node count for at most: enough to tell apart what contexts do."""
MAX_QUANTIZED = 1 << 22
"""No lawful color needs more steps of the least size."""
NUMBER_LIMIT = 255
"""Bits that a counter remembers, as everywhere."""
MIN_IMPORTANCE = 1e-5
"""What an error counts for at least, so that a writer's price stays finite."""


class Quantizer(NamedTuple):
    """How coefficients are quantized and coded.

    Attributes
    ----------
    steps
        (channels,) int64 steps of the orthonormal transform, in units of 2^-FRACTION_BITS gray levels.
    price
        The writer's price of a bit, in units of step^2 / 256.
    counters
        (channels * NUMBER_COUNTERS,) uint32 for large magnitudes.
    signs
        (SIGN_COUNTERS,) uint32.
    """

    steps: NDArray[np.int64]
    price: int
    counters: NDArray[np.uint32]
    signs: NDArray[np.uint32]


class Block(NamedTuple):
    """The children of one node, and then its mean (place 0) and the differences of `merge_pairs` (places 1..7).

    Attributes
    ----------
    given
        (8, 2 * channels) int64: predicted, then true; of no meaning to a reader in the second half.
    decoded, quantized
        (8, channels) int64.
    weights, left, right
        (8,) int64, see `merge_pairs`.
    importance
        (8,) float64, see `merge_importance`; of no meaning to a reader.
    """

    given: NDArray[np.int64]
    decoded: NDArray[np.int64]
    quantized: NDArray[np.int64]
    weights: NDArray[np.int64]
    left: NDArray[np.int64]
    right: NDArray[np.int64]
    importance: NDArray[np.float64]


@kernel
def bit_length(value: int) -> int:
    """Return the number of bits of a number without leading zeros."""
    length = np.int64(0)
    while value > 0:
        value >>= 1
        length += 1
    return length


@kernel
def energy_around(level: ColorLevel, node: int, channel: int) -> int:
    """Sum the magnitudes coded at the parent (twice) and at earlier neighbors of a node."""
    total = 2 * np.int64(level.parent_energy[level.parents[node], channel])
    for d in range(27):
        other = level.near[node, d]
        if 0 <= other < node:
            total += level.energy[other, channel]
    return total


@kernel
def set_contexts(
    mixer: Mixer, block: Block, place: int, channel: int, height: int, around: int, slope: int, prefix: int
) -> None:
    """Set the contexts of the decision whether a magnitude goes beyond `prefix`."""
    inside = np.int64(0)
    for other in range(1, 8):
        inside += abs(block.quantized[other, channel])
    inside = min(inside, 3)
    luma = min(abs(block.quantized[place, 0]), 3) if channel > 0 else np.int64(0)
    chroma = min(abs(block.quantized[place, 1]), 3) if channel > 1 else np.int64(0)
    a, b = block.left[place], block.right[place]
    size = min(bit_length(a * b // (a + b)), 15)
    skew = min(bit_length(max(a, b) // min(a, b)), 7)
    wide = bit_length(around)
    what = channel * 8 + prefix
    kind = hash_pair(what, bit_length(place))
    contexts = mixer.contexts
    contexts[0] = hash_pair(kind, height)
    contexts[1] = hash_pair(kind, min(around, 12))
    contexts[2] = hash_pair(kind, inside * 16 + luma * 4 + chroma)
    contexts[3] = hash_pair(hash_pair(kind, size * 8 + skew), height)
    contexts[4] = hash_pair(kind, slope)
    contexts[5] = hash_pair(what, wide * 64 + inside * 16 + luma * 4 + chroma)
    contexts[6] = hash_pair(what, (min(slope, 7) * 16 + wide) * 8 + min(height, 7))
    mixer.selectors[0] = what
    mixer.selectors[1] = min(height, 7) * 8 + min(wide, 7)


@kernel
def choose_quantized(residual: int, step: int, log_odds: int, price: float) -> int:
    """Return the quantized value of least squared error plus price times estimated bits.

    `log_odds` are those of a value other than zero.
    """
    ratio = np.float64(abs(residual)) / np.float64(step)
    nearest = np.int64(np.floor(ratio + 0.5))
    if nearest == 0:
        return np.int64(0)
    odds = squash(log_odds) / 65536.0
    per_bit = price / 256.0
    best = np.int64(0)
    least = ratio * ratio - per_bit * np.log2(1 - odds)
    for m in range(max(1, nearest - 1), nearest + 1):
        # A rough guess for what is coded with contexts of its own: small magnitudes in unary, large ones as numbers.
        bits = 1 - np.log2(odds) + min(1.5 * (m - 1), 2 + 2 * np.log2(float(m)))
        cost = (ratio - m) * (ratio - m) + per_bit * bits
        if cost < least:
            least = cost
            best = np.int64(m)
    return -best if residual < 0 else best


@kernel
def sign_class(value: int) -> int:
    """Return 0 for zero, 1 for positive, 2 for negative numbers."""
    if value == 0:
        return 0
    return 1 if value > 0 else 2


@kernel
def code_sign(
    coder: Coder, quantizer: Quantizer, block: Block, place: int, channel: int, value: int, guess: int, slope: int
) -> int:
    """Code whether a coefficient is negative, given the signs of its prediction and of the channels before."""
    luma = sign_class(block.quantized[place, 0]) if channel > 0 else 0
    chroma = sign_class(block.quantized[place, 1]) if channel > 1 else 0
    context = ((channel * 3 + sign_class(guess)) * 4 + min(slope, 3)) * 9 + luma * 3 + chroma
    return code_adaptive_bit(coder, 1 if value < 0 else 0, quantizer.signs, context, NUMBER_LIMIT)


@kernel
def code_coefficient(
    coder: Coder,
    mixer: Mixer,
    quantizer: Quantizer,
    level: ColorLevel,
    node: int,
    height: int,
    block: Block,
    place: int,
    channel: int,
) -> None:
    """Code one difference of a block: set its quantized and its decoded value."""
    channels = level.means.shape[1]
    step = step_of_pair(quantizer.steps[channel], block.left[place], block.right[place])
    guess = block.given[place, channel] * DAMPING >> 8
    slope = min(4 * abs(guess) // step, 15)
    around = energy_around(level, node, channel)
    value = np.int64(0)
    magnitude = np.int64(0)
    while magnitude < ESCAPE_MAGNITUDE:
        set_contexts(mixer, block, place, channel, height, around, slope, magnitude)
        log_odds = mixed_log_odds(mixer)
        if magnitude == 0 and coder.state[READING] == 0:
            price = quantizer.price / max(block.importance[place], MIN_IMPORTANCE)
            value = choose_quantized(block.given[place, channels + channel] - guess, step, log_odds, price)
        if code_mixed_bit(coder, 1 if abs(value) > magnitude else 0, mixer, log_odds) == 0:
            break
        magnitude += 1
    if magnitude == ESCAPE_MAGNITUDE:
        rest = code_number(coder, abs(value) - magnitude, quantizer.counters, channel * NUMBER_COUNTERS, NUMBER_LIMIT)
        magnitude += min(rest, MAX_QUANTIZED)
    if magnitude > 0 and code_sign(coder, quantizer, block, place, channel, value, guess, slope):
        magnitude = -magnitude
    block.quantized[place, channel] = magnitude
    block.decoded[place, channel] = min(max(guess + magnitude * step, -2 * MAX_VALUE), 2 * MAX_VALUE)


@kernel
def open_block(level: ColorLevel, node: int, block: Block) -> None:
    """Predict the children of a node and pair them."""
    child = level.first[node]
    for octant in range(8):
        if level.masks[node] >> octant & 1:
            predict_child(level, node, octant, child, block.given)
            child += 1
    load_children(level, node, block.given, block.weights, block.importance)
    merge_pairs(block.given, block.weights, block.left, block.right)
    merge_importance(block.importance, block.left, block.right)
    block.quantized.fill(0)
    for channel in range(level.means.shape[1]):
        block.decoded[0, channel] = level.means[node, channel]


@kernel
def close_block(level: ColorLevel, node: int, block: Block) -> None:
    """Turn decoded differences into the means of the children, and note the energy of the node."""
    for channel in range(level.means.shape[1]):
        total = np.int64(0)
        for place in range(1, 8):
            total += abs(block.quantized[place, channel])
        level.energy[node, channel] = min(total, MAX_ENERGY)
    split_pairs(block.decoded, block.left, block.right)
    store_children(level, node, block.decoded)


@kernel
def code_colors(coder: Coder, mixer: Mixer, quantizer: Quantizer, level: ColorLevel, height: int) -> bool:
    """Code the colors of the children of one level; return False if the data end too early.

    `height` is 0 where the children are cells, 1 for the level above, and so on.
    """
    channels = level.means.shape[1]
    block = Block(
        np.zeros((8, 2 * channels), np.int64),
        np.zeros((8, channels), np.int64),
        np.zeros((8, channels), np.int64),
        np.zeros(8, np.int64),
        np.zeros(8, np.int64),
        np.zeros(8, np.int64),
        np.zeros(8, np.float64),
    )
    mixer.inputs[COLOR_MODELS] = UNIT_INPUT
    for i in range(len(level.masks)):
        if overrun(coder):
            return False
        mask = np.int64(level.masks[i])
        if mask & (mask - 1) == 0:
            for channel in range(channels):
                level.child_means[level.first[i], channel] = level.means[i, channel]
            continue
        open_block(level, i, block)
        for place in CODING_ORDER:
            if block.left[place] > 0 and block.right[place] > 0:
                for channel in range(channels):
                    code_coefficient(coder, mixer, quantizer, level, i, height, block, place, channel)
        close_block(level, i, block)
    return True
