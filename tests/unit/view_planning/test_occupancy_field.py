# SPDX-License-Identifier: MIT
"""What depth pictures tell about the cells of a box."""

from __future__ import annotations

import numpy as np
import pytest

from reference.exploration import observed
from threedvc.config import Sensor
from threedvc.encoder.fusion.integration import free_space_log_odds
from threedvc.frames.sensor_model import SENSORS
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, identity, make_pose, rotation_from_vector
from threedvc.view_planning.occupancy_field import MAX_CELLS, OccupancyField, widened

CAMERA = Camera(width=24, height=18, fx=20.0, fy=21.0, cx=11.0, cy=9.0)
KINECT = SENSORS[Sensor.KINECT1]
EVERYTHING = np.ones((18, 24), dtype=bool)


def field_of(cell_m: float = 0.1, threads: int = 1) -> OccupancyField:
    """Return a box of 2 x 2 x 3 meters before a camera at the origin."""
    return OccupancyField(
        np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 3.0]), finest_m=cell_m, half_m=0.5, threads=threads
    )


def wall(depth_m: float) -> np.ndarray:
    return np.full((18, 24), depth_m, dtype=np.float32)


def tilted(rng: np.random.Generator) -> Pose:
    return make_pose(rotation_from_vector(rng.normal(0, 0.3, 3)), rng.normal(0, 0.2, 3))


def middle(field: OccupancyField, depth_m: float) -> float:
    """Return the log-odds on the optical axis."""
    cell = np.floor((np.array([0.01, 0.01, depth_m]) - field.origin_m) / field.cell_m).astype(int)
    return float(field.log_odds[tuple(cell)])


def test_nothing_seen_is_one_bit_per_cell() -> None:
    field = field_of()
    assert field.log_odds.shape == (20, 20, 30)
    assert field.bits == pytest.approx(20 * 20 * 30)


@pytest.mark.parametrize("sensor", [Sensor.IDEAL, Sensor.KINECT1, Sensor.LIDAR])
def test_equals_the_slow_sum(rng: np.random.Generator, sensor: Sensor) -> None:
    field = field_of(0.2)
    field.log_odds[...] = rng.normal(0, 1, field.log_odds.shape)
    depth = rng.choice([0, 0.4, 1.5, 2.3], (18, 24)).astype(np.float32)
    depth[:6] = np.linspace(1, 2, 24)
    mask, pose = rng.random((18, 24)) < 0.7, tilted(rng)
    change = observed(field, depth, mask, CAMERA, pose, SENSORS[sensor])
    expected = np.clip(field.log_odds + change, -8, 8)
    field.observe(depth, mask, CAMERA, pose, SENSORS[sensor])
    assert np.count_nonzero(change) > 50
    assert np.abs(field.log_odds - expected).max() < 1e-4


def test_pictures_that_are_not_contiguous(rng: np.random.Generator) -> None:
    wide = rng.uniform(1, 2, (18, 48)).astype(np.float32)
    one, other = field_of(), field_of()
    one.observe(wide[:, ::2], EVERYTHING, CAMERA, identity(), KINECT)
    other.observe(np.ascontiguousarray(wide[:, ::2]), EVERYTHING, CAMERA, identity(), KINECT)
    assert np.array_equal(one.log_odds, other.log_odds)


def test_threads_do_not_matter(rng: np.random.Generator) -> None:
    depth, pose = rng.uniform(1, 2, (18, 24)).astype(np.float32), tilted(rng)
    fields = [field_of(threads=threads) for threads in (1, 3)]
    for field in fields:
        field.observe(depth, EVERYTHING, CAMERA, pose, KINECT)
    assert np.array_equal(fields[0].log_odds, fields[1].log_odds)


def test_free_before_a_surface_occupied_at_it_unknown_behind() -> None:
    field = field_of()
    field.observe(wall(1.95), EVERYTHING, CAMERA, identity(), KINECT)
    assert middle(field, 1.0) == pytest.approx(free_space_log_odds(KINECT))
    assert middle(field, 1.95) > 1
    assert middle(field, 2.8) == 0
    assert field.log_odds[0, 0, 1] == 0


def test_no_measurement_tells_nothing() -> None:
    field = field_of()
    field.observe(wall(0), EVERYTHING, CAMERA, identity(), KINECT)
    assert not field.log_odds.any()


def test_something_else_tells_only_what_lies_before_it() -> None:
    field = field_of()
    field.observe(wall(1.95), ~EVERYTHING, CAMERA, identity(), KINECT)
    assert middle(field, 1.0) < -1
    assert middle(field, 1.95) == 0


def test_a_second_look_makes_sure() -> None:
    field = field_of()
    bits = [field.bits]
    for _ in range(3):
        field.observe(wall(1.95), EVERYTHING, CAMERA, identity(), KINECT)
        bits.append(field.bits)
    assert bits == sorted(bits, reverse=True)
    assert bits[0] - bits[1] > 2 * (bits[1] - bits[2])


def test_far_and_slanted_surfaces_stay_uncertain() -> None:
    near, far, slanted = field_of(0.05), field_of(0.05), field_of(0.05)
    near.observe(wall(0.975), EVERYTHING, CAMERA, identity(), KINECT)
    far.observe(wall(2.975), EVERYTHING, CAMERA, identity(), SENSORS[Sensor.REALSENSE])
    assert near.log_odds.max() > far.log_odds.max()
    slope = CAMERA.rays()[..., 0]
    depth = (1 / np.maximum(1 - 2.5 * slope, 0.4)).astype(np.float32)
    slanted.observe(depth, EVERYTHING, CAMERA, identity(), KINECT)
    assert near.log_odds.max() > slanted.log_odds.max()


def test_rays_pass_what_is_free_and_stop_at_what_is_occupied() -> None:
    field = field_of()
    field.log_odds[0], field.log_odds[1], field.log_odds[2] = -8, 3, 0
    opacity = field.opacity()
    assert opacity[0].max() < 0.01
    assert opacity[1].min() > 1e5
    assert opacity[2, 0, 0] == pytest.approx(1 / 0.5)


def test_what_the_stream_holds_is_occupied_but_not_sure() -> None:
    field = field_of()
    places = np.array([[0.01, 0.01, 1.0], [50, 0, 0]])
    field.hold_occupied(places)
    assert np.count_nonzero(field.occupied) == 1
    assert field.entropy().min() > 0.5


def test_where_a_camera_was_is_free() -> None:
    field = field_of()
    field.hold_free(np.array([0.0, 0.0, 0.0]), 0.3, KINECT)
    free = field.centers(np.flatnonzero(field.free))
    assert 20 < len(free) < 100
    assert np.linalg.norm(free, axis=1).max() < 0.3 + 0.1 * np.sqrt(3)


def test_cells_and_their_centers() -> None:
    field = field_of()
    numbers = np.array([0, 77, 5000, 11999])
    assert np.array_equal(field.cells_at(field.centers(numbers)), numbers)
    assert np.array_equal(field.cells_at(np.repeat(field.centers(numbers), 2, axis=0)), numbers)
    view = field.cells_from(identity())
    assert np.allclose(view[:, :3] @ [0.5, 0.5, 1.0] + view[:, 3], [15, 15, 10])


def test_border_lies_between_known_and_unknown() -> None:
    field = field_of()
    field.log_odds[:10] = -3
    field.log_odds[10, :5] = 3
    cells = np.stack(np.unravel_index(field.border(), field.log_odds.shape), axis=1)
    assert set(cells[:, 0]) == {10}
    assert len(cells) == 15 * 30


@pytest.mark.parametrize("extent", [(1.0, 1.0, 1.0), (1e6, 0.01, 0.01), (1e5, 1e5, 1e5), (0.0, 0.0, 0.0)])
def test_memory_is_bounded(extent: tuple[float, float, float]) -> None:
    field = OccupancyField(np.zeros(3), np.array(extent), finest_m=0.01, half_m=1.0)
    assert 0 < field.log_odds.size <= MAX_CELLS
    assert np.all(np.array(field.log_odds.shape) * field.cell_m >= np.array(extent) * (1 - 1e-6))


def test_widened_is_a_box_around_each_cell() -> None:
    cells = np.zeros((9, 9, 9), dtype=bool)
    cells[4, 4, 4] = cells[0, 0, 0] = True
    wide = widened(cells, 2)
    assert np.count_nonzero(wide) == 5**3 + 3**3 - 1
    assert wide[2:7, 2:7, 2:7].all()
    assert widened(cells, 100).all()
    assert np.array_equal(widened(cells, 0), cells)
