# SPDX-License-Identifier: MIT
"""What frames saw through: counts against a slow reference, surfaces, labels of all pixels."""

from __future__ import annotations

import numpy as np
import pytest

from threedvc.config import Sensor
from threedvc.encoder.segmentation.motion.free_space import DepthHistory
from threedvc.frames.sensor_model import SENSORS
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, identity, make_pose, rotation_from_vector
from threedvc.kernels.encoder.free_space import connect_surfaces, spread_labels

CAMERA = Camera(width=32, height=24, fx=40.0, fy=40.0, cx=15.5, cy=11.5)
ALL = np.ones((24, 32), dtype=np.bool_)
BOX = (slice(8, 16), slice(10, 20))


def wall(box_m: float | None = None, wall_m: float = 2.0) -> np.ndarray:
    depth = np.full((24, 32), wall_m, dtype=np.float32)
    if box_m is not None:
        depth[BOX] = box_m
    return depth


def history(*pictures: np.ndarray) -> DepthHistory:
    kept = DepthHistory(CAMERA, SENSORS[Sensor.IDEAL], 1)
    for index, picture in enumerate(pictures):
        kept.keep(index, picture)
    return kept


def resting(_: int) -> Pose:
    return identity()


def test_a_box_that_came_was_seen_through() -> None:
    through, on = history(wall(), wall(), wall(1.2)).count_free_space_votes(
        wall(1.2), ALL, identity(), [0, 1, 2], resting
    )
    expected = np.zeros((24, 32))
    expected[BOX] = 2
    np.testing.assert_array_equal(through, expected)
    assert (on[BOX] == 1).all()
    assert (on[:4] == 3).all()


def test_what_is_farther_than_before_was_hidden_not_seen_through() -> None:
    through, on = history(wall(1.2)).count_free_space_votes(wall(), ALL, identity(), [0], resting)
    assert not through.any()
    assert not on[10:14, 12:18].any()


@pytest.mark.parametrize("turn", [0.0, 0.1])
def test_a_wall_seen_by_a_moving_camera_stands_still(turn: float) -> None:
    T = make_pose(rotation_from_vector(np.array([0.0, turn, 0.0])), np.array([0.05, 0.0, -0.1]))
    rays = CAMERA.rays()
    rotation, shift = T[:3, :3], T[:3, 3]
    # Depth of the plane z = 2 in the first frame's camera, seen from the moved one.
    normal = rotation[:, 2]
    distance = 2.0 + normal @ shift
    moved = (distance / (np.dstack([rays, np.ones((24, 32))]) @ normal)).astype(np.float32)
    poses = [identity(), T]
    through, on = history(wall()).count_free_space_votes(moved, ALL, T, [0], lambda k: poses[k])
    assert not through.any()
    assert np.count_nonzero(on) > 300


def test_what_moves_with_the_camera_is_seen_through_in_the_room_alone() -> None:
    shifted = make_pose(np.eye(3), np.array([0.0, 0.0, -0.3]))
    kept = history(wall(1.2))
    nearer = np.where(wall(1.2) < 1.5, np.float32(0.9), np.float32(2.0))
    inside = ALL & (nearer < 1)
    assert kept.count_free_space_votes(nearer, inside, identity(), [0], resting)[0][BOX].all()
    own = [identity(), shifted]
    assert not kept.count_free_space_votes(nearer, inside, shifted, [0], lambda k: own[k], whole=False)[0].any()


def test_unknown_and_forgotten_frames_tell_nothing() -> None:
    kept = history(np.zeros((24, 32), np.float32), wall())
    assert not kept.count_free_space_votes(wall(1.2), ALL, identity(), [0, 7], resting)[0].any()
    kept.forget(1)
    kept.forget(1)
    assert not kept.count_free_space_votes(wall(1.2), ALL, identity(), [1], resting)[0].any()
    assert not history(wall()).count_free_space_votes(wall(1.2), ALL, identity(), [0], lambda _: None)[0].any()


def test_surfaces_end_where_depth_jumps() -> None:
    depth, groups = wall(1.2), np.zeros((24, 32), np.int32)
    depth[0, 0] = 0
    assert connect_surfaces(depth, ALL, 0.03, groups, np.empty(depth.size, np.int32)) == 2
    assert groups[0, 0] == 0
    assert len(np.unique(groups[BOX])) == 1
    assert groups[BOX][0, 0] != groups[20, 3]


def test_labels_of_all_pixels_follow_the_depth() -> None:
    depth = wall(1.2)
    depth[9, 11] = 0
    coarse = np.where(depth[::2, ::2] == 1.2, np.uint8(3), np.uint8(0)).astype(np.uint8)
    small = np.ascontiguousarray(depth[::2, ::2])
    labels = np.empty(depth.shape, np.uint8)
    spread_labels(depth, 2, coarse, small, labels, 0, 24)
    expected = np.zeros((24, 32), np.uint8)
    expected[BOX] = 3
    known = depth > 0
    np.testing.assert_array_equal(labels[known], expected[known])


def test_any_number_of_frames_is_kept_and_forgotten() -> None:
    kept = history(*([wall(1.2)] * 300))
    for index in range(200):
        kept.forget(index)
    for index in range(300, 600):
        kept.keep(index, wall())
    through, on = kept.count_free_space_votes(wall(1.2), ALL, identity(), [0, 250, 299, 300, 599], resting)
    assert (through[BOX] == 2).all()
    assert (on[BOX] == 2).all()
    assert (on[:4] == 4).all()
