# SPDX-License-Identifier: MIT
"""Priority in a model update of which not all fits: what gains most information per bit goes first.

The uncertainty of a receiver about a cell is the cross-entropy, in bits, of the evidence against what the receiver
believes. Of a cell that was never sent it believes nothing: occupancy is equiprobable, and so are the 256 levels of
each channel. Of a cell that was sent it believes what it draws: that it is occupied, as surely as evidence can tell,
and of its color, known as well as after one look of weight 1/4; a color further off than that costs as much as none.
Once the cell is sent, the entropy of the evidence is left, H(occupancy) + H(color), see
`threedvc.encoder.fusion.model_entropy`. The difference, a Kullback-Leibler divergence, is the information
that sending it gains. A receiver looks at the present picture, so what was not in the field of view lately counts less.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.config import FusionConfig
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.model_entropy import UNKNOWN_BITS, channel_bits, cross_entropy_bits
from threedvc.geometry.pose import Pose
from threedvc.metrics.entropy import bernoulli_entropy_bits
from threedvc.model.block_index import BLOCK_CELLS, BLOCK_SIDE
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate

__all__ = ["bits_taken", "information_gain_bits", "select_within", "sight_weights"]

CHANNELS = 3
"""Colors are red, green and blue."""
SURE_LOG_ODDS = FusionConfig().max_log_odds
"""A receiver believes what it draws as surely as evidence can tell."""
OUT_OF_SIGHT = 0.1
"""How much a bit counts that the present picture does not show; by hand: it may come into view again."""
MAX_NEARNESS = 9.0
"""How much more or less a bit counts at most than at the median distance: as at a third of it, or at three times; by
hand."""
BLOCK_BITS, ADDED_BITS = 40.0, 2.0
REMOVED_BITS, RECOLORED_BITS = 6.0, 5.5
"""About what a block with new cells takes, and each cell: by hand, after fits to parts of updates of recorded rooms."""


def information_gain_bits(
    update: ModelUpdate, model: EvidenceModel, sent: DecodedModel, *, colored: bool = True
) -> NDArray[np.float64]:
    """Return by how much sending each cell lessens the uncertainty of a receiver.

    Parameters
    ----------
    update
        The cells.
    model
        Evidence about them.
    sent
        What the receiver has.
    colored
        Whether cells have colors, and do not only tell where a surface is.

    Returns
    -------
    numpy.ndarray
        (n,) float64 bits of the added, then the removed, then the recolored cells; none is below 0.
    """
    cells = _cells(update)
    positions = model.index.locate(cells)
    log_odds = model.log_odds.reshape(-1)[positions].astype(np.float64)
    weight = model.color_weight.reshape(-1)[positions]
    occupied = 1 / (1 + np.exp(-log_odds))
    before, color = np.ones(len(cells)), np.full(len(cells), CHANNELS * UNKNOWN_BITS)
    held = slice(len(update.added), None)
    before[held] = (np.logaddexp(0, SURE_LOG_ODDS) - occupied[held] * SURE_LOG_ODDS) / np.log(2)
    gained = before - bernoulli_entropy_bits(log_odds)
    if colored:
        residual = model.color.reshape(-1, CHANNELS)[positions[held]] - _held_colors(sent, cells[held])
        color[held] = cross_entropy_bits(residual, weight[held, None]).sum(axis=1)
        gained += occupied * (color - CHANNELS * channel_bits(weight))
    return np.asarray(np.maximum(gained, 0.0))


def bits_taken(update: ModelUpdate, member: NDArray[np.int64], blocks: int) -> NDArray[np.float64]:
    """Estimate the bits (blocks,) that the cells of each block take.

    New cells cost a place for their block, and little each once that is told; cells that are there already cost
    no geometry.

    Parameters
    ----------
    update
        The cells.
    member
        (n,) number of the block of each added, removed and recolored cell.
    blocks
        Number of blocks.
    """
    counts = [len(group) for group in (update.added, update.removed, update.recolored)]
    added, removed, recolored = (
        np.bincount(part, minlength=blocks) for part in np.split(member, np.cumsum(counts)[:-1])
    )
    return np.asarray(
        BLOCK_BITS * (added > 0) + ADDED_BITS * added + REMOVED_BITS * removed + RECOLORED_BITS * recolored
    )


def sight_weights(model: EvidenceModel, in_sight: NDArray[np.bool_], T_camera_object: Pose) -> NDArray[np.float64]:
    """Return how much a bit of each block (blocks,) counts: as many pixels as it covers, those out of sight little.

    Parameters
    ----------
    model
        The evidence.
    in_sight
        (blocks,) which of them were in the field of view lately.
    T_camera_object
        Where the camera is now.
    """
    centers = (model.index.coords[: len(in_sight)] + 0.5) * BLOCK_SIDE * model.voxel_size_m
    depth = centers @ T_camera_object[2, :3] + T_camera_object[2, 3]
    ahead = in_sight & (depth > 0)
    middle = float(np.median(depth[ahead])) if ahead.any() else 1.0
    nearness = np.clip((middle / np.where(depth > 0, depth, np.inf)) ** 2, 1 / MAX_NEARNESS, MAX_NEARNESS)
    return np.where(in_sight, nearness, OUT_OF_SIGHT)


def select_within(
    update: ModelUpdate,
    model: EvidenceModel,
    sent: DecodedModel,
    share: float,
    sight: NDArray[np.float64],
    *,
    colored: bool = True,
) -> ModelUpdate:
    """Return the part of an update that gains most information per bit, of at most about a share of its bits.

    Parameters
    ----------
    update
        What could be sent.
    model
        Evidence about its cells.
    sent
        What the receiver has.
    share
        How much of the update's coded size may be taken; blocks of 8x8x8 cells are taken whole.
    sight
        (blocks of the evidence,) how much the bits of each count, see `sight_weights`.
    colored
        Whether cells have colors.
    """
    positions = model.index.locate(_cells(update))
    numbers, member = np.unique(positions // BLOCK_CELLS, return_inverse=True)
    bits = information_gain_bits(update, model, sent, colored=colored)
    gained = np.bincount(member, bits, minlength=len(numbers)) * sight[numbers]
    cost = bits_taken(update, member, len(numbers))
    order = np.argsort(-gained / cost, kind="stable")
    chosen = np.zeros(len(numbers), dtype=bool)
    chosen[order[np.cumsum(cost[order]) <= share * cost.sum()]] = True
    return _part(update, chosen[member])


def _cells(update: ModelUpdate) -> NDArray[np.int32]:
    return np.concatenate([update.added, update.removed, update.recolored])


def _held_colors(sent: DecodedModel, cells: NDArray[np.int32]) -> NDArray[np.int16]:
    return np.asarray(sent.color.reshape(-1, CHANNELS)[sent.index.locate(cells)])


def _part(update: ModelUpdate, keep: NDArray[np.bool_]) -> ModelUpdate:
    """Return the cells of an update where `keep` (n,), of added, removed and recolored ones, is true."""
    counts = [len(group) for group in (update.added, update.removed, update.recolored)]
    added, removed, recolored = np.split(keep, np.cumsum(counts)[:-1])
    colored = np.concatenate([added, recolored])
    return ModelUpdate(
        added=update.added[added],
        added_colors=update.added_colors[added],
        removed=update.removed[removed],
        recolored=update.recolored[recolored],
        recolored_colors=update.recolored_colors[recolored],
        importance=None if update.importance is None else update.importance[colored],
    )
