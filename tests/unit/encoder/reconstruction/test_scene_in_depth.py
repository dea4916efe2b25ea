# SPDX-License-Identifier: MIT
"""A scene that is fused in depth alone."""

from __future__ import annotations

import numpy as np

from helpers.nonrigid_scene import nonrigid_sequence
from threedvc.config import EncoderConfig, Motion
from threedvc.encoder.fusion.surface_extraction import Surface, extract_surface
from threedvc.encoder.reconstruction.scene import Scene


def surface(*, in_color: bool) -> Surface:
    frames = nonrigid_sequence(4, (64, 48), 0.0)
    scene = Scene(frames.info, EncoderConfig(motion=Motion.KNOWN, threads=1), in_color=in_color)
    for frame in frames:
        scene.add(frame)
    return extract_surface(scene.objects[0].evidence, 1, smooth=True)


def test_without_color_the_surface_is_the_same_and_gray() -> None:
    colored, gray = surface(in_color=True), surface(in_color=False)
    np.testing.assert_array_equal(gray.cells, colored.cells)
    assert len(np.unique(gray.colors)) == 1 < len(np.unique(colored.colors))
