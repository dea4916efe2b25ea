# SPDX-License-Identifier: MIT
"""A small fixed network that guesses whether a cell is there from all that is known around it, compiled.

Adaptive contexts know nothing when an update begins. The network supplies what surfaces have in
common: it was trained on random synthetic surfaces (benchmarks/train_geometry_prior.py). One hidden
layer, inputs zero or one, integers only.

Inputs are the active ones of `FEATURES`: occupied places of the 4 x 4 x 4 about a node's children;
nodes around the node, at distance up to two (at two only where one leads there); those of the nearest
27 whose children are not coded yet; places and nodes of the other tree. Everything is mirrored so
that the child lies towards positive x, y and z.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel

__all__ = [
    "FEATURES",
    "HEIGHTS",
    "HIDDEN",
    "PATCH_CHILD",
    "PATCH_OFFSET",
    "PRIOR_SCALE",
    "Prior",
    "Surroundings",
    "child_row",
    "list_features",
    "prior_log_odds",
]

OWN_PLACES = 0
NODES = OWN_PLACES + 4**3
UNCODED = NODES + 5**3
SIDE_PLACES = UNCODED + 3**3
SIDE_NODES = SIDE_PLACES + 4**3
FEATURES = SIDE_NODES + 3**3
"""First inputs of each kind, see above, and their number. All numbers here are part of the format (docs/coding.md): the
network was trained with them."""
HEIGHTS = 4
"""Heights with biases of their own; all levels from the last on share them."""
HIDDEN = 24
"""Hidden units."""
PRIOR_SCALE = 64
"""What stands for 1 in weights, which are signed bytes, so within +-2."""
OUTPUT_SHIFT = 4
"""From units of the square of `PRIOR_SCALE`, which is 4096, to the 256 of log-odds."""
OUTPUT_LIMIT = 2047
"""As of all inputs of a mixer."""
CENTER = 13
"""Number of the offset (0, 0, 0)."""


class Surroundings(NamedTuple):
    """What is known about the nodes of a level before their masks are coded.

    Attributes
    ----------
    near
        (n, 27) int32 indices of the nodes around each node, -1 where there is none.
    parent_masks, octants
        (n,) uint8: mask of each node's parent, and the node's number in it.
    allowed
        (n,) uint8: children that may be there.
    side_masks
        (m,) uint8 masks of the same level of the other tree.
    side_near
        (n, 27) int32 indices into `side_masks`.
    """

    near: NDArray[np.int32]
    parent_masks: NDArray[np.uint8]
    octants: NDArray[np.uint8]
    allowed: NDArray[np.uint8]
    side_masks: NDArray[np.uint8]
    side_near: NDArray[np.int32]


class Prior(NamedTuple):
    """Weights of the network, in units of 1 / PRIOR_SCALE; the output bias in those of its square.

    Attributes
    ----------
    inputs
        (FEATURES, HIDDEN) int32 weights of the inputs.
    biases
        (HEIGHTS * 8, HIDDEN) int32 biases by height and child number.
    outputs
        (HIDDEN,) int32 weights of the hidden units.
    output_bias
        Constant.
    """

    inputs: NDArray[np.int32]
    biases: NDArray[np.int32]
    outputs: NDArray[np.int32]
    output_bias: int


def _patch_tables() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return node offset and child number of the 4 x 4 x 4 places about a node's children, and their own places."""
    places = [(p & 3, p >> 2 & 3, p >> 4) for p in range(64)]
    offsets = [sum((v + 1) // 2 * 3**a for a, v in enumerate(place)) for place in places]
    children = [sum(((v + 1) & 1) << a for a, v in enumerate(place)) for place in places]
    inner = [sum((1 + (o >> a & 1)) * 4**a for a in range(3)) for o in range(8)]
    return np.array(offsets), np.array(children), np.array(inner)


def _grid_mirror(side: int) -> NDArray[np.int64]:
    """Return, per child, where the places of a cubic grid go when the child is mirrored towards positive axes."""
    mirror = np.zeros((8, side**3), dtype=np.int64)
    for octant in range(8):
        for p in range(side**3):
            place = [p // side**a % side for a in range(3)]
            mirror[octant, p] = sum((v if octant >> a & 1 else side - 1 - v) * side**a for a, v in enumerate(place))
    return mirror


def _wide_tables() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return, for the 5 x 5 x 5 nodes about a node, two steps within 3 x 3 x 3 that lead there."""
    places = [[p // 5**a % 5 - 2 for a in range(3)] for p in range(125)]
    steps = [[max(-1, min(1, v)) for v in place] for place in places]
    rests = [[v - s for v, s in zip(place, step, strict=True)] for place, step in zip(places, steps, strict=True)]
    first, second = ([sum((s + 1) * 3**a for a, s in enumerate(step)) for step in part] for part in (steps, rests))
    return np.array(first), np.array(second)


def _mirror_features() -> NDArray[np.int64]:
    """Return, per child, the number of every feature after mirroring."""
    parts = ((OWN_PLACES, 4), (NODES, 5), (UNCODED, 3), (SIDE_PLACES, 4), (SIDE_NODES, 3))
    return np.concatenate([start + _grid_mirror(side) for start, side in parts], axis=1)


PATCH_OFFSET, PATCH_CHILD, CHILD_PLACE = _patch_tables()
FIRST_STEP, SECOND_STEP = _wide_tables()
MIRRORED = _mirror_features()


@kernel
def list_features(node: int, masks: NDArray[np.uint8], around: Surroundings, features: NDArray[np.int64]) -> int:
    """List the active features about a node, its own children left out; return their number."""
    count = 0
    for p in range(64):
        other = around.near[node, PATCH_OFFSET[p]]
        if 0 <= other < node and masks[other] >> PATCH_CHILD[p] & 1:
            features[count] = OWN_PLACES + p
            count += 1
        other = around.side_near[node, PATCH_OFFSET[p]]
        if other >= 0 and around.side_masks[other] >> PATCH_CHILD[p] & 1:
            features[count] = SIDE_PLACES + p
            count += 1
    for d in range(27):
        if around.near[node, d] > node:
            features[count] = UNCODED + d
            count += 1
        if around.side_near[node, d] >= 0:
            features[count] = SIDE_NODES + d
            count += 1
    for p in range(125):
        other = around.near[node, FIRST_STEP[p]]
        if other >= 0 and around.near[other, SECOND_STEP[p]] >= 0:
            features[count] = NODES + p
            count += 1
    return count


@kernel
def child_row(height: int, child: int) -> int:
    """Return the row of the biases for a child."""
    return min(height, HEIGHTS - 1) * 8 + child


@kernel
def prior_log_odds(
    prior: Prior,
    height: int,
    child: int,
    siblings: int,
    features: NDArray[np.int64],
    count: int,
    hidden: NDArray[np.int32],
) -> int:
    """Return 256 times the log-odds that a child is there; `siblings` is the mask of the children before it."""
    bias = child_row(height, child)
    for u in range(HIDDEN):
        hidden[u] = prior.biases[bias, u]
    for k in range(count):
        row = MIRRORED[child, features[k]]
        for u in range(HIDDEN):
            hidden[u] += prior.inputs[row, u]
    for sibling in range(child):
        if siblings >> sibling & 1:
            row = MIRRORED[child, OWN_PLACES + CHILD_PLACE[sibling]]
            for u in range(HIDDEN):
                hidden[u] += prior.inputs[row, u]
    total = np.int64(prior.output_bias)
    for u in range(HIDDEN):
        total += max(hidden[u], 0) * prior.outputs[u]
    return min(max(total >> OUTPUT_SHIFT, -OUTPUT_LIMIT), OUTPUT_LIMIT)
