# SPDX-License-Identifier: MIT
"""The evidence as a camera sees it: depth, normals and luma of simple shapes."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.config import FusionConfig, Sensor
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import fuse, observe
from threedvc.encoder.registration.frame_resolutions import TRACKING_PIXELS, Downsampled, FrameResolutions
from threedvc.encoder.registration.model_view import raycast_model
from threedvc.frames.frame import Frame
from threedvc.frames.sensor_model import SENSORS
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, identity, make_pose, rotation_from_vector

CAMERA = Camera(width=60, height=48, fx=60.0, fy=60.0, cx=29.5, cy=23.5)
RIG = CameraRig.registered_to(CAMERA)
CELL = 0.02
Depth = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def wall(slopes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the depth of the plane z = 1.2 + 0.3 x."""
    return 1.2 / (1 - 0.3 * slopes[..., 0])


def ball(slopes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the depth of a ball of 0.4 m around (0, 0, 1.3), 0 beside it."""
    a = (slopes**2).sum(axis=-1) + 1
    root = 1.3**2 - a * (1.3**2 - 0.4**2)
    return np.where(root > 0, (1.3 - np.sqrt(np.maximum(root, 0))) / a, 0)


def model_of(shape: Depth, views: int = 3, color: NDArray[np.uint8] | None = None) -> EvidenceModel:
    model = EvidenceModel(CELL)
    depth = shape(CAMERA.rays()).astype(np.float32)
    picture = np.full((48, 60, 3), 100, dtype=np.uint8) if color is None else color
    for index in range(views):
        frame = Frame(index=index, timestamp_ns=index, color=picture, depth=depth)
        fuse(model, observe(frame, RIG, CAMERA.rays()), depth > 0, identity(), SENSORS[Sensor.IDEAL], FusionConfig(), 1)
    return model


def moved(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> Pose:
    return make_pose(rotation_from_vector(np.array(turn)), np.array(shift))


def test_a_wall_is_seen_where_it_is() -> None:
    view = raycast_model(model_of(wall), Downsampled(RIG), identity(), 1)
    known = view.depth > 0
    inner = np.s_[6:-6, 6:-6]
    assert known[inner].mean() > 0.95
    error = np.abs(view.depth - wall(CAMERA.rays()))[known]
    assert np.quantile(error, 0.99) < 0.2 * CELL
    assert error.max() < 0.5 * CELL
    expected = np.array([0.3, 0, -1]) / np.sqrt(1.09)
    facing = view.normals[known] @ expected
    assert np.median(facing) > 0.999
    assert np.quantile(facing, 0.02) > 0.98
    np.testing.assert_allclose(view.intensity[known], 100, atol=0.5)


def test_a_wall_is_seen_from_elsewhere() -> None:
    T = moved((0.05, -0.15, 0.2), (0.1, 0.05, 0.2))
    view = raycast_model(model_of(wall), Downsampled(RIG), T, 1)
    v, u = np.nonzero(view.depth)
    assert len(v) > 1000
    points = np.column_stack([CAMERA.rays()[v, u], np.ones(len(v))]) * view.depth[v, u][:, None]
    there = (points - T[:3, 3]) @ T[:3, :3]
    assert np.abs(there[:, 2] - 1.2 - 0.3 * there[:, 0]).max() < 0.4 * CELL
    expected = T[:3, :3] @ (np.array([0.3, 0, -1]) / np.sqrt(1.09))
    np.testing.assert_allclose(view.normals[v, u] @ expected, 1, atol=0.03)


def test_a_ball_is_round() -> None:
    view = raycast_model(model_of(ball), Downsampled(RIG), identity(), 1)
    known = view.depth > 0
    assert np.count_nonzero(known) > 0.4 * np.count_nonzero(ball(CAMERA.rays()))
    points = np.concatenate([CAMERA.rays(), np.ones((48, 60, 1))], axis=-1)[known] * view.depth[known][:, None]
    outward = points - [0, 0, 1.3]
    assert np.abs(np.linalg.norm(outward, axis=1) - 0.4).max() < 0.6 * CELL
    facing = (view.normals[known] * outward).sum(axis=1) / np.linalg.norm(outward, axis=1)
    assert np.median(facing) > 0.99


def table(slopes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth of a plane seen at an angle of 27 degrees."""
    return np.asarray(1.2 / (1 + 2 * slopes[..., 1]) * (slopes[..., 1] > -0.3))


def test_what_is_seen_at_a_flat_angle_once_is_in_the_view() -> None:
    view, expected = (
        raycast_model(model_of(table, views=1), Downsampled(RIG, flat=True), identity(), 1),
        table(CAMERA.rays()),
    )
    known, inner = view.depth > 0, cv2.erode((expected > 0).astype(np.uint8), np.ones((7, 7))) > 0
    assert np.count_nonzero(known & inner) > 0.8 * np.count_nonzero(inner)
    assert np.quantile(np.abs(view.depth - expected)[known & inner], 0.99) < CELL
    normal = np.array([0, -2, -1]) / np.sqrt(5)
    assert np.median(view.normals[known & inner] @ normal) > 0.97


def test_normals_are_of_unit_length_and_face_the_camera() -> None:
    view = raycast_model(model_of(ball), Downsampled(RIG), moved((0, 0.3, 0), (-0.3, 0, 0.1)), 1)
    known = view.depth > 0
    np.testing.assert_allclose(np.linalg.norm(view.normals[known], axis=1), 1, atol=1e-5)
    rays = np.concatenate([CAMERA.rays(), np.ones((48, 60, 1))], axis=-1)[known]
    assert np.all((view.normals[known] * rays).sum(axis=1) < 0)
    assert not view.normals[~known].any()


def test_the_back_of_a_surface_is_not_seen() -> None:
    behind = moved((0, np.pi, 0), (0, 0, 2.5))
    assert not raycast_model(model_of(wall), Downsampled(RIG), behind, 1).depth.any()


@pytest.mark.parametrize(
    "pose", [moved((0, np.pi, 0), (0, 0, 0)), moved((0, 0, 0), (50, 0, 0))], ids=["turned", "away"]
)
def test_nothing_in_sight(pose: Pose) -> None:
    view = raycast_model(model_of(wall), Downsampled(RIG), pose, 1)
    assert not view.depth.any()
    assert not raycast_model(EvidenceModel(CELL), Downsampled(RIG), identity(), 1).depth.any()


def test_luma_of_the_picture_comes_back() -> None:
    ramp = np.tile((40 + 3 * np.arange(60, dtype=np.uint8))[None, :, None], (48, 1, 3))
    view = raycast_model(model_of(wall, color=ramp), Downsampled(RIG), identity(), 1)
    known = view.depth > 0
    np.testing.assert_allclose(view.intensity[known], ramp[..., 0][known], atol=4)


def test_threads_do_not_matter() -> None:
    model, downsampled = model_of(ball), Downsampled(RIG)
    one, three = (raycast_model(model, downsampled, moved((0.1, 0.2, 0), (0, 0, 0.1)), threads) for threads in (1, 3))
    for name in ("depth", "normals", "intensity"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


def test_small_pictures_are_taken_whole() -> None:
    downsampled = Downsampled(RIG)
    assert (downsampled.stride, downsampled.camera) == (1, CAMERA)


@pytest.mark.parametrize("size", [(640, 480), (641, 479), (1920, 1080)])
def test_large_pictures_are_downsampled_to_rays_of_their_own(size: tuple[int, int]) -> None:
    camera = Camera(width=size[0], height=size[1], fx=500.0, fy=510.0, cx=300.0, cy=200.0, distortion=(0.1, 0, 0, 0, 0))
    downsampled = Downsampled(CameraRig.registered_to(camera))
    n = downsampled.stride
    assert n > 1
    assert downsampled.camera.width * downsampled.camera.height <= 1.02 * TRACKING_PIXELS
    picture = np.zeros((size[1], size[0]), dtype=np.float32)
    assert downsampled.downsample(picture).shape == (downsampled.camera.height, downsampled.camera.width)
    np.testing.assert_allclose(downsampled.camera.rays(), camera.rays()[::n, ::n], atol=1e-9)


def test_small_objects_are_seen_at_every_pixel_and_large_ones_at_some() -> None:
    camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    rig = CameraRig.registered_to(camera)
    color = np.zeros((480, 640, 3), dtype=np.uint8)
    color[100:200, 100:200] = 200
    frame = Frame(index=0, timestamp_ns=0, color=color, depth=np.ones((480, 640), dtype=np.float32))
    full, downsampled = Downsampled(rig, 1), Downsampled(rig)
    assert (full.stride, downsampled.stride > 1) == (1, True)
    views = FrameResolutions(frame, full, downsampled)
    small = np.zeros((480, 640), dtype=bool)
    small[100:150, 100:200] = True
    assert views.resolution(small) is full
    assert views.resolution(np.ones((480, 640), dtype=bool)) is downsampled
    for resolution in (full, downsampled):
        luma = views.luma(resolution)
        assert luma.shape == (resolution.camera.height, resolution.camera.width)
        assert luma.max() == pytest.approx(200)
        assert views.luma(resolution) is luma


def test_luma_of_a_color_camera_apart_is_looked_up_through_the_depth() -> None:
    color_camera = Camera(width=120, height=96, fx=120.0, fy=120.0, cx=59.5, cy=47.5, distortion=(0.1, 0, 0, 0, 0))
    rig = CameraRig(color=color_camera, depth=CAMERA, T_color_depth=moved((0, 0, 0), (0.1, 0, 0)))
    depth = np.full((48, 60), 1.5, dtype=np.float32)
    depth[10:14, 20:24] = 0
    # A shade that depends on the place on the wall alone.
    x = color_camera.rays()[..., 0] * 1.5 - 0.1
    shade = 120 + 60 * x
    color = np.repeat(np.rint(shade)[..., None], 3, axis=-1).astype(np.uint8)
    luma = Downsampled(rig).luma(Frame(index=0, timestamp_ns=0, color=color, depth=depth))
    expected = 120 + 60 * CAMERA.rays()[..., 0] * 1.5
    known = np.isfinite(luma)
    assert not known[10:14, 20:24].any()
    assert known[depth > 0].mean() > 0.8
    np.testing.assert_allclose(luma[known], expected[known], atol=1.5)


@pytest.mark.parametrize("shape", [wall, ball])
def test_a_sparse_view_is_about_the_same(shape: Depth) -> None:
    model = model_of(
        shape, color=np.repeat(np.arange(48 * 60, dtype=np.uint32).reshape(48, 60, 1) % 250, 3, 2).astype(np.uint8)
    )
    pose = moved((0.05, 0.1, 0), (-0.1, 0, 0.05))
    dense, sparse = (raycast_model(model, Downsampled(RIG, sparse=choice), pose, 1) for choice in (False, True))
    cast = np.zeros((48, 60), dtype=np.bool_)
    cast[::2, ::2] = True
    np.testing.assert_array_equal(sparse.depth[cast], dense.depth[cast])
    assert np.count_nonzero(sparse.depth) > 0.9 * np.count_nonzero(dense.depth)
    both = (dense.depth > 0) & (sparse.depth > 0)
    assert np.abs(sparse.depth - dense.depth)[both].max() < 0.5 * CELL
    assert np.quantile((sparse.normals * dense.normals).sum(axis=2)[both], 0.05) > 0.97
    np.testing.assert_allclose(np.linalg.norm(sparse.normals[both], axis=1), 1, atol=1e-5)


def test_large_views_are_sparse_unless_it_is_said_otherwise() -> None:
    large = CameraRig.registered_to(CAMERA.resized(320, 240))
    assert len(Downsampled(large).even) < len(Downsampled(large).grid.slopes) / 3
    assert len(Downsampled(large, sparse=False).even) == 320 * 240
    assert len(Downsampled(RIG).even) == 48 * 60


def test_an_exact_view_is_not_sparse() -> None:
    model, resolution = model_of(ball), Downsampled(RIG, sparse=True)
    exact, dense = (
        raycast_model(model, resolution, identity(), 1, exact=True),
        raycast_model(model, Downsampled(RIG), identity(), 1),
    )
    np.testing.assert_array_equal(exact.depth, dense.depth)
    np.testing.assert_array_equal(exact.normals, dense.normals)
