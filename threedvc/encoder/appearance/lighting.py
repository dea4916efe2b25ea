# SPDX-License-Identifier: MIT
"""Light on objects that turn: its least squares, and when it changes.

The light on an object is a quadratic function of the normal in the world
(`threedvc.kernels.render.shading.light_basis`). It stands still unless it is told to change: a sequence is divided into
epochs, each with least squares of its own, and neighbors that share a light at little loss are joined until none are
left.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles
from threedvc.coding.light import pack_light, unpack_light
from threedvc.kernels.render.shading import LIGHT_TERMS, light_bases

__all__ = ["LightEquations", "LightTrack", "epoch_frames", "light_at", "light_terms", "light_track"]

LightTrack: TypeAlias = tuple[tuple[int, Doubles], ...]
"""First frame and factors (8,) of each light, in order; the first one also holds before its frame."""

LIGHT_PRIOR = 1e5
"""As if two samples in middle gray (3 times 128 squared each) said of every factor that it is 0."""
MAX_EPOCHS = 24
"""Of a sequence; neighbors are joined where that costs little, so more would only take time."""
MIN_EPOCH_FRAMES = 8
"""Fewer show too few normals to tell eight factors."""
WORTHWHILE_CHANGE = 0.02
"""Share of an object's squared error that a change of its light must save, for some sixteen bytes."""


class LightEquations(NamedTuple):
    """Normal equations of the factors of a light.

    Attributes
    ----------
    matrix, side
        (8, 8) and (8,): the squared error is ``square - 2 side x + x matrix x`` for factors x.
    square
        The squared error without a light.
    """

    matrix: Doubles
    side: Doubles
    square: float

    def __add__(self, other: object) -> LightEquations:
        """Return the equations of the samples of both."""
        if not isinstance(other, LightEquations):
            return NotImplemented
        return LightEquations(self.matrix + other.matrix, self.side + other.side, self.square + other.square)

    @classmethod
    def of(cls, terms: Doubles, unlit: Doubles, residual: Doubles) -> LightEquations:
        """Return the equations of samples whose `residual` (n, 3) ``terms @ factors`` times `unlit` (n, 3) explains."""
        return cls(
            terms.T @ (terms * (unlit**2).sum(axis=1)[:, None]),
            terms.T @ (unlit * residual).sum(axis=1),
            float((residual**2).sum()),
        )

    def solved(self) -> Doubles:
        """Return the factors (8,) of the least squared error."""
        return np.asarray(np.linalg.solve(self.matrix + LIGHT_PRIOR * np.eye(LIGHT_TERMS), self.side))

    def saved(self) -> float:
        """Return how much of the squared error they save."""
        factors = self.solved()
        return float(factors @ (2 * self.side - self.matrix @ factors))


def light_terms(normals: NDArray[np.floating]) -> Doubles:
    """Return the terms (n, 8) of `threedvc.kernels.render.shading.light_basis` for normals (n, 3)."""
    terms = np.empty((len(normals), LIGHT_TERMS))
    light_bases(normals.astype(np.float64), terms)
    return terms


def light_at(track: LightTrack, frame: int) -> Doubles:
    """Return the factors (8,) of the light in a frame."""
    return next((factors for first, factors in reversed(track) if first <= frame), track[0][1])


def epoch_frames(frames: int) -> int:
    """Return how many of the frames of a sequence are an epoch."""
    return max(-(-frames // MAX_EPOCHS), MIN_EPOCH_FRAMES)


def light_track(epochs: Mapping[int, LightEquations]) -> LightTrack:
    """Return the lights, as the stream can tell them, of epochs by their first frames, which rise."""
    parts = list(epochs.items())
    whole = parts[0][1]
    for _, equations in parts[1:]:
        whole = whole + equations
    allowed = WORTHWHILE_CHANGE * max(whole.square - whole.saved(), 0.0)
    while len(parts) > 1:
        joined = [(first, one + other) for (first, one), (_, other) in pairwise(parts)]
        apart = [one.saved() + other.saved() for (_, one), (_, other) in pairwise(parts)]
        losses = [both - synchronized.saved() for both, (_, synchronized) in zip(apart, joined, strict=True)]
        least = int(np.argmin(losses))
        if losses[least] > allowed:
            break
        parts[least : least + 2] = [joined[least]]
    return tuple((first, unpack_light(pack_light(equations.solved()))) for first, equations in parts)
