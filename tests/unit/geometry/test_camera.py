# SPDX-License-Identifier: MIT
"""Cameras: projection, distortion, resizing, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threedvc.errors import ConfigError
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import identity, make_pose, rotation_from_vector

PLAIN = Camera(width=640, height=480, fx=525.0, fy=520.0, cx=319.5, cy=239.5)
# Published calibrations of hand-held depth cameras bend pictures by as much as this.
BENT = replace(PLAIN, distortion=(0.2312, -0.7849, -0.0033, -0.0001, 0.9172))
BARREL = replace(PLAIN, fx=400.0, fy=400.0, distortion=(-0.28, 0.07, 0.0005, -0.0003, 0.0))
CAMERAS = pytest.mark.parametrize("camera", [PLAIN, BENT, BARREL], ids=["plain", "kinect", "barrel"])


def matrix(camera: Camera) -> np.ndarray:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])


@CAMERAS
def test_projection_is_that_of_opencv(camera: Camera, rng: np.random.Generator) -> None:
    points = rng.uniform((-0.5, -0.4, 1.0), (0.5, 0.4, 3.0), (200, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix(camera), np.array(camera.distortion))
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)


@CAMERAS
def test_rays_lead_back_to_their_pixels(camera: Camera) -> None:
    rays = camera.rays()
    assert rays.shape == (480, 640, 2)
    pixels = camera.project(np.concatenate([rays, np.ones((480, 640, 1))], axis=-1) * 2.5)
    v, u = np.mgrid[0:480, 0:640]
    np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-3)


@CAMERAS
def test_pixels_between_centers(camera: Camera, rng: np.random.Generator) -> None:
    pixels = rng.uniform((100, 80), (540, 400), (3, 5, 2))
    slopes = camera.unproject_pixels(pixels)
    assert slopes.shape == (3, 5, 2)
    np.testing.assert_allclose(camera.project(np.concatenate([slopes, np.ones((3, 5, 1))], axis=-1)), pixels, atol=1e-6)


def test_the_first_pixel_center_is_the_origin() -> None:
    camera = Camera(width=3, height=2, fx=2.0, fy=4.0, cx=1.0, cy=0.5)
    np.testing.assert_array_equal(camera.rays()[0, 0], [-0.5, -0.125])
    np.testing.assert_array_equal(camera.project(np.array([0.0, 0.0, 7.0])), [1.0, 0.5])


@given(st.integers(1, 2000), st.integers(1, 2000))
def test_resizing_keeps_the_field_of_view(width: int, height: int) -> None:
    resized = BENT.resized(width, height)
    assert (resized.width, resized.height) == (width, height)
    # The outer corners of the corner pixels.
    for camera in (BENT, resized):
        corners = np.array([[-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5]])
        linear = (corners - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        np.testing.assert_allclose(linear, [[-320 / 525, -240 / 520], [320 / 525, 240 / 520]], atol=1e-9)
    assert resized.distortion == BENT.distortion


def test_resizing_to_its_own_size_changes_nothing() -> None:
    assert BENT.resized(640, 480) == BENT


def test_parameters_for_kernels() -> None:
    assert BENT.parameters().tolist() == [525.0, 520.0, 319.5, 239.5, *BENT.distortion]
    assert (PLAIN.distorted, BENT.distorted) == (False, True)


@pytest.mark.parametrize("changes", [{"width": 0}, {"height": -1}, {"width": 16385}])
def test_impossible_sizes(changes: dict[str, int]) -> None:
    with pytest.raises(ConfigError, match=r"picture size -?\d+x-?\d+ is not within 1..16384 pixels"):
        replace(PLAIN, **changes)


@pytest.mark.parametrize(
    "changes", [{"fx": 0.0}, {"fy": -1.0}, {"cx": np.nan}, {"cy": np.inf}, {"distortion": (np.nan, 0.0, 0.0, 0.0, 0.0)}]
)
def test_impossible_intrinsics(changes: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="must be finite, focal lengths positive"):
        replace(PLAIN, **changes)


@pytest.mark.parametrize("count", [0, 4, 8])
def test_distortion_has_five_coefficients(count: int) -> None:
    with pytest.raises(ConfigError, match=f"distortion needs 5 coefficients k1 k2 p1 p2 k3, got {count}"):
        replace(PLAIN, distortion=(0.0,) * count)


def test_a_registered_rig_has_one_camera() -> None:
    rig = CameraRig.registered_to(BENT)
    assert rig.registered
    assert rig.color == rig.depth == BENT
    assert rig.resized(320, 240).registered
    shifted = make_pose(np.eye(3), np.array([0.025, 0.0, 0.0]))
    assert not CameraRig(color=BENT, depth=BENT, T_color_depth=shifted).registered
    assert not CameraRig(color=BENT, depth=PLAIN, T_color_depth=identity()).registered


def test_resizing_a_rig_keeps_the_extrinsic() -> None:
    shifted = make_pose(rotation_from_vector(np.array([0.01, 0, 0])), np.array([0.025, 0.0, 0.0]))
    rig = CameraRig(color=BENT, depth=PLAIN.resized(320, 240), T_color_depth=shifted).resized(160, 100)
    assert (rig.color, rig.depth) == (BENT.resized(160, 100), PLAIN.resized(160, 100))
    np.testing.assert_array_equal(rig.T_color_depth, shifted)


def test_an_extrinsic_must_be_rigid() -> None:
    with pytest.raises(ConfigError, match="T_color_depth is not a rigid transform; give a 4x4 matrix"):
        CameraRig(color=PLAIN, depth=PLAIN, T_color_depth=np.diag([2.0, 1.0, 1.0, 1.0]))
