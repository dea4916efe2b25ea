# SPDX-License-Identifier: MIT
"""Rays between rays that are cast: interpolated on planes, wanted elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.geometry.camera import Camera
from threedvc.kernels.render.ray_sampling import MAX_BEND, MAX_DEPTH_STEP, MAX_PAIR_STEP, interpolate_between
from threedvc.render.ray_grid import RayGrid
from threedvc.render.renderer import INTERPOLATIONS, Renderer

SIZES = [(64, 48), (61, 47), (5, 3), (1, 1), (2, 9)]
Depth = NDArray[np.float32]


def grid(width: int, height: int) -> RayGrid:
    return RayGrid(Camera(width=width, height=height, fx=60.0, fy=60.0, cx=width / 2, cy=height / 2))


def plane(rays: RayGrid) -> Depth:
    return (2 / (1 + rays.slopes @ [0.02, -0.013])).astype(np.float32)


class Sampling:
    """Draws a given depth picture as `Renderer.cast` would, looking rays up in place of casting them."""

    def __init__(self, rays: RayGrid, true: Depth, labels: NDArray[np.uint8] | None = None) -> None:
        self.depth, self.labels = np.zeros_like(true), np.zeros(len(true), dtype=np.uint8)
        self.wanted = np.ones(len(true), dtype=np.uint8)
        self.cast = np.zeros(len(true), dtype=bool)
        true_labels = (true > 0).astype(np.uint8) if labels is None else labels
        renderer = object.__new__(Renderer)
        renderer.config = type("Config", (), {"threads": 1})  # type: ignore[assignment]
        for level, order in enumerate(rays.levels):
            if level:
                renderer._interpolate(level, rays, self.depth, self.labels, self.wanted)
            chosen = order[self.wanted[order] != 0]
            self.depth[chosen], self.labels[chosen] = true[chosen], true_labels[chosen]
            self.cast[chosen] = True


@pytest.mark.parametrize("size", SIZES)
def test_every_ray_is_in_one_level(size: tuple[int, int]) -> None:
    rays = grid(*size)
    assert sorted(np.concatenate(rays.levels).tolist()) == list(range(size[0] * size[1]))
    assert len(rays.levels) == len(INTERPOLATIONS) + 1


def test_rays_that_are_far_apart_are_all_cast() -> None:
    rays = RayGrid(Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32, cy=24), apart=True)
    assert Sampling(rays, plane(rays)).cast.all()


@pytest.mark.parametrize("size", SIZES)
def test_a_plane_comes_out_exactly(size: tuple[int, int]) -> None:
    rays = grid(*size)
    true = plane(rays)
    drawn = Sampling(rays, true)
    np.testing.assert_allclose(drawn.depth, true, rtol=1e-6)
    assert (drawn.labels == 1).all()
    if min(size) > 40:
        assert drawn.cast.mean() < 0.15


def test_where_nothing_is_few_rays_are_cast() -> None:
    rays = grid(64, 48)
    drawn = Sampling(rays, np.zeros(64 * 48, dtype=np.float32))
    assert not drawn.depth.any()
    # Only single rays are taken to meet nothing because those around do.
    rows, columns = np.divmod(np.arange(64 * 48), 64)
    inside = (rows < 46) & (columns < 62)
    np.testing.assert_array_equal(drawn.cast[inside], ((rows | columns) % 2 == 0)[inside])


@pytest.mark.parametrize("slope", [0.0, 0.3, 1.0, 7.0])
def test_an_edge_keeps_its_pixels(slope: float) -> None:
    rays = grid(64, 48)
    rows, columns = np.divmod(np.arange(64 * 48), 64)
    near = columns - 30.3 > slope * (rows - 20.2)
    true = np.where(near, np.float32(1.0), np.float32(1.0 + 2 * MAX_DEPTH_STEP))
    drawn = Sampling(rays, true)
    np.testing.assert_array_equal(drawn.depth, true)
    labeled = Sampling(rays, np.ones_like(true), np.where(near, 1, 2).astype(np.uint8))
    np.testing.assert_array_equal(labeled.labels, np.where(near, 1, 2))


def test_along_an_edge_only_every_second_pair_is_cast() -> None:
    rays = grid(64, 48)
    columns = np.arange(64 * 48) % 64
    true = np.where(columns > 30, np.float32(1.0), np.float32(1.0 + 2 * MAX_DEPTH_STEP))
    drawn = Sampling(rays, true)
    np.testing.assert_array_equal(drawn.depth, true)
    rows, columns = np.divmod(np.flatnonzero(~drawn.cast), 64)
    beside = rows[(rows % 2 == 1) & (columns == 30) & (rows < 46)]
    np.testing.assert_array_equal(beside, np.arange(1, 46, 2))


@pytest.mark.parametrize(
    ("beside", "label", "cast"),
    [
        (1 + 0.9 * MAX_PAIR_STEP, 1, False),
        (1 + 1.1 * MAX_PAIR_STEP, 1, True),
        (1.0, 2, True),
        (0.0, 1, True),
    ],
)
def test_two_rays_tell_of_one_between_if_they_met_one_surface(beside: float, label: int, cast: bool) -> None:
    depth, labels, wanted = np.zeros(9, np.float32), np.ones(9, np.uint8), np.zeros(9, np.uint8)
    depth[[0, 2, 6, 8]], labels[2] = (1.0, beside, 1.5, 1.7), label
    interpolate_between(0, 1, 3, 3, 1, depth, labels, wanted)
    assert wanted[[1, 3, 4]].tolist() == [cast, True, True]
    if not cast:
        assert depth[1] == np.float32(2 / (1 + 1 / np.float32(beside)))


def test_a_bent_surface_is_met_nearly() -> None:
    rays = grid(64, 48)
    x, y = (rays.slopes * 4).T
    true = (1.5 + 0.2 * np.sin(3 * x) * np.cos(2 * y)).astype(np.float32)
    drawn = Sampling(rays, true)
    assert 0.1 < drawn.cast.mean() < 0.9
    error = np.abs(drawn.depth / true - 1)
    assert np.quantile(error, 0.99) < 2 * MAX_BEND
    assert error.max() < MAX_DEPTH_STEP
