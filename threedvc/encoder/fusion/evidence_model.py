# SPDX-License-Identifier: MIT
"""The encoder's model of an object: evidence of occupancy and color of every cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.model.block_index import BLOCK_CELLS, BlockIndex

__all__ = ["EvidenceModel"]


class EvidenceModel:
    """Distributions of every cell near a surface, as the encoder accumulates them.

    Attributes
    ----------
    voxel_size_m
        Edge of a cell.
    index
        Blocks.
    log_odds
        (blocks, 512) float32, log of P(occupied) / P(empty).
    distance, distance_weight
        (blocks, 512) float32: mean signed distance to the surface along the viewing rays in meters
        (positive on the sensor's side) and its precision in units of the sensor's at 1 m.
    color, color_weight
        (blocks, 512, 3) and (blocks, 512) float32: mean RGB and its precision.
    first_seen
        (blocks, 512) int32: first frame whose surface came within the cell's reach, or `NEVER`.
    """

    NEVER = np.iinfo(np.int32).max

    def __init__(self, voxel_size_m: float) -> None:
        self.voxel_size_m = voxel_size_m
        self.index = BlockIndex()
        self.log_odds = np.zeros((0, BLOCK_CELLS), dtype=np.float32)
        self.distance = np.zeros((0, BLOCK_CELLS), dtype=np.float32)
        self.distance_weight = np.zeros((0, BLOCK_CELLS), dtype=np.float32)
        self.color = np.zeros((0, BLOCK_CELLS, 3), dtype=np.float32)
        self.color_weight = np.zeros((0, BLOCK_CELLS), dtype=np.float32)
        self.first_seen = np.zeros((0, BLOCK_CELLS), dtype=np.int32)

    def allocate(self, blocks: NDArray[np.int32]) -> None:
        """Give storage to blocks (n, 3); their cells are equiprobable, without color."""
        self.index.insert(blocks)
        have, need = len(self.log_odds), self.index.count
        if need <= have:
            return
        more = max(need, have * 3 // 2) - have
        for name, fill in (
            ("log_odds", 0),
            ("distance", 0),
            ("distance_weight", 0),
            ("color", 0),
            ("color_weight", 0),
            ("first_seen", self.NEVER),
        ):
            array = getattr(self, name)
            tail = np.full((more, *array.shape[1:]), fill, dtype=array.dtype)
            setattr(self, name, np.concatenate([array, tail]))
