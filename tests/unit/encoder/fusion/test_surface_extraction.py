# SPDX-License-Identifier: MIT
"""MAP read-out of the evidence, and the choice of what to send."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.config import FusionConfig, Sensor
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import fuse, observe
from threedvc.encoder.fusion.surface_extraction import Surface, extract_surface, grouped_by_region
from threedvc.encoder.rate.model_updates import first_visible_update, incremental_update
from threedvc.frames.frame import Frame
from threedvc.frames.sensor_model import SENSORS
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import identity
from threedvc.kernels.encoder.surface import count_neighbors
from threedvc.model.block_index import BLOCK_CELLS, morton_keys
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate

CAMERA = Camera(width=60, height=48, fx=60.0, fy=60.0, cx=29.5, cy=23.5)
RIG = CameraRig.registered_to(CAMERA)
CELL = 0.02
Depth = NDArray[np.float32]


def flat(z: float) -> Depth:
    return np.full((48, 60), z, dtype=np.float32)


def slanted() -> Depth:
    return (1.2 / (1 - 0.4 * CAMERA.rays()[..., 0] + 0.2 * CAMERA.rays()[..., 1])).astype(np.float32)


def ball() -> Depth:
    slopes = CAMERA.rays()
    a = (slopes**2).sum(axis=-1) + 1
    root = 1.3**2 - a * (1.3**2 - 0.4**2)
    return np.where(root > 0, (1.3 - np.sqrt(np.maximum(root, 0))) / a, 0).astype(np.float32)


def add(model: EvidenceModel, depth: Depth, index: int = 0, shade: int = 100, sensor: Sensor = Sensor.IDEAL) -> None:
    color = np.full((48, 60, 3), shade, dtype=np.uint8)
    frame = Frame(index=index, timestamp_ns=index, color=color, depth=depth)
    mask = np.ones(depth.shape, dtype=bool)
    fuse(model, observe(frame, RIG, CAMERA.rays()), mask, identity(), SENSORS[sensor], FusionConfig(), 1)


def evidence(*depths: Depth, times: int = 1) -> EvidenceModel:
    model = EvidenceModel(CELL)
    for index, depth in enumerate(depths * times):
        add(model, depth, index)
    return model


def centers(cells: NDArray[np.int32]) -> NDArray[np.float64]:
    return (cells + 0.5) * CELL


def as_set(cells: NDArray[np.int32]) -> set[tuple[int, ...]]:
    return {tuple(cell) for cell in cells.tolist()}


def columns(cells: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return how many cells stand at each place of the picture plane, away from its border."""
    inner = cells[(np.abs(cells[:, 0]) < 20) & (np.abs(cells[:, 1]) < 15)]
    return np.unique(inner[:, :2], axis=0, return_counts=True)[1]


def test_a_wall_is_one_layer_of_cells() -> None:
    surface = extract_surface(evidence(flat(1.21), times=3), 1)
    np.testing.assert_allclose(centers(surface.cells)[:, 2], 1.21, atol=1e-6)
    assert len(columns(surface.cells)) == 39 * 29
    assert set(columns(surface.cells)) == {1}


@pytest.mark.parametrize("z", [1.2, 1.2037, 1.2099])
def test_a_wall_anywhere_in_its_cell_is_one_layer(z: float) -> None:
    surface = extract_surface(evidence(flat(z), times=3), 1)
    assert np.abs(centers(surface.cells)[:, 2] - z).max() <= 0.5 * CELL + 1e-6
    assert set(columns(surface.cells)) == {1}
    assert len(columns(surface.cells)) == 39 * 29


def test_a_slanted_wall_has_no_holes_and_no_depth() -> None:
    surface = extract_surface(evidence(slanted(), times=3), 1)
    points = centers(surface.cells)
    away = (points[:, 2] - 0.4 * points[:, 0] + 0.2 * points[:, 1] - 1.2) / np.sqrt(1.2)
    assert np.abs(away).max() < CELL
    assert columns(surface.cells).max() <= 2
    assert len(columns(surface.cells)) == 39 * 29


def test_a_ball_is_a_thin_shell() -> None:
    surface = extract_surface(evidence(ball(), times=3), 1)
    radius = np.linalg.norm(centers(surface.cells) - [0, 0, 1.3], axis=1)
    assert len(surface.cells) > 800
    assert np.abs(radius - 0.4).max() < 1.2 * CELL
    assert np.all(centers(surface.cells)[:, 2] < 1.3 + CELL)


def test_cells_come_in_morton_order_with_color_and_first_sight() -> None:
    model = EvidenceModel(CELL)
    for index, shade in [(4, 90), (5, 110)]:
        add(model, flat(1.21), index, shade)
    surface = extract_surface(model, 1)
    assert np.all(np.diff(morton_keys(surface.cells)) > 0)
    assert np.all(surface.first_seen == 4)
    assert (surface.cells.dtype, surface.colors.dtype) == (np.int32, np.int16)
    inner = np.abs(surface.cells[:, :2]).max(axis=1) < 14
    assert np.all(surface.colors[inner] == 100)


def test_nothing_known_no_surface() -> None:
    for model in (EvidenceModel(CELL), evidence(np.zeros((48, 60), dtype=np.float32))):
        surface = extract_surface(model, 1)
        assert (surface.cells.shape, surface.colors.shape, surface.first_seen.shape) == ((0, 3), (0, 3), (0,))


def test_a_vanished_thing_is_no_surface() -> None:
    before = flat(1.51)
    before[15:33, 20:40] = 0.81
    model = evidence(before, times=4)
    assert np.any(centers(extract_surface(model, 1).cells)[:, 2] < 1.0)
    for index in range(8):
        add(model, flat(1.51), 4 + index)
    assert not np.any(centers(extract_surface(model, 1).cells)[:, 2] < 1.0)


def test_specks_are_noise() -> None:
    depth = np.zeros((48, 60), dtype=np.float32)
    depth[10, 10] = 0.31
    assert len(extract_surface(evidence(depth, times=5), 1).cells) == 0


def test_threads_do_not_matter() -> None:
    model = evidence(ball(), slanted())
    one, three = extract_surface(model, 1), extract_surface(model, 3)
    for name in ("cells", "colors", "first_seen"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


def test_a_cell_without_color_takes_that_of_a_neighbor() -> None:
    model = evidence(flat(1.21), times=2)
    position = model.index.locate(extract_surface(model, 1).cells[:200:3])
    model.color_weight.reshape(-1)[position] = 0
    model.color.reshape(-1, 3)[position] = 0
    colors = extract_surface(model, 1).colors
    assert np.all(np.abs(colors[:100].astype(int) - 100) <= 1)
    model.color_weight[:] = 0
    assert np.all(extract_surface(model, 1).colors == 128)


def test_neighbors_are_counted_as_by_hand(rng: np.random.Generator) -> None:
    model = DecodedModel(CELL)
    cells = np.unique(rng.integers(-9, 9, (400, 3)), axis=0).astype(np.int32)
    model.apply(update(cells))
    asked = rng.integers(-11, 11, (100, 3)).astype(np.int32)
    counts = np.zeros(len(asked), dtype=np.int32)
    count_neighbors(asked, model.index.locate(asked), model.index.tables, model.occupied.reshape(-1), counts)
    near = np.abs(asked[:, None] - cells[None]).max(axis=2) == 1
    np.testing.assert_array_equal(counts, near.sum(axis=1))


# --- What to send ----------------------------------------------------------------------------------------------------


def update(added: NDArray[np.int32], colors: NDArray[np.int16] | None = None) -> ModelUpdate:
    none = np.empty((0, 3), dtype=np.int32)
    colors = np.full((len(added), 3), 100, dtype=np.int16) if colors is None else colors
    return ModelUpdate(
        added=added, added_colors=colors, removed=none, recolored=none, recolored_colors=none.astype(np.int16)
    )


def surface_of(cells: list[tuple[int, int, int]], seen: list[int]) -> Surface:
    array = np.array(cells, dtype=np.int32)
    colors = np.arange(3 * len(cells), dtype=np.int16).reshape(-1, 3)
    return Surface(
        cells=array,
        colors=colors,
        first_seen=np.array(seen, dtype=np.int32),
        subvoxel_offsets=np.zeros((len(array), 3), dtype=np.float32),
    )


def test_cells_are_due_in_the_group_of_their_first_sight() -> None:
    surface = surface_of([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], [0, 7, 3, 12])
    sent = DecodedModel(CELL)
    groups = []
    for until in (4, 8, None):
        due = first_visible_update(surface, sent, until)
        groups.append(as_set(due.added))
        assert not len(due.removed)
        assert not len(due.recolored)
        sent.apply(due)
    assert groups == [{(0, 0, 0), (0, 1, 0)}, {(1, 0, 0)}, {(1, 1, 0)}]
    assert first_visible_update(surface, sent, None).empty
    np.testing.assert_array_equal(sent.cells()[1], surface.colors)


def test_live_what_was_sent_is_not_sent_again() -> None:
    model, sent = evidence(slanted(), times=6), DecodedModel(CELL)
    first = incremental_update(model, sent, 1)
    assert len(first.added) > 500
    assert not len(first.removed)
    sent.apply(first)
    again = incremental_update(model, sent, 1)
    assert len(again.added) < 0.02 * len(first.added)
    assert not len(again.removed)
    assert not len(again.recolored)


def test_live_all_of_the_surface_is_sent() -> None:
    model, sent = EvidenceModel(CELL), DecodedModel(CELL)
    for index in range(3):
        add(model, flat(2.41), index, sensor=Sensor.REALSENSE)
        sent.apply(incremental_update(model, sent, 1))
        assert as_set(sent.cells()[0]) >= as_set(extract_surface(model, 1).cells)


def test_live_a_surface_that_was_sent_a_cell_off_is_moved() -> None:
    model, sent = evidence(flat(1.21), times=6), DecodedModel(CELL)
    there = extract_surface(model, 1).cells
    shifted = there - [0, 0, 1]
    sent.apply(update(shifted.astype(np.int32)))
    due = incremental_update(model, sent, 1)
    assert as_set(due.added) <= as_set(there)
    assert len(due.added) > 0.9 * len(there)
    assert len(due.removed) > 0.9 * len(shifted)
    sent.apply(due)
    assert incremental_update(model, sent, 1).empty


def test_live_what_vanished_is_taken_away() -> None:
    before = flat(1.51)
    before[15:33, 20:40] = 0.81
    model, sent = evidence(before, times=6), DecodedModel(CELL)
    sent.apply(incremental_update(model, sent, 1))
    assert np.any(centers(sent.cells()[0])[:, 2] < 1.0)
    for index in range(12):
        add(model, flat(1.51), 6 + index)
    due = incremental_update(model, sent, 1)
    assert len(due.removed) > 50
    assert np.all(centers(due.removed)[:, 2] < 1.1)
    sent.apply(due)
    assert not np.any(centers(sent.cells()[0])[:, 2] < 1.0)


@pytest.mark.parametrize(("levels", "sent_again"), [(10, False), (40, True)])
def test_live_a_cell_is_recolored_when_it_matters(levels: int, sent_again: bool) -> None:
    model, sent = evidence(flat(1.21), times=6), DecodedModel(CELL)
    sent.apply(incremental_update(model, sent, 1))
    sent.color[sent.occupied != 0] += np.int16(levels)
    due = incremental_update(model, sent, 1)
    assert (len(due.recolored) > 0.9 * sent.cell_count) is sent_again
    if sent_again:
        assert np.median(due.recolored_colors) == 100
    sent.apply(due)
    assert len(incremental_update(model, sent, 1).recolored) <= 0.1 * sent.cell_count


def test_live_updates_always_fit(rng: np.random.Generator) -> None:
    """Applying what was chosen never adds a cell twice nor removes one that is not there."""
    model, sent = EvidenceModel(CELL), DecodedModel(CELL)
    for index in range(12):
        depth = (flat(1.2) + rng.normal(0, 0.01, (48, 60)) + 0.3 * (index // 6)).astype(np.float32)
        depth[rng.random(depth.shape) < 0.1] = 0
        add(model, depth, index, int(rng.integers(40, 200)), Sensor.KINECT1)
        due = incremental_update(model, sent, 1)
        groups = [as_set(due.added), as_set(due.removed), as_set(due.recolored)]
        assert sum(map(len, groups)) == len(set().union(*groups))
        for cells in (due.added, due.removed, due.recolored):
            assert np.all(np.diff(morton_keys(cells)) > 0)
        sent.apply(due)
    assert sent.cell_count == np.count_nonzero(sent.occupied[: sent.index.count]) > 0
    assert sent.occupied.shape[1] == BLOCK_CELLS


def test_cells_of_a_region_are_first_seen_together() -> None:
    cells = np.array([[0, 0, 0], [15, 15, 15], [16, 0, 0], [-1, 0, 0]], dtype=np.int32)
    surface = Surface(
        cells=cells,
        colors=np.zeros((4, 3), np.int16),
        first_seen=np.array([7, 3, 9, EvidenceModel.NEVER], np.int32),
        subvoxel_offsets=np.zeros((4, 3), np.float32),
    )
    assert grouped_by_region(surface).first_seen.tolist() == [3, 3, 9, EvidenceModel.NEVER]
