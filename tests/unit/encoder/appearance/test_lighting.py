# SPDX-License-Identifier: MIT
"""Least squares of light on objects, and when it changes."""

from __future__ import annotations

import numpy as np
import pytest

from threedvc.arrays import Doubles
from threedvc.encoder.appearance.lighting import LightEquations, epoch_frames, light_at, light_terms, light_track

ONE = np.array([0.25, 0, -0.125, 0, 0, 0.0625, 0, 0])
OTHER = np.array([-0.25, 0.125, 0.125, 0, 0, 0, 0.0625, 0])
NOISE = 4.0


def equations(factors: Doubles, seed: int) -> LightEquations:
    """Return those of a thousand samples under a light, with some noise."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(1000, 3))
    terms = light_terms(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    base = rng.uniform(30, 220, (1000, 3))
    return LightEquations.of(terms, base, base * (terms @ factors)[:, None] + rng.normal(0, NOISE, (1000, 3)))


def test_the_light_of_samples_is_found() -> None:
    found = equations(ONE, 0)
    np.testing.assert_allclose(found.solved(), ONE, atol=1 / 128)
    left = found.square - found.saved()
    assert left == pytest.approx(3000 * NOISE**2, rel=0.1)


def test_a_light_that_stays_is_told_once() -> None:
    track = light_track({8 * k: equations(ONE, k) for k in range(6)})
    assert [first for first, _ in track] == [0]
    np.testing.assert_array_equal(track[0][1], ONE)


def test_changes_are_found_where_they_are() -> None:
    lights = [ONE, ONE, OTHER, OTHER, OTHER, ONE]
    track = light_track({8 * k: equations(light, k) for k, light in enumerate(lights)})
    assert [first for first, _ in track] == [0, 16, 40]
    for frame, light in [(0, ONE), (15, ONE), (16, OTHER), (39, OTHER), (40, ONE), (1000, ONE)]:
        np.testing.assert_array_equal(light_at(track, frame), light)


def test_the_first_light_holds_before_its_frame() -> None:
    np.testing.assert_array_equal(light_at(light_track({16: equations(OTHER, 1)}), 3), OTHER)


@pytest.mark.parametrize(("frames", "epoch"), [(1, 8), (150, 8), (240, 10), (300, 13)])
def test_epochs_are_neither_short_nor_many(frames: int, epoch: int) -> None:
    assert epoch_frames(frames) == epoch
