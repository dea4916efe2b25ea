# SPDX-License-Identifier: MIT
"""Payloads of model updates against the state before."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.coding.color import ColorSettings
from threedvc.coding.morton import morton_order
from threedvc.coding.update import decode_update, encode_update_with_result
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.model.model_update import ModelUpdate

NO_CELLS = np.empty((0, 3), dtype=np.int32)
NO_COLORS = np.empty((0, 3), dtype=np.int16)
SETTINGS = ColorSettings(luma_step=12, chroma_step=18)

Cells = NDArray[np.int32]
Colors = NDArray[np.int16]


def make_update(
    added: Cells = NO_CELLS,
    added_colors: Colors = NO_COLORS,
    removed: Cells = NO_CELLS,
    recolored: Cells = NO_CELLS,
    recolored_colors: Colors = NO_COLORS,
) -> ModelUpdate:
    """Return an update of which only some parts are given."""
    return ModelUpdate(
        added=added,
        added_colors=added_colors,
        removed=removed,
        recolored=recolored,
        recolored_colors=recolored_colors,
    )


def plane(start: int, stop: int) -> tuple[Cells, Colors]:
    """Return a strip of a tilted plane, in Morton order, and its colors."""
    x, y = np.meshgrid(np.arange(start, stop), np.arange(-20, 20))
    cells = np.stack([x, y, (x + 2 * y) // 5], axis=-1).reshape(-1, 3).astype(np.int32)
    cells = cells[morton_order(cells)]
    colors = np.stack([100 + cells[:, 0], 120 + cells[:, 1], 90 - cells[:, 0]], axis=-1).astype(np.int16)
    return cells, colors


def payload_of(update: ModelUpdate, cells: Cells, colors: Colors) -> bytes:
    return encode_update_with_result(update, cells, colors, SETTINGS)[0]


def check_round_trip(update: ModelUpdate, cells: Cells, colors: Colors) -> tuple[int, ModelUpdate]:
    """Return the payload size and the decoded update, which both sides must see alike."""
    payload, expected = encode_update_with_result(update, cells, colors, SETTINGS)
    decoded = decode_update(payload, cells, colors)
    for name in ("added", "removed", "recolored"):
        assert np.array_equal(getattr(decoded, name), getattr(update, name))
        assert getattr(decoded, name).dtype == np.int32
    for name in ("added_colors", "recolored_colors"):
        assert np.array_equal(getattr(decoded, name), getattr(expected, name))
        assert getattr(decoded, name).dtype == np.int16
    return len(payload), decoded


def test_nothing_is_one_byte_at_most() -> None:
    cells, colors = plane(0, 10)
    assert check_round_trip(make_update(), cells, colors)[0] <= 1


def test_first_update() -> None:
    cells, colors = plane(-30, 30)
    size, decoded = check_round_trip(make_update(cells, colors), NO_CELLS, NO_COLORS)
    assert size < len(cells) / 4
    assert np.abs(decoded.added_colors - colors).max() < 30


def test_all_three_parts_at_once() -> None:
    cells, colors = plane(-30, 30)
    added, added_colors = plane(30, 50)
    part = np.arange(len(cells)) % 100
    update = make_update(added, added_colors, cells[part == 3], cells[part == 7], colors[part == 7] + np.int16(60))
    _, decoded = check_round_trip(update, cells, colors)
    assert np.abs(decoded.recolored_colors - update.recolored_colors).max() < 30


def test_single_cell_updates_are_small() -> None:
    cells, colors = plane(-30, 30)
    far = np.array([[31, 0, 6]], dtype=np.int32)
    assert check_round_trip(make_update(far, colors[:1]), cells, colors)[0] <= 12
    assert check_round_trip(make_update(removed=cells[100:101]), cells, colors)[0] <= 6
    assert check_round_trip(make_update(recolored=cells[100:101], recolored_colors=colors[:1]), cells, colors)[0] <= 14


def test_everything_can_vanish() -> None:
    cells, colors = plane(-30, 30)
    assert check_round_trip(make_update(removed=cells), cells, colors)[0] < 60


def test_far_apart_cells() -> None:
    cells = np.array([[-300000, 5, 7], [3, -200000, 0], [400000, 400000, -99]], dtype=np.int32)
    cells = cells[morton_order(cells)]
    check_round_trip(make_update(cells, np.full((3, 3), 9, dtype=np.int16)), NO_CELLS, NO_COLORS)


@pytest.mark.parametrize("cells", [[[0, 0, 0], [1 << 20, 0, 0]], [[(1 << 20) + 1, 0, 0]]])
def test_cells_out_of_range_are_refused(cells: list[list[int]]) -> None:
    array = np.array(cells, dtype=np.int32)
    with pytest.raises(LimitExceeded, match=r"use larger cells"):
        payload_of(make_update(array, np.zeros((len(cells), 3), dtype=np.int16)), NO_CELLS, NO_COLORS)


def test_update_of_another_state_is_noticed() -> None:
    cells, colors = plane(-30, 30)
    payload = payload_of(make_update(removed=cells[::3]), cells, colors)
    with pytest.raises(CorruptStream):
        decode_update(payload, NO_CELLS, NO_COLORS)


def test_spare_bytes_are_noticed() -> None:
    cells, colors = plane(-30, 30)
    payload = payload_of(make_update(cells, colors), NO_CELLS, NO_COLORS)
    with pytest.raises(CorruptStream, match="goes on after its end"):
        decode_update(payload + bytes(9), NO_CELLS, NO_COLORS)


def test_another_process_writes_the_same_bytes() -> None:
    cells, colors = plane(-30, 30)
    here = hashlib.sha256(payload_of(make_update(cells, colors), NO_CELLS, NO_COLORS)).hexdigest()
    script = (
        "import hashlib, sys; sys.path[:0] = ['tests']\n"
        "import importlib.util as u; s = u.spec_from_file_location('t', sys.argv[1])\n"
        "t = u.module_from_spec(s); s.loader.exec_module(t)\n"
        "c, k = t.plane(-30, 30)\n"
        "p = t.payload_of(t.make_update(c, k), t.NO_CELLS, t.NO_COLORS)\n"
        "print(hashlib.sha256(p).hexdigest())"
    )
    run = subprocess.run([sys.executable, "-c", script, __file__], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == here
