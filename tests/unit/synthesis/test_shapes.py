# SPDX-License-Identifier: MIT
"""Primitives and textures: ray hits, normals and patterns against slow references."""

from __future__ import annotations

import numpy as np
import pytest

from reference import synthesis as reference
from threedvc.errors import ConfigError
from threedvc.kernels.synthesis.parts import CHECKER, NOISE, PART, RECTANGLE, TORUS
from threedvc.kernels.synthesis.shapes import hit_distance, surface
from threedvc.kernels.synthesis.textures import pattern_color, value_noise
from threedvc.synthesis import shapes, textures
from threedvc.synthesis.shapes import Shape

SHAPES = {
    "rectangle": shapes.rectangle(0.8, 0.5),
    "box": shapes.box(0.6, 0.3, 0.5),
    "ball": shapes.ball(0.3),
    "ellipsoid": shapes.ellipsoid(0.4, 0.15, 0.25),
    "cylinder": shapes.cylinder(0.2, 0.5),
    "frustum": shapes.frustum(0.3, 0.1, 0.4),
    "cone": shapes.frustum(0.0, 0.3, 0.5),
    "capsule": shapes.capsule(0.15, 0.4),
    "torus": shapes.torus(0.3, 0.08),
    "fat torus": shapes.torus(0.12, 0.11),
    "spindle torus": shapes.torus(0.1, 0.2),
}


def distance(shape: Shape, origin: np.ndarray, direction: np.ndarray, near: float = 1e-9) -> float:
    """Call the kernel."""
    o, d = tuple(map(float, origin)), tuple(map(float, direction))
    return hit_distance(shape.kind, o, d, np.array(shape.size), near)


@pytest.mark.parametrize("name", SHAPES)
def test_first_hit_equals_dense_sampling(name: str, rng: np.random.Generator) -> None:
    shape = SHAPES[name]
    compared = 0
    for _ in range(150):
        origin = rng.normal(size=3)
        origin *= 1.2 / np.linalg.norm(origin)
        direction = (rng.uniform(-1, 1, 3) * shape.radius - origin) * rng.uniform(0.3, 3)
        expected = reference.first_hit(shape, origin, direction)
        found = distance(shape, origin, direction)
        grazing = found < expected - 1e-6
        if grazing:
            # Dense sampling steps over a short chord; the point must then be on the surface all the same.
            assert abs(reference.implicit(shape, origin + found * direction)) < 1e-9
            continue
        assert found == pytest.approx(expected, abs=1e-9)
        compared += np.isfinite(found)
    assert compared > 30


@pytest.mark.parametrize("name", [name for name in SHAPES if name not in ("rectangle", "spindle torus")])
def test_ray_from_inside_leaves_through_the_surface(name: str, rng: np.random.Generator) -> None:
    shape = SHAPES[name]
    inside = np.array([shape.size[0], 0.0, 0.0]) if shape.kind == TORUS else np.array([0.0, 0.0, 0.02])
    for _ in range(30):
        direction = rng.normal(size=3)
        t = distance(shape, inside, direction)
        assert 0 < t < np.inf
        assert abs(reference.implicit(shape, inside + t * direction)) < 1e-9


@pytest.mark.parametrize("name", SHAPES)
def test_hits_behind_near_are_ignored(name: str) -> None:
    shape = SHAPES[name]
    target = np.array([shape.size[0], 0.01, 0.0]) * (1.0 if shape.kind == TORUS else 0.1)
    start = np.array([0.021, 0.017, 1.0])
    along = target - start
    first = distance(shape, start, along)
    assert 0 < first < np.inf
    assert distance(shape, start, along, near=first) > first
    assert distance(shape, start, -along) == np.inf


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("name", SHAPES)
def test_rays_along_the_axes(name: str, axis: int) -> None:
    shape = SHAPES[name]
    direction = np.zeros(3)
    direction[axis] = 1.0
    for offset in (0.0, 0.05, 5.0):
        origin = -2.0 * direction
        origin[(axis + 1) % 3] = offset
        expected = reference.first_hit(shape, origin, direction)
        in_plane = shape.kind == RECTANGLE and axis != 2
        assert distance(shape, origin, direction) == pytest.approx(np.inf if in_plane else expected, abs=1e-9)


@pytest.mark.parametrize("name", SHAPES)
def test_normals_are_the_gradient(name: str, rng: np.random.Generator) -> None:
    shape = SHAPES[name]
    for _ in range(80):
        origin = rng.normal(size=3) * 2
        direction = rng.uniform(-0.9, 0.9, 3) * shape.radius * 0.7 - origin
        t = distance(shape, origin, direction)
        if not np.isfinite(t):
            continue
        point = origin + t * direction
        *found, u, v = surface(shape.kind, np.array(shape.size), *point)
        expected = reference.normal(shape, point)
        if np.linalg.norm(reference.normal(shape, point + 2e-6) - expected) > 1e-3:
            continue
        np.testing.assert_allclose(found, expected, atol=1e-4)
        assert np.isfinite([u, v]).all()


def test_parts_between_points_end_there() -> None:
    texture = textures.plain((1, 2, 3))
    start, end = np.array([0.1, -0.2, 0.3]), np.array([-0.4, 0.1, 0.2])
    for part, half in (
        (shapes.capsule_between(start, end, 0.05, texture), 1),
        (shapes.frustum_between(start, end, 0.05, 0.02, texture), 2),
    ):
        z = part.T_body_part[:3, 2] * part.shape.size[half]
        np.testing.assert_allclose(part.T_body_part[:3, 3] - z, start, atol=1e-12)
        np.testing.assert_allclose(part.T_body_part[:3, 3] + z, end, atol=1e-12)


@pytest.mark.parametrize(
    "make", [lambda: shapes.ball(-0.1), lambda: shapes.box(1, float("nan"), 1), lambda: shapes.torus(0, 0)]
)
def test_impossible_sizes_are_refused(make) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ConfigError, match="must be finite, not negative, and not all zero"):
        make()


def record(texture: textures.Texture) -> np.void:
    """Return the table row of a part with this texture, its picture (if any) being the first texels."""
    row = np.zeros(1, dtype=PART)[0]
    row["pattern"], row["colors"], row["seed"] = texture.pattern, texture.colors, texture.seed
    row["scale"], row["grain"] = texture.scale_m, texture.grain
    if texture.image is not None:
        row["picture"] = (0, *texture.image.shape[:2])
    return row


def colors_at(texture: textures.Texture, points: np.ndarray) -> np.ndarray:
    """Evaluate a texture at (n, 3) body points, whose x and y serve as texture coordinates."""
    texels = np.zeros((1, 3), np.uint8) if texture.image is None else texture.image.reshape(-1, 3)
    row = record(texture)
    return np.array([pattern_color(row, texels, *map(float, p), float(p[0]), float(p[1])) for p in points])


RED, BLUE = (200, 40, 30), (20, 60, 180)


@pytest.mark.parametrize("make", [textures.noise, textures.marble, textures.wood, textures.patches])
def test_solid_patterns_mix_two_colors(make, rng: np.random.Generator) -> None:  # type: ignore[no-untyped-def]
    points = rng.uniform(-1, 1, (400, 3))
    texture = make(RED, BLUE, 0.1, 4)
    pure = colors_at(textures.Texture(pattern=texture.pattern, colors=(RED, BLUE), scale_m=(0.1, 0.1), seed=4), points)
    weight = (pure[:, 0] - RED[0]) / (BLUE[0] - RED[0])
    assert weight.min() >= 0
    assert weight.max() <= 1
    assert weight.std() > 0.1
    np.testing.assert_allclose(pure, np.array(RED) + weight[:, None] * (np.array(BLUE) - RED), atol=1e-9)
    assert not np.array_equal(colors_at(make(RED, BLUE, 0.1, 5), points), colors_at(texture, points))


def test_noise_is_continuous_across_cells() -> None:
    for edge in (-2.0, 0.0, 1.0, 7.0):
        before, after = (value_noise(edge + d, 0.3, -4.6, 9) for d in (-1e-9, 1e-9))
        assert after == pytest.approx(before, abs=1e-6)


def test_checker_alternates() -> None:
    texture = textures.Texture(pattern=CHECKER, colors=(RED, BLUE), scale_m=(0.1, 0.2))
    points = np.array([[0.05, 0.1, 0], [0.15, 0.1, 0], [0.05, 0.3, 0], [0.15, 0.3, 0], [-0.05, 0.1, 0]])
    np.testing.assert_array_equal(colors_at(texture, points), np.array([RED, BLUE, BLUE, RED, BLUE]))


def test_stripes_do_not_change_along_themselves() -> None:
    texture = textures.Texture(pattern=CHECKER, colors=(RED, BLUE), scale_m=(0.1, float("inf")))
    up = np.array([[0.05, v, 0] for v in (0.0, 0.2, 5.0, 100.0)])
    np.testing.assert_array_equal(colors_at(texture, up), np.array([RED] * 4))
    assert textures.stripes(RED, BLUE, 0.1).scale_m == (float("inf"), 0.1)
    assert textures.stripes(RED, BLUE, 0.1, upright=True).scale_m == (0.1, float("inf"))


def test_picture_texels_stand_where_they_were_drawn(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (4, 6, 3), dtype=np.uint8)
    texture = textures.picture(image, 0.6, 0.4)
    rows, columns = np.indices((4, 6))
    u, v = (columns.ravel() + 0.5) * 0.1 - 0.3, 0.2 - (rows.ravel() + 0.5) * 0.1
    points = np.stack([u, v, 0 * u], axis=1)
    np.testing.assert_allclose(colors_at(texture, points), image.reshape(-1, 3), atol=1e-9)
    np.testing.assert_allclose(colors_at(texture, points + np.array([0.6, -0.4, 0])), image.reshape(-1, 3), atol=1e-9)
    between = colors_at(texture, np.array([[-0.2, 0.15, 0]]))
    np.testing.assert_allclose(between[0], image[0, :2].mean(axis=0), atol=1e-9)


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng: textures.wallpaper(RED, BLUE, rng),
        lambda rng: textures.bricks(RED, BLUE, rng),
        lambda rng: textures.planks(RED, rng),
        lambda rng: textures.cloth(RED, rng),
        lambda rng: textures.poster(0.4, 0.6, rng),
        lambda rng: textures.parcel(0.03, 0.2, rng),
        lambda rng: textures.rug(1.0, 0.7, rng),
    ],
)
def test_pictures_follow_their_seed(draw) -> None:  # type: ignore[no-untyped-def]
    first, same, other = (draw(np.random.default_rng(seed)).image for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)
    assert first.std() > 5


def test_impossible_textures_are_refused() -> None:
    with pytest.raises(ConfigError, match="periods"):
        textures.Texture(pattern=NOISE, scale_m=(0.0, 1.0))
    with pytest.raises(ConfigError, match="shape"):
        textures.picture(np.zeros((4, 4), np.uint8), 1, 1)
