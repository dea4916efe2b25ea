# SPDX-License-Identifier: MIT
"""Logistic mixing of several adaptive contexts into one probability, compiled.

Every context owns a table of counters, addressed by a hash. Their log-odds and further inputs are
summed with weights that learn from every coded bit. Several sets of weights, each selected by
something else, give opinions whose log-odds are averaged. Integers only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.coding.range_coder import Coder, adapt_counter, clamp_probability, code_bit

__all__ = [
    "INPUT_LIMIT",
    "SQUASH_TABLE",
    "STRETCH_TABLE",
    "UNIT_INPUT",
    "Mixer",
    "code_mixed_bit",
    "hash_pair",
    "mixed_log_odds",
    "squash",
    "stretch",
]

INPUT_LIMIT = 2047
"""Largest log-odds, in 1/256: eight nats, beyond which probabilities of 16 bits hardly change. As the next four, it is
part of the format (docs/coding.md)."""
COUNTER_LIMIT = 255
"""Bits that a counter remembers: each of the last few hundred counts the same."""
LEARNING_RATE, LEARNING_SHIFT = 12, 18
"""Rate at which weights learn, a numerator and a shift: the weight of the constant input moves by 0.012 at most."""
UNIT_INPUT = 256
"""The constant input: log-odds of 1."""


class Mixer(NamedTuple):
    """Models of one kind of binary decision.

    Attributes
    ----------
    contexts
        (models,) int64: hashes of the decision at hand, set by the caller, overwritten.
    selectors
        (sets,) int64: weight rows of the decision at hand, set by the caller.
    tables
        (models, 2^k) uint32 counters.
    weights
        (sets, rows, inputs) int32 in units of 1 / 65536.
    inputs
        (inputs,) int64: log-odds of the models, then the further inputs, set by the caller.
    opinions
        (sets,) int64: log-odds of every weight set.
    """

    contexts: NDArray[np.int64]
    selectors: NDArray[np.int64]
    tables: NDArray[np.uint32]
    weights: NDArray[np.int32]
    inputs: NDArray[np.int64]
    opinions: NDArray[np.int64]


def _stretch_table() -> NDArray[np.int32]:
    """Return 256 ln(p / (1 - p)) at the middles of 4096 equal steps of p, rounded."""
    p = (np.arange(4096) + 0.5) / 4096
    return np.clip(np.rint(256 * np.log(p / (1 - p))), -INPUT_LIMIT, INPUT_LIMIT).astype(np.int32)


def _squash_table() -> NDArray[np.int32]:
    """Return 65536 / (1 + exp(-x / 256)) for x = -2047..2047, rounded."""
    x = np.arange(-INPUT_LIMIT, INPUT_LIMIT + 1)
    return np.rint(65536 / (1 + np.exp(-x / 256))).astype(np.int32)


STRETCH_TABLE = _stretch_table()
SQUASH_TABLE = _squash_table()


@kernel
def stretch(probability: int) -> int:
    """Return 256 times the log-odds of a probability (of 65536)."""
    return np.int64(STRETCH_TABLE[probability >> 4])


@kernel
def squash(log_odds: int) -> int:
    """Return the probability (of 65536) that belongs to log-odds (times 256)."""
    return np.int64(SQUASH_TABLE[min(max(log_odds, -INPUT_LIMIT), INPUT_LIMIT) + INPUT_LIMIT])


@kernel
def hash_pair(a: int, b: int) -> int:
    """Combine two numbers into one of 47 bits."""
    return ((a * np.int64(0x2545F491) + b) * np.int64(0x9E3779B1)) & 0x7FFFFFFFFFFF


@kernel
def mixed_log_odds(mixer: Mixer) -> int:
    """Look up the contexts, form the opinions of all weight sets and return their mean."""
    models, size = mixer.tables.shape
    for k in range(models):
        mixer.contexts[k] = (mixer.contexts[k] >> 8) & (size - 1)
        counter = np.int64(mixer.tables[k, mixer.contexts[k]])
        mixer.inputs[k] = stretch(counter >> 16) if counter & 1023 else np.int64(0)
    total = np.int64(0)
    for s in range(len(mixer.selectors)):
        opinion = np.int64(0)
        for k in range(len(mixer.inputs)):
            opinion += mixer.inputs[k] * mixer.weights[s, mixer.selectors[s], k]
        mixer.opinions[s] = opinion >> 16
        total += mixer.opinions[s]
    return total // len(mixer.selectors)


@kernel
def learn(mixer: Mixer, bit: int) -> None:
    """Adapt weights and counters to a coded bit."""
    for s in range(len(mixer.selectors)):
        error = (65535 * bit - squash(mixer.opinions[s])) * LEARNING_RATE
        row = mixer.weights[s, mixer.selectors[s]]
        for k in range(len(mixer.inputs)):
            row[k] += (mixer.inputs[k] * error + (1 << (LEARNING_SHIFT - 1))) >> LEARNING_SHIFT
    for k in range(len(mixer.tables)):
        adapt_counter(mixer.tables[k], mixer.contexts[k], bit, COUNTER_LIMIT)


@kernel
def code_mixed_bit(coder: Coder, bit: int, mixer: Mixer, log_odds: int) -> int:
    """Code a bit whose `mixed_log_odds` have just been found, and learn from it."""
    bit = code_bit(coder, bit, clamp_probability(squash(log_odds)))
    learn(mixer, bit)
    return bit
