# SPDX-License-Identifier: MIT
"""Depth maps moved to where the camera is next."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, identity, make_pose, rotation_from_vector
from threedvc.render.moved_depth import MovedDepth

PLAIN = Camera(width=40, height=30, fx=36.0, fy=35.0, cx=19.5, cy=14.5)
LENS = Camera(width=40, height=30, fx=36.0, fy=35.0, cx=19.5, cy=14.5, distortion=(-0.1, 0.02, 0.001, -0.002, 0.0))


def plane_before(camera: Camera, T_camera_scene: Pose) -> NDArray[np.uint16]:
    """Raw depths in tenths of a millimeter of the plane z = 2 + 0.2 x of the scene."""
    normal, offset = np.array([-0.2, 0.0, 1.0]), 2.0
    rotation, t = T_camera_scene[:3, :3], T_camera_scene[:3, 3]
    turned = rotation @ normal
    rays = np.concatenate([camera.rays(), np.ones((camera.height, camera.width, 1))], axis=-1)
    return np.rint(10000 * (offset + turned @ t) / (rays @ turned)).astype(np.uint16)


@pytest.mark.parametrize("camera", [PLAIN, LENS], ids=["plain", "lens"])
def test_a_plane_is_foretold(camera: Camera) -> None:
    poses = [identity(), make_pose(rotation_from_vector(np.array([0.01, -0.03, 0.02])), np.array([0.03, -0.02, 0.05]))]
    moved = MovedDepth(camera, poses, 10000.0)
    before, truth = plane_before(camera, poses[0]), plane_before(camera, poses[1])
    assert moved(0, None) is None
    found = moved(1, before)
    assert found is not None
    known = found > 0
    assert known.mean() > 0.85
    assert np.abs(found.astype(int) - truth)[known].max() <= 4


def test_frames_are_averaged_and_jumps_are_not() -> None:
    moved = MovedDepth(PLAIN, [identity()] * 3, 1000.0)
    first = np.full((30, 40), 1000, dtype=np.uint16)
    second = first + 10
    second[:, :10] = 2000
    second[5] = 0
    moved(1, first)
    found = moved(2, second)
    assert found is not None
    inner = found[10:-2, 12:-2]
    assert (inner == 1005).all()
    assert (found[10:-2, 1:8] == 2000).all()
    assert found[5, 20] in (0, 1005)


def test_threads_change_nothing_and_what_lies_behind_is_unknown() -> None:
    poses = [identity(), make_pose(np.eye(3), np.array([0.0, 0.0, -5.0]))]
    depth = np.full((30, 40), 1000, dtype=np.uint16)
    assert not MovedDepth(PLAIN, poses, 1000.0)(1, depth).any()  # type: ignore[union-attr]
    random = np.random.default_rng(0).integers(0, 3000, depth.shape).astype(np.uint16)
    turn = [identity(), make_pose(rotation_from_vector(np.array([0.0, 0.1, 0.0])), np.zeros(3))]
    one, two = (MovedDepth(PLAIN, turn, 1000.0, threads)(1, random) for threads in (1, 2))
    assert np.array_equal(one, two)  # type: ignore[arg-type]
