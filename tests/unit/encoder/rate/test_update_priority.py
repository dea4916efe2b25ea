# SPDX-License-Identifier: MIT
"""The order in which blocks of an update are sent when not all of them fit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.model_entropy import LOOK_SPREAD, LOOK_WEIGHT, EntropyMeter
from threedvc.encoder.rate.update_priority import (
    MAX_NEARNESS,
    OUT_OF_SIGHT,
    bits_taken,
    information_gain_bits,
    select_within,
    sight_weights,
)
from threedvc.geometry.pose import make_pose
from threedvc.model.block_index import BLOCK_SIDE, morton_keys
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate

BLOCKS = 6
IN_SIGHT = np.ones(BLOCKS)
NONE = np.empty((0, 3), dtype=np.int32)
NO_COLORS = np.empty((0, 3), dtype=np.int16)


def block_cells(number: int, count: int) -> NDArray[np.int32]:
    """Return cells of the n-th block, in Morton order."""
    low = np.stack(np.meshgrid(*[np.arange(BLOCK_SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = (low + np.array([BLOCK_SIDE * number, 0, 0])).astype(np.int32)
    return cells[np.argsort(morton_keys(cells))][:count]


def evidence(log_odds: float = 8.0, weight: float = 20.0, level: float = 100.0) -> EvidenceModel:
    model = EvidenceModel(0.01)
    model.allocate(np.stack([np.arange(BLOCKS), np.zeros(BLOCKS), np.zeros(BLOCKS)], axis=1).astype(np.int32))
    model.log_odds[:], model.color_weight[:], model.color[:] = log_odds, weight, level
    return model


def sent_with(cells: NDArray[np.int32], level: int) -> DecodedModel:
    sent = DecodedModel(0.01)
    sent.apply(ModelUpdate.adding(cells, np.full((len(cells), 3), level, np.int16)))
    return sent


def update_of(
    added: NDArray[np.int32] = NONE, removed: NDArray[np.int32] = NONE, recolored: NDArray[np.int32] = NONE
) -> ModelUpdate:
    return ModelUpdate(
        added=added,
        added_colors=np.full((len(added), 3), 100, np.int16),
        removed=removed,
        recolored=recolored,
        recolored_colors=np.full((len(recolored), 3), 100, np.int16),
    )


def test_a_new_cell_lifts_all_but_its_entropy() -> None:
    model = evidence(log_odds=1.5, weight=0.7)
    meter = EntropyMeter(model)
    meter.update(np.arange(1), 1)
    lifted = information_gain_bits(update_of(added=block_cells(0, 512)), model, DecodedModel(0.01))
    occupied = 1 / (1 + np.exp(-1.5))
    assert lifted.sum() == pytest.approx(512 * (1 + 24 * occupied) - meter.bits, rel=1e-6)


def test_what_was_never_looked_at_lifts_nothing() -> None:
    lifted = information_gain_bits(update_of(added=block_cells(0, 3)), evidence(0, 0), DecodedModel(0.01))
    np.testing.assert_allclose(lifted, 0, atol=1e-12)


def test_a_wrong_cell_misleads_more_the_surer_it_is_empty() -> None:
    cells = block_cells(0, 4)
    model, sent = evidence(), sent_with(cells, 100)
    model.log_odds[0, :4] = 0
    model.log_odds.reshape(-1)[model.index.locate(cells)] = [-2, -4, -6, -8]
    lifted = information_gain_bits(update_of(removed=cells), model, sent)
    assert np.all(np.diff(lifted) > 0)
    assert lifted[-1] == pytest.approx(8 / np.log(2), rel=0.02)


def test_a_wrong_color_misleads_by_how_far_it_is_off_but_never_more_than_none() -> None:
    cells = block_cells(0, 1)
    bits = [
        information_gain_bits(update_of(recolored=cells), evidence(), sent_with(cells, 100 + off))[0]
        for off in (0, 8, 16, 40, 90)
    ]
    assert bits == sorted(bits)
    entropy = 3 * 0.5 * np.log2(2 * np.pi * np.e * LOOK_SPREAD**2 * LOOK_WEIGHT / 20)
    assert bits[3] == bits[4] == pytest.approx(24 - entropy, abs=0.02)
    # A Gaussian of deviation 8 in place of one of variance 64 / 4 / 20, both about the same mean.
    ratio = LOOK_WEIGHT / 20
    assert bits[0] == pytest.approx(1.5 * (ratio - 1 - np.log(ratio)) / np.log(2), abs=0.02)


def test_dense_blocks_take_fewer_bits_a_cell_and_colors_no_geometry() -> None:
    update = update_of(block_cells(0, 60), NONE, block_cells(2, 60))
    alone = update_of(block_cells(1, 1))
    dense, _, recolored = bits_taken(update, np.repeat([0, 2], 60), 3)
    (single,) = bits_taken(alone, np.zeros(1, dtype=np.int64), 1)
    assert dense / 60 < single / 4
    assert recolored == bits_taken(update, np.repeat([0, 2], 60), 3)[2] > 0
    assert bits_taken(update, np.repeat([0, 2], 60), 3)[1] == 0


def shares(update: ModelUpdate, model: EvidenceModel, sent: DecodedModel) -> list[list[int]]:
    """Return, for rising shares, which blocks are taken."""
    parts = [select_within(update, model, sent, share, IN_SIGHT) for share in np.linspace(0, 1, 41)]
    blocks = [
        np.unique(np.concatenate([part.added, part.removed, part.recolored])[:, 0] // BLOCK_SIDE) for part in parts
    ]
    return [each.tolist() for each in blocks]


def entry(taken: list[list[int]]) -> list[int]:
    """Return blocks in the order in which they come in as the share rises."""
    order: list[int] = []
    for blocks in taken:
        order += [number for number in blocks if number not in order]
    return order


def test_full_blocks_come_before_scattered_cells() -> None:
    counts = [40, 1, 64, 8, 20]
    update = update_of(np.concatenate([block_cells(number, count) for number, count in enumerate(counts)]))
    assert entry(shares(update, evidence(), DecodedModel(0.01))) == [2, 0, 4, 3, 1]


def test_sure_cells_come_before_doubtful_ones() -> None:
    model = evidence()
    model.log_odds[1], model.color_weight[0] = 0.3, 2.0
    update = update_of(np.concatenate([block_cells(number, 30) for number in range(3)]))
    assert entry(shares(update, model, DecodedModel(0.01))) == [2, 0, 1]


def test_new_surface_comes_before_wrong_colors_and_these_before_slightly_wrong_ones() -> None:
    held = np.concatenate([block_cells(0, 30), block_cells(2, 30)])
    sent = sent_with(held, 118)
    sent.color.reshape(-1, 3)[sent.index.locate(block_cells(2, 30))] = 200
    update = update_of(added=block_cells(1, 30), recolored=held)
    assert entry(shares(update, evidence(), sent)) == [1, 2, 0]


def test_what_is_in_sight_comes_first() -> None:
    update = update_of(np.concatenate([block_cells(0, 40), block_cells(1, 30)]))
    behind = np.where(np.arange(BLOCKS) > 0, 1, OUT_OF_SIGHT)
    model = evidence()
    plain = select_within(update, model, DecodedModel(0.01), 0.6, IN_SIGHT)
    seen = select_within(update, model, DecodedModel(0.01), 0.6, behind)
    assert set((plain.added[:, 0] // BLOCK_SIDE).tolist()) == {0}
    assert set((seen.added[:, 0] // BLOCK_SIDE).tolist()) == {1}


def test_near_blocks_count_by_the_pixels_that_they_cover() -> None:
    model = EvidenceModel(0.01)
    model.index.insert(np.array([[0, 0, z] for z in (0, 1, 2, 5, 60, 200)], dtype=np.int32))
    in_sight = np.array([True, True, True, True, False, True])
    weights = sight_weights(model, in_sight, make_pose(np.eye(3), np.array([0, 0, 0.96])))
    depths = 0.96 + 0.08 * (np.array([0, 1, 2, 5, 60, 200]) + 0.5)
    middle = np.median(depths[in_sight])
    np.testing.assert_allclose(weights[:4], (middle / depths[:4]) ** 2)
    assert weights[4] == OUT_OF_SIGHT
    assert weights[5] == 1 / MAX_NEARNESS
    behind = sight_weights(model, in_sight, make_pose(np.eye(3), np.array([0, 0, -100.0])))
    assert behind[0] == 1 / MAX_NEARNESS


def test_a_part_keeps_what_belongs_to_its_cells(rng: np.random.Generator) -> None:
    added, held = block_cells(0, 50), block_cells(1, 40)
    removed, recolored = held[::2], held[1::2]
    colors = rng.integers(0, 256, (70, 3)).astype(np.int16)
    update = ModelUpdate(
        added=added,
        added_colors=colors[:50],
        removed=removed,
        recolored=recolored,
        recolored_colors=colors[50:],
        importance=np.arange(70, dtype=np.float32),
    )
    model, sent = evidence(), sent_with(held, 255)
    assert select_within(update, model, sent, 0, IN_SIGHT).empty
    assert select_within(update, model, sent, -1, IN_SIGHT).empty
    whole = select_within(update, model, sent, 1, IN_SIGHT)
    assert whole.size == update.size
    part = select_within(update, model, sent, 0.7, IN_SIGHT)
    kept_added = len(part.added) > 0
    wanted = slice(0, 50) if kept_added else slice(50, 70)
    assert part.size in (50, 40)
    assert part.importance is not None
    np.testing.assert_array_equal(part.importance, np.arange(70)[wanted])
    np.testing.assert_array_equal(part.added_colors if kept_added else part.recolored_colors, colors[wanted])
