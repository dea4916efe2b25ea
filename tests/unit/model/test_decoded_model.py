# SPDX-License-Identifier: MIT
"""Decoded models under updates, their digest, and the evidence's storage."""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.model.block_index import BLOCK_CELLS, morton_keys
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate

Cell = tuple[int, int, int]


def cells_array(cells: list[Cell]) -> NDArray[np.int32]:
    return np.array(cells, dtype=np.int32).reshape(-1, 3)


def update(
    added: dict[Cell, Cell] | None = None, removed: list[Cell] | None = None, recolored: dict[Cell, Cell] | None = None
) -> ModelUpdate:
    added, recolored = added or {}, recolored or {}
    return ModelUpdate(
        added=cells_array(list(added)),
        added_colors=cells_array(list(added.values())).astype(np.int16),
        removed=cells_array(removed or []),
        recolored=cells_array(list(recolored)),
        recolored_colors=cells_array(list(recolored.values())).astype(np.int16),
    )


def content(model: DecodedModel) -> dict[Cell, Cell]:
    cells, colors = model.cells()
    return {tuple(cell): tuple(color) for cell, color in zip(cells.tolist(), colors.tolist(), strict=True)}


def random_cells(rng: np.random.Generator, count: int) -> list[Cell]:
    return [tuple(cell) for cell in np.unique(rng.integers(-40, 40, (count, 3)), axis=0).tolist()]


def random_colors(rng: np.random.Generator, cells: list[Cell]) -> dict[Cell, Cell]:
    return {cell: tuple(rng.integers(-20, 280, 3).tolist()) for cell in cells}


def test_follows_updates_like_a_dictionary(rng: np.random.Generator) -> None:
    model, expected = DecodedModel(0.01), dict[Cell, Cell]()
    for _ in range(8):
        present = sorted(expected)
        fresh = random_colors(rng, [cell for cell in random_cells(rng, 120) if cell not in expected])
        removed = [cell for cell in present if rng.random() < 0.2]
        changed = random_colors(rng, [cell for cell in present if cell not in removed and rng.random() < 0.2])
        model.apply(update(fresh, removed, changed))
        expected = {cell: color for cell, color in (expected | fresh | changed).items() if cell not in removed}
        assert content(model) == expected
        assert model.cell_count == len(expected)
        keys = morton_keys(model.cells()[0])
        assert np.all(np.diff(keys) > 0)


def test_an_empty_update_changes_nothing() -> None:
    model = DecodedModel(0.01)
    assert update().empty
    model.apply(update())
    assert (content(model), model.cell_count, len(model.changed_since(0))) == ({}, 0, 0)


@pytest.mark.parametrize(
    "wrong",
    [
        update({(1, 2, 3): (0, 0, 0)}),
        update({(0, 0, 0): (1, 1, 1), (1, 2, 3): (0, 0, 0)}),
        update(removed=[(1, 2, 4)]),
        update(removed=[(1000, 2, 4)]),
        update(recolored={(1, 2, 4): (0, 0, 0)}),
        update(recolored={(-500, 2, 4): (0, 0, 0)}),
    ],
    ids=[
        "added twice",
        "one of two added twice",
        "removed empty",
        "removed absent",
        "recolored empty",
        "recolored absent",
    ],
)
def test_an_update_that_does_not_fit_leaves_the_model(wrong: ModelUpdate) -> None:
    model = DecodedModel(0.01)
    model.apply(update({(1, 2, 3): (10, 20, 30)}))
    before = model.digest()
    with pytest.raises(CorruptStream, match="does not fit the model; the stream is damaged or a packet is missing"):
        model.apply(wrong)
    assert model.digest() == before
    assert model.cell_count == 1


def test_an_update_out_of_range_is_refused() -> None:
    with pytest.raises(LimitExceeded, match=r"further than 2\^20 cells"):
        DecodedModel(0.01).apply(update({(1 << 20, 0, 0): (0, 0, 0)}))


def test_digest_is_the_one_of_the_format(rng: np.random.Generator) -> None:
    model = DecodedModel(0.016)
    colors = random_colors(rng, random_cells(rng, 50))
    model.apply(update(colors))
    cells = sorted(colors, key=lambda cell: int(morton_keys(cells_array([cell]))[0]))
    state = struct.pack("<d", 0.016)
    state += b"".join(struct.pack("<3i", *cell) for cell in cells)
    state += b"".join(struct.pack("<3h", *colors[cell]) for cell in cells)
    assert model.digest() == hashlib.sha256(state).digest()[:16]


def test_digest_knows_no_history(rng: np.random.Generator) -> None:
    colors = random_colors(rng, random_cells(rng, 60))
    at_once, in_steps = DecodedModel(0.01), DecodedModel(0.01)
    at_once.apply(update(colors))
    for cell in sorted(colors, reverse=True):
        in_steps.apply(update({cell: (0, 0, 0), (90, 90, 90): (1, 1, 1)}))
        in_steps.apply(update({}, [(90, 90, 90)], {cell: colors[cell]}))
    assert in_steps.digest() == at_once.digest()


def test_digest_sees_every_part() -> None:
    digests = set()
    for size, cell, color in [(0.01, (1, 2, 3), (4, 5, 6)), (0.02, (1, 2, 3), (4, 5, 6)), (0.01, (1, 2, 4), (4, 5, 6)),
                              (0.01, (1, 2, 3), (4, 5, 7))]:  # fmt: skip
        model = DecodedModel(size)
        model.apply(update({cell: color}))
        digests.add(model.digest())
    assert len(digests) == 4


def test_changed_blocks_are_told_by_version() -> None:
    def since(version: int) -> set[Cell]:
        return {tuple(block) for block in model.changed_since(version).tolist()}

    model = DecodedModel(0.01)
    model.apply(update({(0, 0, 0): (1, 1, 1), (7, 7, 7): (1, 1, 1), (-1, 8, 0): (2, 2, 2), (70, 0, 0): (3, 3, 3)}))
    assert since(0) == {(0, 0, 0), (-1, 1, 0), (8, 0, 0)}
    first = model.version
    assert since(first) == set()
    model.apply(update({}, [(70, 0, 0)], {(-1, 8, 0): (9, 9, 9)}))
    assert since(first) == {(8, 0, 0), (-1, 1, 0)}
    assert since(0) == {(0, 0, 0), (-1, 1, 0), (8, 0, 0)}
    assert since(model.version) == set()


def test_unknown_cells_are_equiprobable() -> None:
    model = EvidenceModel(0.01)
    model.allocate(cells_array([(0, 0, 0), (1, 0, 0)]))
    count = model.index.count
    assert count == 2
    for values in (model.log_odds, model.distance_weight, model.color_weight):
        assert values.shape[1:] == (BLOCK_CELLS,)
        assert not np.any(values[:count])
    assert np.all(model.first_seen[:count] == EvidenceModel.NEVER)


def test_evidence_survives_growth(rng: np.random.Generator) -> None:
    model = EvidenceModel(0.01)
    model.allocate(cells_array([(0, 0, 0)]))
    model.log_odds[0], model.color[0], model.first_seen[0] = 2.5, (1, 2, 3), 7
    model.allocate(rng.integers(-30, 30, (300, 3)).astype(np.int32))
    (position,) = model.index.locate(cells_array([(3, 3, 3)]))
    assert model.log_odds.reshape(-1)[position] == 2.5
    assert model.color.reshape(-1, 3)[position].tolist() == [1, 2, 3]
    assert model.first_seen.reshape(-1)[position] == 7
    assert np.count_nonzero(model.log_odds) == BLOCK_CELLS
    assert len(model.log_odds) >= model.index.count > 250
