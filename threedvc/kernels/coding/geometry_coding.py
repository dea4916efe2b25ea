# SPDX-License-Identifier: MIT
"""Entropy coding of the child masks of one octree level, compiled.

Contexts see the places around a child within its parent's 2 x 2 x 2 neighborhood: children coded
before it, parents (all known), and the same places of another tree that both sides know.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.coding.geometry_prior import (
    CHILD_PLACE,
    FEATURES,
    PATCH_CHILD,
    PATCH_OFFSET,
    Prior,
    Surroundings,
    list_features,
    prior_log_odds,
)
from threedvc.kernels.coding.mixing import UNIT_INPUT, Mixer, code_mixed_bit, hash_pair, mixed_log_odds
from threedvc.kernels.coding.octree import BIT_COUNTS
from threedvc.kernels.coding.range_coder import Coder, overrun

__all__ = ["GEOMETRY_MODELS", "GEOMETRY_SETS", "GEOMETRY_WEIGHT_ROWS", "code_masks"]

GEOMETRY_MODELS = 9
"""Contexts of `set_contexts`. All numbers here are part of the format (docs/coding.md)."""
GEOMETRY_SETS = 3
"""Selectors of weights of `set_contexts`."""
GEOMETRY_WEIGHT_ROWS = 128
"""More rows than any selector has values: 32 of height and child, 84 of the places around, 28 of nodes."""
MAX_HEIGHT = 3
"""Height from which on levels share their contexts: the upper levels have few nodes to learn from."""
EMPTY, UNKNOWN = 0, 2
"""States of a place, besides 1: there."""
STATE_UNIT = np.array([0, 1, 32])
"""What a place of each state adds to a count of both: at most 27 are occupied."""


def _sided_offsets() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return, per child, the 7 offsets of nodes that touch it (faces, edges, corner) and the 7 opposite ones."""
    touching = np.zeros((8, 7), dtype=np.int64)
    opposite = np.zeros((8, 7), dtype=np.int64)
    for octant in range(8):
        for k, axes in enumerate((1, 2, 4, 3, 5, 6, 7)):
            side = [(2 * (octant >> a & 1) - 1) * (axes >> a & 1) for a in range(3)]
            touching[octant, k] = sum((s + 1) * 3**a for a, s in enumerate(side))
            opposite[octant, k] = sum((1 - s) * 3**a for a, s in enumerate(side))
    return touching, opposite


# Offsets of the 27 places around and at a place: what each adds to its number of 64; those that touch a child, and all;
# places that share a face, an edge, a corner with it.
PLACE_SHIFT = np.array([sum((d // 3**a % 3 - 1) * 4**a for a in range(3)) for d in range(27)])
TOUCHING, OPPOSITE = _sided_offsets()
PLACES = np.arange(27)
FACES = np.array([4, 10, 12, 14, 16, 22])
EDGES = np.array([1, 3, 5, 7, 9, 11, 15, 17, 19, 21, 23, 25])
CORNERS = np.array([0, 2, 6, 8, 18, 20, 24, 26])
"""Offsets that docs/coding.md names."""


@kernel
def gather_patch(
    node: int, masks: NDArray[np.uint8], around: Surroundings, patch: NDArray[np.int64], side: NDArray[np.int64]
) -> None:
    """Write what is known of the 4 x 4 x 4 places about a node's children, in this and in the other tree."""
    for p in range(64):
        other = around.near[node, PATCH_OFFSET[p]]
        patch[p] = EMPTY
        if 0 <= other < node:
            patch[p] = np.int64(masks[other]) >> PATCH_CHILD[p] & 1
        elif other >= 0:
            patch[p] = UNKNOWN
        other = around.side_near[node, PATCH_OFFSET[p]]
        side[p] = np.int64(around.side_masks[other]) >> PATCH_CHILD[p] & 1 if other >= 0 else 0


@kernel
def ternary(patch: NDArray[np.int64], place: int, offsets: NDArray[np.int64]) -> int:
    """Return the states of the given places around a place as one number."""
    value = np.int64(0)
    for d in offsets:
        value = 3 * value + patch[place + PLACE_SHIFT[d]]
    return value


@kernel
def count_states(patch: NDArray[np.int64], place: int) -> int:
    """Count, among the 27 places around and at a place, the occupied ones plus 32 times the unknown ones."""
    count = np.int64(0)
    for d in range(27):
        count += STATE_UNIT[patch[place + PLACE_SHIFT[d]]]
    return count


@kernel
def presence(near: NDArray[np.int32], offsets: NDArray[np.int64]) -> int:
    """Return as bits which of the given places around a node hold a node."""
    bits = np.int64(0)
    for d in offsets:
        bits = bits << 1 | (1 if near[d] >= 0 else 0)
    return bits


@kernel
def sum_of_bits(value: int) -> int:
    """Count the ones among the lowest 32 bits."""
    count = np.int64(0)
    for shift in range(0, 32, 8):
        count += BIT_COUNTS[value >> shift & 255]
    return count


@kernel
def set_contexts(
    mixer: Mixer,
    around: Surroundings,
    node: int,
    nodes: int,
    child: int,
    height: int,
    coded: int,
    prior: int,
    patch: NDArray[np.int64],
    side: NDArray[np.int64],
) -> None:
    """Set the contexts of the decision whether a child is there.

    `nodes` tells as bits which nodes are around its parent, `coded` the children before it behind a 1.
    """
    place = CHILD_PLACE[child]
    faces = ternary(patch, place, FACES)
    edges = ternary(patch, place, EDGES)
    counts = count_states(patch, place)
    occupied, unknown = counts & 31, counts >> 5
    beside = min(count_states(side, place), 7) * 2 + side[place]
    touching = presence(around.near[node], TOUCHING[child]) << 7 | presence(around.near[node], OPPOSITE[child])
    where = height * 8 + child
    contexts = mixer.contexts
    contexts[0] = hash_pair(height, coded)
    contexts[1] = hash_pair(where, faces)
    contexts[2] = hash_pair(hash_pair(height, faces), edges)
    contexts[3] = hash_pair(where, touching)
    contexts[4] = hash_pair(hash_pair(height, nodes), coded)
    contexts[5] = hash_pair(where, np.int64(around.parent_masks[node]) * 8 + around.octants[node])
    contexts[6] = hash_pair(hash_pair(edges, ternary(patch, place, CORNERS)), faces)
    contexts[7] = hash_pair(coded, (prior + 2048) >> 8)
    contexts[8] = hash_pair(hash_pair(height, ternary(side, place, FACES)), beside * 32 + occupied)
    mixer.selectors[0] = where
    mixer.selectors[1] = occupied * 3 + min(unknown, 8) // 3
    mixer.selectors[2] = sum_of_bits(nodes)


@kernel
def code_masks(
    coder: Coder, mixer: Mixer, prior: Prior, height: int, masks: NDArray[np.uint8], around: Surroundings
) -> bool:
    """Code the child masks of one level; return False if the data end too early or contradict `allowed`.

    `height` is 0 where the children are cells, 1 for the level above, and so on.
    """
    patch = np.zeros(64, np.int64)
    side = np.zeros(64, np.int64)
    features = np.zeros(FEATURES, np.int64)
    hidden = np.zeros(len(prior.outputs), np.int32)
    height = min(height, MAX_HEIGHT)
    mixer.inputs[GEOMETRY_MODELS] = UNIT_INPUT
    for i in range(len(masks)):
        allowed = np.int64(around.allowed[i])
        if allowed == 0 or overrun(coder):
            return False
        gather_patch(i, masks, around, patch, side)
        nodes = presence(around.near[i], PLACES)
        active = list_features(i, masks, around, features)
        mask = np.int64(0)
        coded = np.int64(1)
        for child in range(8):
            bit = np.int64(0)
            if allowed >> child == 1 and mask == 0:
                bit = np.int64(1)
            elif allowed >> child & 1:
                guess = prior_log_odds(prior, height, child, mask, features, active, hidden)
                set_contexts(mixer, around, i, nodes, child, height, coded, guess, patch, side)
                mixer.inputs[GEOMETRY_MODELS + 1] = guess
                bit = code_mixed_bit(coder, np.int64(masks[i]) >> child & 1, mixer, mixed_log_odds(mixer))
            patch[CHILD_PLACE[child]] = bit
            coded = coded << 1 | bit
            mask |= bit << child
        masks[i] = mask
    return True
