# SPDX-License-Identifier: MIT
"""Colors that models get from the pictures of a video."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from reference import video_texture as reference
from threedvc.kernels.render.video_texture import SeenSurface
from threedvc.render.video_texture import MAX_COUNT, MAX_DEPTH_RATIO, VideoTexture

SIZE = 12, 16
EDGE = 0.02


def slopes() -> NDArray[np.float64]:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([(x - 8) / 40.0, (y - 6) / 40.0], axis=-1).reshape(-1, 2)


def seen(depth: NDArray[np.float32], labels: NDArray[np.uint8], edge: float = EDGE) -> SeenSurface:
    """Return what a camera at the origin of the object's frame sees of object 1, in texels of an edge."""
    T = np.hstack([np.eye(3) / edge, np.full((3, 1), -0.5)])
    return SeenSurface(slopes(), depth, labels, 1, T, MAX_DEPTH_RATIO)


def steps(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return a slanted surface with a step, a hole and another object before it."""
    depth = np.repeat(np.linspace(1.0, 1.2, SIZE[1], dtype=np.float32)[None], SIZE[0], axis=0)
    depth[:, 9:] += np.float32(0.3)
    depth[2:4, 2:5] = 0
    labels = np.ones(SIZE, dtype=np.uint8)
    labels[7:, :4] = 2
    return depth + rng.normal(0, 1e-3, SIZE).astype(np.float32) * (depth > 0), labels


@pytest.mark.parametrize("pictures", [1, 3, 40])
def test_texels_equal_the_reference(pictures: int, rng: np.random.Generator) -> None:
    texture, expected = VideoTexture(EDGE), dict[reference.Texel, list[int]]()
    for _ in range(pictures):
        depth, labels = steps(rng)
        picture = rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8)
        texture.add(seen(depth, labels), picture, threads=2)
        points = np.dstack([slopes().reshape(*SIZE, 2) * depth[..., None], depth]) / EDGE
        reference.gather(
            expected, points, depth, (depth > 0) & (labels == 1), picture,
            max_ratio=MAX_DEPTH_RATIO, max_count=MAX_COUNT,
        )  # fmt: skip
    grid = texture.grid()
    places = texture.index.locate(np.array(list(expected), dtype=np.int32))
    np.testing.assert_array_equal(grid.colors[places], [reference.color(total) for total in expected.values()])
    assert np.count_nonzero(grid.colored) == len(expected)
    assert grid.colored[places].all()


def test_later_pictures_count_more() -> None:
    texture = VideoTexture(1000.0)
    depth, labels = np.ones(SIZE, dtype=np.float32), np.ones(SIZE, dtype=np.uint8)
    for level in (0, 0, 200, 200, 200, 200, 200, 200, 200, 200):
        texture.add(seen(depth, labels, 1000.0), np.full((*SIZE, 3), level, dtype=np.uint8), threads=1)
    shown = texture.grid().colors[texture.grid().colored != 0]
    assert (shown > 163).all()  # their mean is 160


def test_a_picture_that_shows_nothing_of_the_object_changes_nothing() -> None:
    texture = VideoTexture(EDGE)
    texture.add(seen(np.zeros(SIZE, np.float32), np.ones(SIZE, np.uint8)), np.zeros((*SIZE, 3), np.uint8), threads=1)
    assert not texture.grid().colored.any()
