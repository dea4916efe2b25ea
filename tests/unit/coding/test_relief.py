# SPDX-License-Identifier: MIT
"""Relief: where in their cells surfaces pass, as payload and as drawn."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.rendering import surface_cells
from threedvc.coding.relief import decode_relief, encode_relief
from threedvc.config import RenderConfig
from threedvc.errors import CorruptStream
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import make_pose
from threedvc.kernels.coding.relief import FLAT, UNSET
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer

CELL = 0.05
Cells = NDArray[np.int32]


def tilted(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """A wall about a meter away that grid and surface share no direction of."""
    return np.asarray((points @ np.array([0.11, -0.07, 1.0]) - 0.013) / 1.01)


def tilted_crossings(cells: Cells) -> NDArray[np.float32]:
    """Where the wall passes along each axis from the centers of cells, in cells."""
    slopes = np.array([0.11, -0.07, 1.0]) / 1.01
    return np.asarray(-tilted((cells + 0.5) * CELL)[:, None] / slopes / CELL, dtype=np.float32)


def bare(cells: Cells, bits: int) -> DecodedModel:
    model = DecodedModel(CELL, relief_bits=bits)
    model.apply(added(cells))
    return model


def added(cells: Cells) -> ModelUpdate:
    return ModelUpdate.adding(cells, np.full((len(cells), 3), 90, dtype=np.int16))


def wall() -> Cells:
    return surface_cells(tilted, CELL, 1.0)


def same(one: DecodedModel, other: DecodedModel) -> bool:
    return one.digest() == other.digest()


@pytest.mark.parametrize("bits", [1, 2, 3])
def test_a_relief_passes_through_its_payload(bits: int) -> None:
    sent, got = bare(wall(), bits), bare(wall(), bits)
    payload = encode_relief(sent, tilted_crossings(sent.cells_without_offset()[0]))
    assert not same(sent, got)
    decode_relief(payload, got)
    assert same(sent, got)
    assert not len(got.cells_without_offset()[0])


def test_a_relief_that_comes_in_parts_is_the_same_on_both_sides() -> None:
    cells = wall()
    sent, got = DecodedModel(CELL, relief_bits=2), DecodedModel(CELL, relief_bits=2)
    for part in (cells[::3], cells[1::3], cells[2::3]):
        for model in (sent, got):
            model.apply(added(part))
        decode_relief(encode_relief(sent, tilted_crossings(sent.cells_without_offset()[0])), got)
        assert same(sent, got)


def test_a_relief_on_a_plane_costs_little() -> None:
    model = bare(wall(), 2)
    payload = encode_relief(model, tilted_crossings(model.cells_without_offset()[0]))
    assert 8 * len(payload) < 0.8 * model.cell_count


def depth_error(model: DecodedModel) -> float:
    """Return the largest error in cells of the wall as drawn."""
    camera = Camera(width=60, height=60, fx=80.0, fy=80.0, cx=29.5, cy=29.5)
    shown = RenderModel(model)
    shown.refresh(1)
    pose = make_pose(np.eye(3), np.array([0.0, 0.0, 1.5]))
    depth = Renderer(CameraRig.registered_to(camera), RenderConfig(threads=1)).draw({0: shown}, {0: pose}).depth
    points = np.concatenate([camera.rays(), np.ones((60, 60, 1))], axis=2) * depth[..., None] - [0, 0, 1.5]
    return float(np.abs(tilted(points))[8:-8, 8:-8].max() / CELL)


def test_surfaces_are_drawn_where_the_relief_says() -> None:
    errors = []
    for bits in (0, 1, 3):
        model = bare(wall(), bits)
        if bits:
            encode_relief(model, tilted_crossings(model.cells_without_offset()[0]))
        errors.append(depth_error(model))
    assert errors[1] < 0.7 * errors[0]
    assert errors[2] < 0.12


def test_a_cell_that_spans_no_plane_has_none() -> None:
    model = bare(np.array([[3, 4, 5]], dtype=np.int32), 2)
    assert encode_relief(model, np.full((1, 3), 0.4, dtype=np.float32)) == b""
    assert model.relief.reshape(-1)[model.index.locate(np.array([[3, 4, 5]], dtype=np.int32))] == FLAT


def test_a_cell_that_vanishes_loses_its_relief() -> None:
    cells = wall()
    model = bare(cells, 1)
    encode_relief(model, tilted_crossings(model.cells_without_offset()[0]))
    none, some = np.empty((0, 3), dtype=np.int32), cells[5:9]
    colors = np.empty((0, 3), dtype=np.int16)
    model.apply(ModelUpdate(added=none, added_colors=colors, removed=some, recolored=none, recolored_colors=colors))
    assert np.all(model.relief.reshape(-1)[model.index.locate(some)] == UNSET)
    model.apply(added(some))
    np.testing.assert_array_equal(model.cells_without_offset()[0], some)


def test_a_damaged_payload_is_refused() -> None:
    sent, got = bare(wall(), 3), bare(wall(), 3)
    payload = encode_relief(sent, np.random.default_rng(2).uniform(-0.5, 0.5, (sent.cell_count, 3)).astype(np.float32))
    before = got.digest()
    for broken in (payload[: len(payload) // 2], payload + b"\x01\x02\x03\x04\x05\x06"):
        with pytest.raises(CorruptStream):
            decode_relief(broken, got)
        assert got.digest() == before
