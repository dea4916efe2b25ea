# SPDX-License-Identifier: MIT
"""First-opacity ray casting of single objects against the slow reference and analytic shapes."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from reference.rendering import first_occupied, model_of_cells, model_of_shape, surface_cells
from threedvc.config import RenderConfig
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, compose, identity, inverse, make_pose, rotation_from_vector
from threedvc.model.decoded_model import DecodedModel
from threedvc.render.picture import Picture
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer

CELL = 0.02
RADIUS = 0.31
CAMERA = Camera(width=72, height=60, fx=80.0, fy=80.0, cx=35.5, cy=29.5)
BENT = replace(CAMERA, distortion=(-0.2, 0.05, 0.003, -0.002, 0.0))
AHEAD = make_pose(np.eye(3), np.array([0.0, 0.0, 1.2]))
Floats = NDArray[np.float64]


def ball(points: Floats) -> Floats:
    return np.linalg.norm(points, axis=-1) - RADIUS


def box(points: Floats) -> Floats:
    return np.abs(points).max(axis=-1) - 0.25


def tube(points: Floats) -> Floats:
    return np.abs(np.hypot(np.hypot(points[..., 0], points[..., 1]) - 0.28, points[..., 2])) - 0.09


def ready(model: DecodedModel) -> RenderModel:
    shown = RenderModel(model)
    shown.refresh(1)
    return shown


def drawn(shown: RenderModel, pose: Pose, camera: Camera = CAMERA) -> Picture:
    renderer = Renderer(CameraRig.registered_to(camera), RenderConfig(threads=1))
    return renderer.draw({5: shown}, {5: pose})


def turned(*vector: float, away: float = 1.2) -> Pose:
    return make_pose(rotation_from_vector(np.array(vector)), np.array([0.0, 0.0, away]))


def points_of(depth: NDArray[np.float32], camera: Camera, pose: Pose) -> Floats:
    """Return the drawn points (n, 3) in the object's frame."""
    v, u = np.nonzero(depth)
    points = np.column_stack([camera.rays()[v, u], np.ones(len(v))]) * depth[v, u][:, None]
    T = inverse(pose)
    moved: Floats = points @ T[:3, :3].T + T[:3, 3]
    return moved


def inside_of(depth: Floats, pixels: int = 2) -> NDArray[np.bool_]:
    """Return the pixels whose neighborhood is all hit and within the picture."""
    hit = cv2.copyMakeBorder((depth > 0).astype(np.uint8), *[pixels] * 4, cv2.BORDER_CONSTANT, value=0)
    return cv2.erode(hit, np.ones((2 * pixels + 1,) * 2, np.uint8))[pixels:-pixels, pixels:-pixels] > 0


VIEWS = {
    "straight": turned(0, 0, 0),
    "aslant": turned(0.5, -0.6, 0.2),
    "from behind": turned(0.1, 2.9, 0.0, away=0.9),
    "near": turned(-0.7, 0.4, 0.1, away=0.6),
    "far": turned(0.3, 1.1, -0.4, away=3.0),
}
SHAPES = {"ball": ball, "box": box, "tube": tube}


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["plain", "distorted"])
def test_rays_stop_at_the_first_occupied_cell(shape: str, view: str, camera: Camera) -> None:
    model, pose = model_of_shape(SHAPES[shape], CELL, 0.45), VIEWS[view]
    depth, away = drawn(ready(model), pose, camera).depth, pose[2, 3]
    expected = first_occupied(model, camera.rays().reshape(-1, 2), pose, max(away - 0.7, 0.05), away + 0.7).reshape(
        depth.shape
    )
    # Cells stick out of the surface by up to one of them.
    inner = inside_of(expected, 2 + int(CELL * CAMERA.fx / away))
    assert np.mean(depth[inner] > 0) > 0.995
    # Rays that graze the shell stop up to a few cells behind the corner of the first cell, and do not leak.
    assert np.mean((depth - expected)[inner] > 4 * CELL) < 0.03
    distance = np.abs(SHAPES[shape](points_of(depth, camera, pose))) / CELL
    assert np.quantile(distance, 0.98) < 1.0
    assert distance.max() < 3


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("shape", SHAPES)
def test_outlines_are_neither_fat_nor_lean(shape: str, view: str) -> None:
    pose = VIEWS[view]
    away = pose[2, 3]
    shown = drawn(ready(model_of_shape(SHAPES[shape], CELL, 0.45)), pose).depth > 0
    T = inverse(pose)
    directions = np.concatenate([CAMERA.rays(), np.ones((*shown.shape, 1))], axis=2)
    true = np.zeros_like(shown)
    for t in np.arange(max(away - 0.7, 0.05), away + 0.7, 0.1 * CELL):
        true |= SHAPES[shape]((directions * t) @ T[:3, :3].T + T[:3, 3]) < 0
    inner = cv2.erode(true.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    rim = np.count_nonzero(true & ~inner) * CELL * CAMERA.fx / away
    assert np.count_nonzero(shown & ~true) <= 0.2 * rim
    # Edges of boxes are a little beveled.
    assert np.count_nonzero(true & ~shown) <= (0.5 if shape == "box" else 0.2) * rim


@pytest.mark.parametrize("view", VIEWS)
def test_a_ball_is_round_to_a_fraction_of_a_cell(view: str) -> None:
    pose = VIEWS[view]
    depth = drawn(ready(model_of_shape(ball, CELL, 0.45)), pose).depth
    error = np.abs(ball(points_of(np.where(inside_of(depth), depth, 0), CAMERA, pose))) / CELL
    assert np.median(error) < 0.15
    assert np.quantile(error, 0.95) < 0.6


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.2, 0.0), (0.35, -0.25), (-0.9, 0.6)])
def test_a_plane_is_flat_to_a_fraction_of_a_cell(slope: tuple[float, float]) -> None:
    normal = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)

    def plane(points: Floats) -> Floats:
        return points @ normal - 0.0037

    depth = drawn(ready(model_of_shape(plane, CELL, 0.7)), AHEAD).depth
    middle = np.zeros_like(depth)
    middle[12:-12, 16:-16] = depth[12:-12, 16:-16]
    assert np.all(depth[12:-12, 16:-16] > 0)
    error = np.abs(plane(points_of(middle, CAMERA, AHEAD))) / CELL
    # The place of a plane along the grid's axis within its cell is not in the model; that of others is.
    assert np.median(error) < (0.5 if slope == (0, 0) else 0.2)
    assert error.max() < 0.8


@pytest.mark.parametrize("axis", range(3))
def test_a_shell_of_one_cell_has_no_holes(axis: int) -> None:
    side = np.arange(-30, 31)
    first, second = np.meshgrid(side, side)
    cells = np.insert(np.stack([first.ravel(), second.ravel()], axis=1), axis, 3, axis=1).astype(np.int32)
    model = ready(model_of_cells(cells, CELL))
    facing = {0: (0.0, np.pi / 2, 0.0), 1: (np.pi / 2, 0.0, 0.0), 2: (0.0, 0.0, 0.0)}[axis]
    for lean in (0.0, 0.4, 0.8, 1.1):
        for way in (1, -1):
            turn = compose(turned(0.0, lean, 0.1), make_pose(rotation_from_vector(way * np.array(facing)), np.zeros(3)))
            depth = drawn(model, turn, CAMERA.resized(96, 80)).depth
            assert np.all(depth[20:-20, 38:-38] > 0), f"holes at lean {lean}, way {way}"


def test_one_cell_alone_is_seen() -> None:
    model = ready(model_of_cells(np.array([[0, 0, 0]], dtype=np.int32), 0.1))
    picture = drawn(model, turned(0.3, 0.2, 0.1))
    assert 10 < np.count_nonzero(picture.depth) < 150
    assert np.all(np.abs(picture.depth[picture.depth > 0] - 1.2) < 0.15)
    assert np.unique(picture.labels).tolist() == [0, 5]


def test_a_camera_inside_sees_the_inside() -> None:
    depth = drawn(ready(model_of_shape(ball, CELL, 0.45)), turned(0.3, 0.4, 0.5, away=0.0)).depth
    assert np.all(depth > 0)
    slopes = CAMERA.rays()
    np.testing.assert_allclose(depth * np.sqrt((slopes**2).sum(axis=-1) + 1), RADIUS, atol=0.8 * CELL)


@pytest.mark.parametrize(
    "pose", [turned(0, 0, 0, away=-1.2), make_pose(np.eye(3), np.array([4.0, 0, 1]))], ids=["behind", "beside"]
)
def test_nothing_out_of_sight_is_drawn(pose: Pose) -> None:
    picture = drawn(ready(model_of_shape(ball, CELL, 0.45)), pose)
    assert not picture.depth.any()
    assert not picture.labels.any()


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("shape", SHAPES)
def test_depth_does_not_depend_on_where_blocks_lie(shape: str, view: str) -> None:
    cells, pose = surface_cells(SHAPES[shape], CELL, 0.45), VIEWS[view]
    here = drawn(ready(model_of_cells(cells, CELL)), pose).depth
    for shift in ([3, -5, 7], [1, 2, 4], [64, 0, -129], [-100_000, 70_000, 5]):
        far = np.array(shift, dtype=np.int32)
        there = compose(pose, make_pose(np.eye(3), -CELL * far.astype(np.float64)))
        np.testing.assert_allclose(drawn(ready(model_of_cells(cells + far, CELL)), there).depth, here, atol=1e-4)


def test_the_size_of_cells_is_only_a_scale() -> None:
    cells = surface_cells(ball, CELL, 0.45)
    here = drawn(ready(model_of_cells(cells, CELL)), AHEAD).depth
    twice = drawn(ready(model_of_cells(cells, 2 * CELL)), make_pose(np.eye(3), 2 * AHEAD[:3, 3])).depth
    np.testing.assert_allclose(twice, 2 * here, atol=1e-5)


@pytest.mark.parametrize("size", [(36, 30), (144, 120), (50, 97)])
def test_any_resolution_shows_the_same_thing(size: tuple[int, int]) -> None:
    model, pose = ready(model_of_shape(ball, CELL, 0.45)), VIEWS["aslant"]
    camera = CAMERA.resized(*size)
    depth = drawn(model, pose, camera).depth
    assert depth.shape == (size[1], size[0])
    assert np.mean(depth > 0) == pytest.approx(np.mean(drawn(model, pose).depth > 0), abs=0.03)
    error = np.abs(ball(points_of(np.where(inside_of(depth), depth, 0), camera, pose)))
    assert np.quantile(error, 0.95) < 0.6 * CELL


def test_colors_are_those_of_the_cells() -> None:
    cells = surface_cells(ball, CELL, 0.45)
    colors = np.full((len(cells), 3), (200, 30, 90), dtype=np.int16)
    picture = drawn(ready(model_of_cells(cells, CELL, colors)), AHEAD)
    seen = inside_of(picture.depth)
    assert np.all(picture.color[seen] == (200, 30, 90))


def test_colors_between_cells_are_interpolated() -> None:
    side = np.arange(-25, 25)
    x, y = np.meshgrid(side, side)
    cells = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(np.int32)
    colors = np.repeat((128 + 4 * cells[:, :1]), 3, axis=1).astype(np.int16)
    picture = drawn(ready(model_of_cells(cells, CELL, colors)), AHEAD)
    v, u = np.mgrid[15:45, 20:52]
    expected = 128 + 4 * (CAMERA.rays()[15:45, 20:52, 0] * 1.21 / CELL - 0.5)
    np.testing.assert_allclose(picture.color[v, u, 1], expected, atol=1.5)


def test_colors_out_of_range_are_clamped() -> None:
    cells = surface_cells(ball, CELL, 0.45)
    for value, shown in ((-40, 0), (300, 255)):
        colors = np.full((len(cells), 3), value, dtype=np.int16)
        picture = drawn(ready(model_of_cells(cells, CELL, colors)), AHEAD)
        assert np.all(picture.color[inside_of(picture.depth)] == shown)


def test_an_empty_model_draws_nothing() -> None:
    picture = drawn(ready(DecodedModel(CELL)), identity())
    assert not picture.depth.any()
    assert not picture.labels.any()
    assert picture.color.shape == (60, 72, 3)
