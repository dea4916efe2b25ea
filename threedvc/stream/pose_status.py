# SPDX-License-Identifier: MIT
"""How the pose of an object in a frame was found."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["PoseStatus"]


class PoseStatus(StrEnum):
    """How the pose of an object in a frame was found, from the surest to the least sure."""

    KNOWN = "known"
    """Given with the input."""
    TRACKED = "tracked"
    """Registered from the frame before."""
    RELOCALIZED = "relocalized"
    """Found again after it was lost."""
    WEAK = "weak"
    """Registered, but hardly determined or with a poor fit."""
    LOST = "lost"
    """In sight, but not found: the pose is where it is thought to be."""
    UNSEEN = "unseen"
    """Not in sight: the pose is the one it is taken to have."""

    @property
    def usable(self) -> bool:
        """Whether a frame may be fused at a pose that was found so."""
        return self not in (PoseStatus.LOST, PoseStatus.UNSEEN)

    @property
    def doubt(self) -> int:
        """How little it can be trusted, from 0: by this the worst of several is chosen."""
        return list(PoseStatus).index(self)
