# SPDX-License-Identifier: MIT
"""Entropy of the evidence in bits."""

from __future__ import annotations

import numpy as np
import pytest

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.model_entropy import LOOK_SPREAD, LOOK_WEIGHT, EntropyMeter
from threedvc.model.block_index import BLOCK_CELLS


def model_of(blocks: int) -> EvidenceModel:
    model = EvidenceModel(0.01)
    model.allocate(np.stack([np.arange(blocks), 3 * np.arange(blocks), -np.arange(blocks)], axis=1).astype(np.int32))
    return model


def measured(model: EvidenceModel, threads: int = 1) -> float:
    meter = EntropyMeter(model)
    meter.update(np.arange(model.index.count), threads)
    return meter.bits


def reference(model: EvidenceModel) -> float:
    """Sum H(occupied) + P(occupied) H(color) cell by cell."""
    count = model.index.count
    p = 1 / (1 + np.exp(-model.log_odds[:count].astype(np.float64)))
    with np.errstate(divide="ignore", invalid="ignore"):
        occupancy = -np.nan_to_num(p * np.log2(p)) - np.nan_to_num((1 - p) * np.log2(1 - p))
        variance = LOOK_SPREAD**2 * LOOK_WEIGHT / model.color_weight[:count].astype(np.float64)
        channel = np.clip(0.5 * np.log2(2 * np.pi * np.e * variance), 0, 8)
    return float((occupancy + p * 3 * channel).sum())


def test_nothing_known_is_one_bit_and_half_a_color() -> None:
    assert measured(EvidenceModel(0.01)) == 0
    assert measured(model_of(3)) == pytest.approx(3 * BLOCK_CELLS * (1 + 0.5 * 24))


def test_equals_the_sum_over_cells(rng: np.random.Generator) -> None:
    model = model_of(5)
    model.log_odds[:5] = rng.normal(0, 4, (5, BLOCK_CELLS))
    model.color_weight[:5] = rng.choice([0, 0.01, 0.3, 5, 1000], (5, BLOCK_CELLS))
    assert measured(model) == pytest.approx(reference(model), rel=1e-6)


def test_certainty_has_no_entropy() -> None:
    model = model_of(2)
    model.log_odds[0], model.log_odds[1] = 80, -80
    model.color_weight[:2] = 1e4
    assert measured(model) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("sign", [-1, 1])
def test_falls_as_cells_become_certain(sign: int) -> None:
    model = model_of(1)
    model.color_weight[:] = 1e4
    bits = []
    for odds in (0, 0.5, 1, 2, 4, 8):
        model.log_odds[:] = sign * odds
        bits.append(measured(model))
    assert bits == sorted(bits, reverse=True)
    assert len(set(bits)) == len(bits)


def test_untouched_blocks_keep_their_value(rng: np.random.Generator) -> None:
    model = model_of(4)
    meter = EntropyMeter(model)
    meter.update(np.arange(4), 1)
    model.log_odds[:4] = rng.normal(0, 4, (4, BLOCK_CELLS))
    meter.update(np.array([1, 2]), 1)
    halves = model_of(4)
    halves.log_odds[1:3] = model.log_odds[1:3]
    assert meter.bits == pytest.approx(measured(halves))
    model.allocate(np.array([[50, 50, 50]], dtype=np.int32))
    meter.update(np.array([0, 3, 4]), 1)
    assert meter.bits == pytest.approx(measured(model))


def test_threads_do_not_matter(rng: np.random.Generator) -> None:
    model = model_of(40)
    model.log_odds[:40] = rng.normal(0, 4, (40, BLOCK_CELLS))
    assert measured(model, threads=1) == measured(model, threads=3)
