# SPDX-License-Identifier: MIT
"""Train the network of threedvc/kernels/coding/geometry_prior.py on random synthetic surfaces.

    python benchmarks/train_geometry_prior.py [--scenes 160] [--steps 6000] > threedvc/coding/entropy/prior_weights.py

Scenes are rooms with boxes, ellipsoids and cylinders, turned at random, with smooth noise on the
distance field, holes, and a half space that was not seen; their one-cell shells are coded whole, or
as the part that follows an earlier part. No recorded sequence is used. About 15 minutes.
"""

from __future__ import annotations

import argparse
import base64
import sys

import numpy as np
from numba import njit
from numpy.typing import NDArray

from threedvc.arrays import Floats
from threedvc.coding.morton import Cube, morton_codes
from threedvc.coding.octree import Octree, TreeWalk
from threedvc.kernels.coding.geometry_prior import (
    CHILD_PLACE,
    FEATURES,
    HEIGHTS,
    HIDDEN,
    MIRRORED,
    PRIOR_SCALE,
    Surroundings,
    child_row,
    list_features,
)

SIDE = 96
"""Cells along a scene: room for some furniture; by hand."""
INPUTS = FEATURES + HEIGHTS * 8
"""Of the network: features, and one for each height of the octree and child."""
BATCH = 2048
"""Nodes of a step of the training."""
RATE = 4e-3
"""Of learning, at the start; it falls to zero."""
WEIGHT_LIMIT = 127
"""Weights are stored as signed bytes."""
LINE = 110
"""Characters of a line of the written module, which fits 120 with its indent."""

MODULE = '''\
# SPDX-License-Identifier: MIT
"""Weights of the geometry prior, written by benchmarks/train_geometry_prior.py.

`WEIGHTS` is the base85 text (RFC 1924 alphabet) of int8 rows of `HIDDEN` numbers: inputs, biases, outputs.
"""

from __future__ import annotations

__all__ = ["OUTPUT_BIAS", "WEIGHTS"]

OUTPUT_BIAS = {output_bias}
WEIGHTS = (
{lines}
)
'''

Rng = np.random.Generator


def random_rotation(rng: Rng) -> NDArray[np.float64]:
    """Return a (3, 3) rotation or reflection, uniform over all."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.asarray(q * np.sign(np.diag(r)))


def value_noise(rng: Rng, period: int) -> Floats:
    """Return smooth noise (SIDE, SIDE, SIDE) of unit variance: random values on a lattice, interpolated."""
    field = rng.normal(size=(SIDE // period + 2,) * 3)
    place = np.arange(SIDE) / period
    low = place.astype(int)
    for axis in range(3):
        share = (place - low).reshape([-1 if a == axis else 1 for a in range(3)])
        field = np.take(field, low, axis) * (1 - share) + np.take(field, low + 1, axis) * share
    return np.asarray(field / field.std(), dtype=np.float32)


def solid_distance(rng: Rng, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of points (n, 3) from a box, an ellipsoid or a cylinder of random size, negative inside."""
    size = rng.uniform(2, 22, 3)
    kind = rng.integers(4)
    if kind == 0:
        return np.asarray((np.linalg.norm(points / size, axis=1) - 1) * size.min())
    if kind == 1:
        return np.asarray(np.maximum(np.hypot(points[:, 0], points[:, 1]) - size[0], np.abs(points[:, 2]) - size[2]))
    beyond = np.abs(points) - size
    return np.asarray(np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0))


def random_distances(rng: Rng) -> Floats:
    """Return the signed distances (SIDE, SIDE, SIDE), in cells, of a random room with furniture."""
    points = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) - SIDE / 2
    axes = random_rotation(rng) if rng.random() < 0.8 else np.eye(3)
    half = rng.uniform(20, 50, 3)
    inside = (points - rng.uniform(-10, 10, 3)) @ axes
    distance = np.min(half - np.abs(inside), axis=1)
    for _ in range(rng.integers(2, 9)):
        turned = random_rotation(rng) if rng.random() < 0.4 else np.eye(3)
        distance = np.minimum(distance, solid_distance(rng, (inside - rng.uniform(-1, 1, 3) * half) @ turned))
    field: Floats = distance.reshape(SIDE, SIDE, SIDE).astype(np.float32)
    roughness = rng.choice([0, 0.15, 0.3, 0.5, 0.8])
    for period in (1, 2, 4, 8):
        field += roughness * rng.uniform(0, 0.7) * value_noise(rng, period)
    return field


def random_shell(rng: Rng) -> NDArray[np.int32]:
    """Return the cells (n, 3) of a one-cell shell: those nearest to, or those just inside, the change of sign."""
    distance = random_distances(rng)
    hidden = value_noise(rng, int(rng.integers(3, 16)))
    seen = hidden > np.quantile(hidden, rng.uniform(0, 0.45))
    slope = np.tensordot(random_rotation(rng)[0], np.indices(seen.shape) - SIDE / 2, axes=1)
    seen &= slope > rng.uniform(-40, 10)
    inner = rng.random() < 0.4
    shell = np.zeros(seen.shape, dtype=bool)
    for axis in range(3):
        a = tuple(slice(0, -1) if k == axis else slice(None) for k in range(3))
        b = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        crossing = ((distance[a] < 0) != (distance[b] < 0)) & seen[a] & seen[b]
        first = distance[a] < 0 if inner else np.abs(distance[a]) < np.abs(distance[b])
        shell[a] |= crossing & first
        shell[b] |= crossing & ~first
    return (np.argwhere(shell & (neighbor_counts(shell) >= 4)) + rng.integers(-300, 300, 3)).astype(np.int32)


def neighbor_counts(shell: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return how many cells are set among the 27 at and around each cell."""
    counts = np.pad(shell, 1).astype(np.int64)
    for axis in range(3):
        counts = sum(np.take(counts, range(k, k + SIDE), axis) for k in range(3))  # type: ignore[assignment]
    return counts


def random_part(rng: Rng, cells: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Divide cells into those known before and those to be coded, in the order in which a camera might see them."""
    if rng.random() < 0.35:
        return cells[:0], cells
    if rng.random() < 0.5:
        order = (cells - cells.mean(axis=0)) @ random_rotation(rng)[0]
    else:
        order = np.linalg.norm(cells - cells[rng.integers(len(cells))], axis=1)
    order = order + rng.choice([0, 1, 4]) * rng.normal(size=len(cells))
    if rng.random() < 0.6:
        block = np.unique(cells >> rng.integers(2, 4), axis=0, return_inverse=True)[1].ravel()
        least = np.full(block.max() + 1, np.inf)
        np.minimum.at(least, block, order)
        order = least[block]
    low, high = np.quantile(order, np.sort(rng.uniform(0.05, 0.98, 2)))
    if rng.random() < 0.5:
        high = np.inf
    return cells[order < low], cells[(order >= low) & (order <= high)]


@njit
def collect(
    height: int, masks: NDArray[np.uint8], around: Surroundings, rows: NDArray[np.uint8], there: NDArray[np.uint8]
) -> int:
    """Write inputs and outcomes of all decisions of a level; return their number."""
    features = np.zeros(FEATURES, np.int64)
    count = 0
    for node in range(len(masks)):
        active = list_features(node, masks, around, features)
        for child in range(8):
            if around.allowed[node] >> child & 1 == 0:
                continue
            for k in range(active):
                rows[count, MIRRORED[child, features[k]]] = 1
            for sibling in range(child):
                if masks[node] >> sibling & 1:
                    rows[count, MIRRORED[child, CHILD_PLACE[sibling]]] = 1
            rows[count, FEATURES + child_row(height, child)] = 1
            there[count] = masks[node] >> child & 1
            count += 1
    return count


def decisions(state: NDArray[np.int32], added: NDArray[np.int32]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return packed inputs and outcomes of coding `added` after `state`."""
    cube = Cube.around(added, state)
    before = Octree(np.sort(morton_codes(state, cube.origin)), cube.depth)
    tree, walk = Octree(np.sort(morton_codes(added, cube.origin)), cube.depth), TreeWalk(before)
    inputs, outcomes = [], []
    for level in tree.levels:
        masks = level.masks
        rows = np.zeros((8 * len(masks), INPUTS), dtype=np.uint8)
        there = np.zeros(len(rows), dtype=np.uint8)
        count = collect(walk.height, masks, walk.surroundings(), rows, there)
        inputs.append(np.packbits(rows[:count], axis=1))
        outcomes.append(there[:count])
        walk.descend(masks)
    return np.concatenate(inputs), np.concatenate(outcomes)


def train(inputs: NDArray[np.uint8], outcomes: NDArray[np.uint8], steps: int, rng: Rng) -> list[Floats]:
    """Return the weights of the network: Adam on the code length, the rate falling to zero."""
    shapes = [(INPUTS, HIDDEN), (HIDDEN, 1), (1, 1)]
    scales = (0.1, 0.2, 0)
    weights = [(rng.normal(size=shape) * scale).astype(np.float32) for shape, scale in zip(shapes, scales, strict=True)]
    first, second = [np.zeros_like(w) for w in weights], [np.zeros_like(w) for w in weights]
    for step in range(steps):
        pick = rng.integers(len(inputs), size=BATCH)
        x = np.unpackbits(inputs[pick], axis=1)[:, :INPUTS].astype(np.float32)
        hidden = np.maximum(x @ weights[0], 0)
        log_odds = hidden @ weights[1] + weights[2]
        error = (1 / (1 + np.exp(-log_odds)) - outcomes[pick, None]) / BATCH
        back = (error @ weights[1].T) * (hidden > 0)
        rate = RATE * (1 - step / steps)
        for k, slope in enumerate((x.T @ back, hidden.T @ error, error.sum(keepdims=True))):
            first[k] += 0.1 * (slope - first[k])
            second[k] += 0.001 * (slope * slope - second[k])
            unbiased = first[k] / (1 - 0.9 ** (step + 1)), second[k] / (1 - 0.999 ** (step + 1))
            weights[k] -= rate * unbiased[0] / (np.sqrt(unbiased[1]) + 1e-8)
        if step % 200 == 0:
            bits = np.logaddexp(0, np.where(outcomes[pick, None], -log_odds, log_odds)).mean() / np.log(2)
            print(f"step {step}: {bits:.4f} bits per decision", file=sys.stderr)
    return weights


def quantized(weights: list[Floats]) -> tuple[NDArray[np.int8], int]:
    """Return the weights as int8 (inputs and biases, then outputs; one row each), and the output bias."""
    rows = np.concatenate([weights[0], weights[1].T])
    scaled = np.clip(np.rint(rows * PRIOR_SCALE), -WEIGHT_LIMIT, WEIGHT_LIMIT).astype(np.int8)
    return scaled, round(float(weights[2][0, 0]) * PRIOR_SCALE**2)


def main() -> None:
    """Make scenes, train, and print the module that holds the weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=160)
    parser.add_argument("--steps", type=int, default=6000)
    arguments = parser.parse_args()
    rng = np.random.default_rng(1995)
    parts = [random_part(rng, random_shell(rng)) for _ in range(arguments.scenes)]
    samples = [decisions(state, added) for state, added in parts if len(added)]
    inputs, outcomes = (np.concatenate(part) for part in zip(*samples, strict=True))
    rows, output_bias = quantized(train(inputs, outcomes, arguments.steps, rng))
    text = base64.b85encode(rows.tobytes()).decode()
    lines = "\n".join(f'    r"{text[k : k + LINE]}"' for k in range(0, len(text), LINE))
    print(MODULE.format(output_bias=output_bias, lines=lines), end="")


if __name__ == "__main__":
    main()
