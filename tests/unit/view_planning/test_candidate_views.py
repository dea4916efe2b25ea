# SPDX-License-Identifier: MIT
"""Places and directions to record from."""

from __future__ import annotations

import numpy as np
import pytest

from reference.exploration import flooded
from threedvc.geometry.pose import identity, is_rigid
from threedvc.kernels.encoder.exploration import flood_cells
from threedvc.view_planning.candidate_views import look_along, reachable_places, reachable_views, upward, views_around
from threedvc.view_planning.occupancy_field import OccupancyField

UP = np.array([0.0, 0.0, 1.0])


def rooms(door: bool) -> OccupancyField:
    """Return two free rooms of 2 x 2 x 2 m on either side of a wall, which has a door or none."""
    field = OccupancyField(np.zeros(3), np.array([4.2, 2.0, 2.0]), finest_m=0.1, half_m=0.5)
    field.log_odds[...] = -4
    field.log_odds[20:22] = 4
    if door:
        field.log_odds[20:22, 6:14, 3:17] = -4
    return field


def camera_at(x: float, y: float, z: float) -> np.ndarray:
    return look_along(np.array([x, y, z]), np.array([1.0, 0.0, 0.0]), UP)[None]


@pytest.mark.parametrize("way", [(1, 0, 0), (0.6, 0, 0.8), (0, 0, 1), (0, 0, -1)])
def test_look_along(way: tuple[float, float, float]) -> None:
    pose = look_along(np.array([1.0, 2.0, 3.0]), np.array(way, dtype=float), UP)
    assert is_rigid(pose)
    assert np.allclose(pose[:3, 3], [1, 2, 3])
    assert np.allclose(pose[:3, 2], way)
    assert pose[2, 0] == pytest.approx(0, abs=1e-9) or abs(way[2]) == 1
    assert pose[2, 1] <= 1e-9


def test_upward_is_what_pictures_show_so() -> None:
    views = np.concatenate([camera_at(0, 0, 0), look_along(np.zeros(3), np.array([0, 1.0, 0]), UP)[None]])
    assert np.allclose(upward(views), UP)
    assert np.allclose(upward(np.stack([identity(), np.diag([-1.0, -1.0, 1.0, 1.0])])), [0, 1, 0])


def test_views_around_see_a_point_from_everywhere() -> None:
    center = np.array([1.0, -2.0, 0.5])
    views = views_around(center, 0.8, UP, 60)
    assert all(is_rigid(view) for view in views)
    assert np.allclose(views[:, :3, 3] + 0.8 * views[:, :3, 2], center)
    angles = np.arccos(np.clip(views[:, :3, 2] @ views[:, :3, 2].T, -1, 1)) + 9 * np.eye(60)
    assert angles.min(axis=1).max() < 2.5 * angles.min()


@pytest.mark.parametrize("density", [0.2, 0.5, 0.9])
def test_flood_equals_the_slow_one(rng: np.random.Generator, density: float) -> None:
    passable = rng.random((7, 9, 5)) < density
    starts = rng.random(passable.shape) < 0.02
    numbers = np.flatnonzero(starts)
    queue, reached = np.zeros(passable.size, dtype=np.int64), starts.astype(np.uint8)
    queue[: len(numbers)] = numbers
    count = flood_cells(passable, queue, len(numbers), reached)
    expected = flooded(passable, starts)
    assert np.array_equal(reached != 0, expected)
    assert np.array_equal(np.sort(queue[:count]), np.flatnonzero(expected))


@pytest.mark.parametrize("door", [True, False])
def test_a_camera_goes_through_doors_alone(door: bool) -> None:
    places = reachable_places(rooms(door), np.array([[1.0, 1.0, 1.0]]), 0.2)
    assert (places[:, 0].max() > 3.5) == door
    away = places[(places[:, 0] < 1.9) | (places[:, 0] > 2.3)]
    assert len(away) > 1000


def test_places_keep_away_from_what_is_occupied() -> None:
    places = reachable_places(rooms(False), np.array([[1.0, 1.0, 1.0]]), 0.3)
    assert places[:, 0].max() < 2.0 - 0.3 + 1e-9


def test_where_nothing_is_free_remains_where_the_camera_was() -> None:
    field = OccupancyField(np.zeros(3), np.ones(3), finest_m=0.1, half_m=0.5)
    recorded = np.array([[0.5, 0.5, 0.5], [9.0, 9.0, 9.0]])
    assert np.array_equal(reachable_places(field, recorded, 0.2), recorded)
    views = reachable_views(field, np.concatenate([camera_at(0.5, 0.5, 0.5)] * 3), 0.2, 40)
    assert np.allclose(views[:, :3, 3], 0.5)


def test_views_are_upright_varied_and_the_same_every_time() -> None:
    field = rooms(True)
    field.log_odds[:, :, 15:] = 0
    views = reachable_views(field, camera_at(1, 1, 1), 0.2, 100)
    assert all(is_rigid(view) for view in views)
    assert np.allclose(views[:, 2, 0], 0, atol=1e-9)
    ways = views[:, :3, 2]
    assert np.linalg.norm(ways.mean(axis=0)) < 0.7
    assert ways[::2, 2].mean() > ways[1::2, 2].mean() + 0.2
    assert np.array_equal(views, reachable_views(field, camera_at(1, 1, 1), 0.2, 100))
