# SPDX-License-Identifier: MIT
"""Bytes as Martins & Moura (1995) count them."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PaperAccounting"]

BYTES_PER_CELL = 4
"""Eq. (8): position and color of a cell in 32 bits."""
BYTES_PER_POSE = 24
"""Eq. (8): six numbers of 32 bits."""


@dataclass(frozen=True, kw_only=True)
class PaperAccounting:
    """Size of a sequence by equations (8) to (10) of Martins and Moura, 1995.

    Equation (9) counts the 8-bit video alone, not the range data, and equation (8) charges nothing
    for the background.

    Attributes
    ----------
    cells
        M, occupied cells of the moving objects.
    pose_frames
        F_m, frames that need a pose.
    frames
        F.
    pixels
        Pixels of a frame, 100 x 100 in the paper.
    """

    cells: float
    pose_frames: float
    frames: int
    pixels: int = 100 * 100

    @property
    def coded_bytes(self) -> float:
        """S_3DVC, eq. (8)."""
        return BYTES_PER_CELL * self.cells + BYTES_PER_POSE * self.pose_frames

    @property
    def raw_bytes(self) -> int:
        """S_raw, eq. (9)."""
        return self.pixels * self.frames

    @property
    def ratio(self) -> float:
        """N of the compression 1:N, the inverse of C in eq. (10); infinite when nothing is sent."""
        return self.raw_bytes / self.coded_bytes if self.coded_bytes else float("inf")
