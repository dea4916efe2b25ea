# SPDX-License-Identifier: MIT
"""Cells so far from the camera that steps of a ray are as small as rounding errors."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.rendering import model_of_cells, model_of_shape
from threedvc.config import RenderConfig
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import make_pose, rotation_from_vector
from threedvc.kernels.encoder.raycast_evidence import march
from threedvc.model.decoded_model import DecodedModel
from threedvc.render.picture import Picture
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer

CELL = 0.001
RADIUS = 0.02
TIME_LIMIT_S = 120.0
"""A child that hangs is ended after this; it may have to compile first."""
TURN = rotation_from_vector(np.array([0.3, -0.5, 0.2]))

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


def ball() -> DecodedModel:
    return model_of_shape(lambda points: np.linalg.norm(points, axis=-1) - RADIUS, CELL, 2 * RADIUS)


def plate() -> DecodedModel:
    side = np.arange(-12, 12)
    return model_of_cells(np.array([(x, y, 0) for x in side for y in side], np.int32), CELL)


def scattered() -> DecodedModel:
    rng = np.random.default_rng(3)
    return model_of_cells(np.unique(rng.integers(-40, 40, (300, 3)), axis=0).astype(np.int32), CELL)


def drawn(model: DecodedModel, away: float, threads: int = 1, focal: float = 1200.0) -> Picture:
    """Draw a model `away` meters before a camera whose picture shows it at the same size from everywhere."""
    shown = RenderModel(model)
    shown.refresh(threads)
    f = focal * away
    camera = Camera(width=64, height=48, fx=f, fy=f, cx=31.3, cy=23.6)
    renderer = Renderer(CameraRig.registered_to(camera), RenderConfig(threads=threads))
    return renderer.draw({5: shown}, {5: make_pose(TURN, np.array([0.0, 0.0, away]))})


@pytest.mark.parametrize("away", [1e3, 3e3, 1e4, 1e5, 1e6, 1e8])
@pytest.mark.parametrize("make", [ball, plate, scattered])
def test_far_cells_are_drawn_as_near_ones(make: Callable[[], DecodedModel], away: float) -> None:
    model = make()
    near, far = (drawn(model, distance).depth > 0 for distance in (100.0, away))
    assert near.mean() > 0.02
    assert (near == far).mean() > 0.98


@pytest.mark.parametrize("away", [1e10, 1e12, 1e15, 1e18, 1e30])
def test_cells_that_arithmetic_cannot_tell_apart_end(away: float) -> None:
    depth: NDArray[np.float32] = drawn(ball(), away).depth
    assert np.isfinite(depth).all()
    assert (depth != 1e9).all()


@pytest.mark.parametrize("away", [3e3, 1e6, 1e20])
def test_wide_pictures_of_far_cells_end(away: float) -> None:
    assert drawn(scattered(), away, focal=40.0 / away).depth.shape == (48, 64)


def test_rays_through_the_evidence_end_however_far() -> None:
    tables = (np.zeros(3, np.int64), np.full((1, 1, 1), -1, np.int32), np.full((1, 512), -1, np.int32))
    nothing = np.zeros(0, np.float32)
    for t in (1e6, 1e12, 1e18):
        assert march(0.3, 0.2, 0.1, 3.0, 5.0, 1000.0, t, t * (1 + 1e-9), CELL, tables, nothing, nothing) == 0.0


def send_picture(results: multiprocessing.Queue[int]) -> None:
    results.put(int((drawn(ball(), 1.0, threads=2).depth > 0).sum()))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_draws_after_its_parent_did() -> None:
    hits = int((drawn(ball(), 1.0, threads=2).depth > 0).sum())
    fork = multiprocessing.get_context("fork")
    results: multiprocessing.Queue[int] = fork.Queue()
    process = fork.Process(target=send_picture, args=(results,))
    process.start()
    try:
        assert results.get(timeout=TIME_LIMIT_S) == hits > 0
    finally:
        process.kill()
        process.join()
