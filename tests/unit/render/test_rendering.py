# SPDX-License-Identifier: MIT
"""Compositing of objects, pictures of both cameras, and models that change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.rendering import model_of_cells, model_of_shape, surface_cells
from threedvc.config import RenderConfig
from threedvc.errors import ConfigError
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, compose, identity, inverse, make_pose, rotation_from_vector
from threedvc.kernels.render.shading import round_colors
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.render.picture import Picture
from threedvc.render.ray_grid import RayGrid
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer

CELL = 0.03
CAMERA = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
RIG = CameraRig.registered_to(CAMERA)
Floats = NDArray[np.float64]


def ball(points: Floats) -> Floats:
    return np.linalg.norm(points, axis=-1) - 0.25


def wall(points: Floats) -> Floats:
    return points[..., 2] - 0.004


def at(x: float, y: float, z: float, turn: tuple[float, float, float] = (0, 0, 0)) -> Pose:
    return make_pose(rotation_from_vector(np.array(turn, dtype=np.float64)), np.array([x, y, z]))


def ready(model: DecodedModel, threads: int = 1) -> RenderModel:
    shown = RenderModel(model)
    shown.refresh(threads)
    return shown


def colored(cells: NDArray[np.int32], color: tuple[int, int, int]) -> RenderModel:
    return ready(model_of_cells(cells, CELL, np.full((len(cells), 3), color, dtype=np.int16)))


@pytest.fixture(scope="module")
def ball_cells() -> NDArray[np.int32]:
    return surface_cells(ball, CELL, 0.35)


@pytest.fixture(scope="module")
def wall_cells() -> NDArray[np.int32]:
    return surface_cells(wall, CELL, 1.6)


def same(one: Picture, two: Picture) -> bool:
    return all(getattr(one, name).tobytes() == getattr(two, name).tobytes() for name in ("color", "depth", "labels"))


@pytest.mark.parametrize("numbers", [(1, 2), (2, 1)], ids=["nearer first", "nearer last"])
def test_the_nearest_object_wins(numbers: tuple[int, int], ball_cells: NDArray[np.int32]) -> None:
    near, far = numbers
    models = {near: colored(ball_cells, (250, 0, 0)), far: colored(ball_cells, (0, 0, 250))}
    poses = {near: at(-0.1, 0, 1.0), far: at(0.1, 0, 1.5)}
    picture = Renderer(RIG, RenderConfig(threads=1)).draw(models, poses)
    alone = {number: Renderer(RIG, RenderConfig(threads=1)).draw(models, {number: poses[number]}) for number in numbers}
    hidden = (alone[near].depth > 0) & (alone[far].depth > 0)
    assert np.count_nonzero(hidden) > 50
    assert np.all(picture.labels[hidden] == near)
    np.testing.assert_array_equal(picture.depth[hidden], alone[near].depth[hidden])
    for_sure = RayGrid(CAMERA, apart=True)
    cast = {
        which: Renderer(RIG, RenderConfig(threads=1)).cast(
            for_sure, models, {number: poses[number] for number in which}
        )
        for which in ((near,), (far,), (near, far))
    }
    of_near, of_far, of_both = (cast[which][0] for which in cast)
    np.testing.assert_array_equal(of_both, np.where(of_near > 0, of_near, of_far))
    np.testing.assert_array_equal(cast[near, far][1], np.where(of_near > 0, near, np.where(of_far > 0, far, 0)))
    only_far = (alone[near].depth == 0) & (alone[far].depth > 0)
    # A ray between others that met nothing may have missed the rim of the near one when that was drawn alone.
    assert np.count_nonzero(picture.labels[only_far] == near) <= 2
    only_far &= picture.labels != near
    assert np.all(picture.labels[only_far] == far)
    # Rays near the other's rim are cast which are interpolated where it is alone.
    np.testing.assert_allclose(picture.depth[only_far], alone[far].depth[only_far], rtol=0.005)
    assert picture.color[24, 20].tolist() == [250, 0, 0]


def test_objects_that_touch_are_divided_by_depth(ball_cells: NDArray[np.int32], wall_cells: NDArray[np.int32]) -> None:
    models = {0: colored(wall_cells, (90, 90, 90)), 3: colored(ball_cells, (0, 200, 0))}
    picture = Renderer(RIG, RenderConfig(threads=1)).draw(models, {0: at(0, 0, 1.2), 3: at(0, 0, 1.2)})
    # Half of the ball stands before the wall.
    shown = picture.labels == 3
    assert picture.depth[shown].max() < 1.2 + CELL
    assert np.all(picture.depth[~shown] > 1.2 - CELL)
    radius = np.sqrt(np.count_nonzero(shown) / np.pi) / 60 * 1.2
    # A little more than that of the ball, for what is nearer looks larger.
    assert radius == pytest.approx(0.27, abs=0.02)


def test_an_object_without_cells_hides_nothing(ball_cells: NDArray[np.int32]) -> None:
    models = {0: ready(DecodedModel(CELL)), 2: colored(ball_cells, (10, 20, 30))}
    poses = {0: identity(), 2: at(0, 0, 1)}
    with_empty = Renderer(RIG, RenderConfig(threads=1)).draw(models, poses)
    assert same(with_empty, Renderer(RIG, RenderConfig(threads=1)).draw(models, {2: poses[2]}))


def test_nothing_to_draw() -> None:
    picture = Renderer(RIG, RenderConfig(threads=1)).draw({}, {})
    assert (picture.color.shape, picture.depth.shape, picture.labels.shape) == ((48, 64, 3), (48, 64), (48, 64))
    assert not picture.depth.any()
    assert not picture.labels.any()


def test_only_objects_with_a_pose_are_drawn(ball_cells: NDArray[np.int32]) -> None:
    models = {1: colored(ball_cells, (250, 0, 0)), 2: colored(ball_cells, (0, 0, 250))}
    picture = Renderer(RIG, RenderConfig(threads=1)).draw(models, {2: at(0, 0, 1)})
    assert np.unique(picture.labels).tolist() == [0, 2]


def two_objects(
    ball_cells: NDArray[np.int32], wall_cells: NDArray[np.int32]
) -> tuple[dict[int, RenderModel], dict[int, Pose]]:
    rng = np.random.default_rng(6)
    colors = rng.integers(0, 256, (len(ball_cells), 3)).astype(np.int16)
    models = {0: colored(wall_cells, (200, 180, 90)), 1: ready(model_of_cells(ball_cells, CELL, colors))}
    return models, {0: at(0, 0, 1.7, (0.3, 0.2, 0.1)), 1: at(-0.15, 0.1, 1.0, (0.4, 0.5, 0.6))}


RIGS = {
    "registered": RIG,
    "distorted": CameraRig.registered_to(replace(CAMERA, distortion=(0.2, -0.1, 0.003, 0.002, 0.0))),
    "two cameras": CameraRig(
        color=CAMERA.resized(90, 70), depth=CAMERA.resized(51, 37), T_color_depth=at(0.05, 0, 0.01)
    ),
    "large": CameraRig.registered_to(CAMERA.resized(400, 300)),
}


@pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS)
@pytest.mark.parametrize("supersample", [None, 1, 2, 3])
def test_threads_do_not_matter(
    rig: CameraRig, supersample: int | None, ball_cells: NDArray[np.int32], wall_cells: NDArray[np.int32]
) -> None:
    models, poses = two_objects(ball_cells, wall_cells)
    one, two, five = (
        Renderer(rig, RenderConfig(threads=threads, supersample=supersample)).draw(models, poses)
        for threads in (1, 2, 5)
    )
    assert same(one, two)
    assert same(one, five)


def test_drawing_leaves_no_trace(ball_cells: NDArray[np.int32], wall_cells: NDArray[np.int32]) -> None:
    models, poses = two_objects(ball_cells, wall_cells)
    renderer = Renderer(RIG, RenderConfig(threads=1))
    first = renderer.draw(models, poses)
    renderer.draw(models, {1: at(0.3, 0, 0.8)})
    assert same(first, renderer.draw(models, poses))


@pytest.mark.parametrize("supersample", [1, 2, 3, 4])
def test_more_rays_show_the_same_picture(
    supersample: int, ball_cells: NDArray[np.int32], wall_cells: NDArray[np.int32]
) -> None:
    models, poses = two_objects(ball_cells, wall_cells)
    one = Renderer(RIG, RenderConfig(threads=1, supersample=1)).draw(models, poses)
    more = Renderer(RIG, RenderConfig(threads=1, supersample=supersample)).draw(models, poses)
    np.testing.assert_array_equal(one.depth, more.depth)
    assert np.mean(np.abs(one.color.astype(int) - more.color)) < 12


@pytest.mark.parametrize("value", [0, 5, 0.5])
def test_rays_are_1_to_4(value: float) -> None:
    with pytest.raises(ConfigError, match=r"must be within 1\.\.4"):
        RenderConfig(supersample=value)  # type: ignore[arg-type]


def test_without_color_the_picture_is_black(ball_cells: NDArray[np.int32], wall_cells: NDArray[np.int32]) -> None:
    models, poses = two_objects(ball_cells, wall_cells)
    for rig in (RIG, RIGS["two cameras"]):
        renderer = Renderer(rig, RenderConfig(threads=1))
        full, bare = renderer.draw(models, poses), renderer.draw(models, poses, color=False)
        assert not bare.color.any()
        assert bare.color.shape == full.color.shape
        np.testing.assert_array_equal(bare.depth, full.depth)
        np.testing.assert_array_equal(bare.labels, full.labels)


def test_each_camera_sees_from_its_own_place(ball_cells: NDArray[np.int32], wall_cells: NDArray[np.int32]) -> None:
    apart = at(0.2, 0.0, 0.0)
    rig = CameraRig(color=CAMERA, depth=CAMERA, T_color_depth=apart)
    models = {0: colored(wall_cells, (20, 20, 20)), 1: colored(ball_cells, (240, 240, 240))}
    poses = {0: at(0, 0, 1.8), 1: at(0, 0, 1.0)}
    picture = Renderer(rig, RenderConfig(threads=1)).draw(models, poses)
    columns = np.arange(64)
    bright, labeled = (picture.color[..., 0] > 150).sum(axis=0), (picture.labels == 1).sum(axis=0)
    shift = (bright @ columns) / bright.sum() - (labeled @ columns) / labeled.sum()
    # The ball's own parallax, a little less for its nearer front.
    assert shift == pytest.approx(60 * 0.2 / 1.0, rel=0.1)
    moved = Renderer(RIG, RenderConfig(threads=1)).draw(
        models, {number: compose(apart, pose) for number, pose in poses.items()}
    )
    np.testing.assert_array_equal(picture.color, moved.color)


def test_a_pixel_no_ray_of_which_hits_takes_its_color_from_around(ball_cells: NDArray[np.int32]) -> None:
    models = {1: colored(ball_cells, (200, 100, 50))}
    picture = Renderer(RIG, RenderConfig(threads=1)).draw(models, {1: at(0, 0, 1)})
    assert np.all(picture.depth[0] == 0)
    assert np.all(picture.color == (200, 100, 50))


def test_the_view_is_free(ball_cells: NDArray[np.int32], wall_cells: NDArray[np.int32]) -> None:
    """What one camera sees at a point, another one sees there too."""
    models, poses = two_objects(ball_cells, wall_cells)
    T_other_camera = at(0.15, -0.1, 0.2, (0.1, -0.15, 0.1))
    renderer = Renderer(RIG, RenderConfig(threads=1))
    here = renderer.draw(models, poses)
    there = renderer.draw(models, {number: compose(T_other_camera, pose) for number, pose in poses.items()})
    v, u = np.nonzero(here.depth)
    points = np.column_stack([CAMERA.rays()[v, u], np.ones(len(v))]) * here.depth[v, u][:, None]
    moved = points @ T_other_camera[:3, :3].T + T_other_camera[:3, 3]
    x, y = np.rint(CAMERA.project(moved)).astype(int).T
    inside = (x >= 1) & (y >= 1) & (x < 63) & (y < 47)
    difference = there.depth[y[inside], x[inside]] - moved[inside, 2]
    # Points hidden there lie behind what is drawn; hardly any lie before it.
    assert np.mean(np.abs(difference) < 1.5 * CELL) > 0.85
    assert np.mean(difference > 2 * CELL) < 0.02


def random_update(rng: np.random.Generator, model: DecodedModel) -> ModelUpdate:
    cells, _ = model.cells()
    known = {tuple(cell) for cell in cells.tolist()}
    center = rng.integers(-12, 12, 3)
    fresh = [
        cell for cell in np.unique(center + rng.integers(-4, 5, (80, 3)), axis=0).tolist() if tuple(cell) not in known
    ]
    removed = cells[rng.random(len(cells)) < 0.1]
    kept = cells[(cells[:, None] != removed[None]).any(axis=2).all(axis=1)] if len(removed) else cells
    recolored = kept[rng.random(len(kept)) < 0.1]
    return ModelUpdate(
        added=np.array(fresh, dtype=np.int32).reshape(-1, 3),
        added_colors=rng.integers(0, 256, (len(fresh), 3)).astype(np.int16),
        removed=removed,
        recolored=recolored,
        recolored_colors=rng.integers(0, 256, (len(recolored), 3)).astype(np.int16),
    )


@pytest.mark.parametrize("threads", [1, 3])
def test_a_model_kept_up_to_date_looks_like_one_made_anew(threads: int, rng: np.random.Generator) -> None:
    model = DecodedModel(CELL)
    shown = RenderModel(model)
    renderer, pose = Renderer(RIG, RenderConfig(threads=threads)), at(0, 0, 1.2, (0.3, 0.4, 0.1))
    for _ in range(8):
        model.apply(random_update(rng, model))
        shown.refresh(threads)
        anew = ready(model_of_cells(*rearranged(model)))
        assert same(renderer.draw({1: shown}, {1: pose}), renderer.draw({1: anew}, {1: pose}))
    everything, _ = model.cells()
    none = np.empty((0, 3), dtype=np.int32)
    model.apply(
        ModelUpdate(
            added=none,
            added_colors=none.astype(np.int16),
            removed=everything,
            recolored=none,
            recolored_colors=none.astype(np.int16),
        )
    )
    shown.refresh(threads)
    assert not renderer.draw({1: shown}, {1: pose}).depth.any()


def rearranged(model: DecodedModel) -> tuple[NDArray[np.int32], float, NDArray[np.int16]]:
    cells, colors = model.cells()
    return cells, model.voxel_size_m, colors


def test_pictures_do_not_depend_on_the_history_of_a_model(
    ball_cells: NDArray[np.int32], rng: np.random.Generator
) -> None:
    colors = rng.integers(0, 256, (len(ball_cells), 3)).astype(np.int16)
    whole = ready(model_of_cells(ball_cells, CELL, colors))
    order = rng.permutation(len(ball_cells))
    none = np.empty((0, 3), dtype=np.int32)
    parts = DecodedModel(CELL)
    for part in np.array_split(order, 7):
        parts.apply(
            ModelUpdate(
                added=ball_cells[part],
                added_colors=colors[part],
                removed=none,
                recolored=none,
                recolored_colors=none.astype(np.int16),
            )
        )
    renderer = Renderer(RIG, RenderConfig(threads=2))
    pose = at(0.1, 0, 0.9, (0.1, 0.7, 0.3))
    assert same(renderer.draw({1: whole}, {1: pose}), renderer.draw({1: ready(parts)}, {1: pose}))


def test_two_views_of_one_model_are_both_complete(rng: np.random.Generator) -> None:
    model = model_of_shape(ball, CELL, 0.35)
    renderer, pose = Renderer(RIG, RenderConfig(threads=1)), at(0, 0, 1)
    one, two = RenderModel(model), RenderModel(model)
    for _ in range(3):
        pictures = []
        for view in (one, two):
            view.refresh(1)
            pictures.append(renderer.draw({1: view}, {1: pose}))
        assert np.any(pictures[0].depth)
        assert same(*pictures)
        model.apply(random_update(rng, model))


def test_a_turn_of_everything_turns_the_picture(ball_cells: NDArray[np.int32], wall_cells: NDArray[np.int32]) -> None:
    models, poses = two_objects(ball_cells, wall_cells)
    upside_down = at(0, 0, 0, (0, 0, np.pi))
    renderer = Renderer(RIG, RenderConfig(threads=1))
    one = renderer.draw(models, poses)
    two = renderer.draw(models, {number: compose(upside_down, pose) for number, pose in poses.items()})
    both = (one.depth > 0) & (two.depth[::-1, ::-1] > 0)
    assert np.mean(both) > 0.95
    assert np.quantile(np.abs(one.depth - two.depth[::-1, ::-1])[both], 0.97) < 0.3 * CELL
    np.testing.assert_allclose(inverse(upside_down) @ upside_down, np.eye(4), atol=1e-12)


def test_colors_are_rounded_after_gain_and_offset() -> None:
    rng = np.random.default_rng(3)
    values = rng.uniform(-40, 300, (12, 9, 3)).astype(np.float32)[::2, ::-1]
    gain, offset = np.array([1, 0.8, 1.3], np.float32), np.array([0, -7.5, 4], np.float32)
    picture = np.zeros(values.shape, dtype=np.uint8)
    round_colors(1, 5, values, gain, offset, picture)
    expected = (np.clip(values * gain + offset, 0, 255) + np.float32(0.5)).astype(np.uint8)
    np.testing.assert_array_equal(picture[1:5], expected[1:5])
    assert not picture[[0, 5]].any()
