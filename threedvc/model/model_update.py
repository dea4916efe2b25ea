# SPDX-License-Identifier: MIT
"""A model update: what changes in the decoded state of one object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["ModelUpdate"]


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelUpdate:
    """Cells that appear, vanish or change color.

    Attributes
    ----------
    added, removed, recolored
        (n, 3) int32 cell coordinates, disjoint sets, each in Morton order (x lowest bit).
        `added` cells are not occupied in the state before, the others are.
    added_colors, recolored_colors
        (n, 3) int16 RGB of the rows of `added` and `recolored`; values a little beyond 0..255 are
        allowed and clamped when drawn.
    importance
        How much errors of the colors count, (n,) float32, of `added` and then of `recolored` cells, or None: alike.
        An encoder's; it is not sent.
    """

    added: NDArray[np.int32]
    added_colors: NDArray[np.int16]
    removed: NDArray[np.int32]
    recolored: NDArray[np.int32]
    recolored_colors: NDArray[np.int16]
    importance: NDArray[np.float32] | None = None

    @classmethod
    def adding(cls, cells: NDArray[np.int32], colors: NDArray[np.int16]) -> ModelUpdate:
        """Return an update that does nothing but add cells (n, 3) with their colors (n, 3)."""
        none = np.empty((0, 3), dtype=np.int32)
        return cls(
            added=cells, added_colors=colors, removed=none, recolored=none, recolored_colors=none.astype(np.int16)
        )

    @property
    def size(self) -> int:
        """Number of cells that change."""
        return len(self.added) + len(self.removed) + len(self.recolored)

    @property
    def empty(self) -> bool:
        """Whether nothing changes."""
        return self.size == 0
