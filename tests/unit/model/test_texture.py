# SPDX-License-Identifier: MIT
"""Texels: which there are, their colors as payload, how they are drawn."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.rendering import model_of_cells
from threedvc.coding.color import ColorSettings
from threedvc.coding.texture import decode_texture, encode_texture
from threedvc.config import RenderConfig
from threedvc.errors import CorruptStream
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import make_pose
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.model.texture import texels_of
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer

CELL = 0.05
NONE = np.empty((0, 3), dtype=np.int32)
FINE = ColorSettings(luma_step=1, chroma_step=1)


def wall(side: int = 12) -> NDArray[np.int32]:
    x, y = np.meshgrid(np.arange(-side, side), np.arange(-side, side))
    return np.stack([x.ravel(), y.ravel(), (x.ravel() + 1) // 3], axis=1).astype(np.int32)


def textured(scale: int, cells: NDArray[np.int32]) -> DecodedModel:
    plain = model_of_cells(cells, CELL)
    model = DecodedModel(CELL, scale)
    ordered, colors = plain.cells()
    model.apply(ModelUpdate.adding(ordered, colors))
    return model


def stripes(texels: NDArray[np.int32]) -> NDArray[np.int16]:
    return np.repeat(np.where(texels[:, :1] % 2 == 0, 60, 190), 3, axis=1).astype(np.int16)


def test_texels_lie_about_the_plane() -> None:
    cells = np.array([[0, 0, 0], [5, -3, 2]], dtype=np.int32)
    flat = np.array([[0, 0, 127, 0], [0, 0, 127, 0]], dtype=np.int8)
    assert len(texels_of(cells, flat, 2)) == 16, "a plane between two layers of texels touches both"
    near = flat.copy()
    near[:, 3] = 40
    texels = texels_of(cells, near, 2)
    assert len(texels) == 8
    assert set(texels[:, 2]) == {1, 5}
    without = np.zeros((2, 4), dtype=np.int8)
    assert len(texels_of(cells, without, 4)) == 2 * 64


@pytest.mark.parametrize("scale", [2, 4])
def test_colors_pass_through_their_payload(scale: int) -> None:
    model = textured(scale, wall())
    texels = model.uncolored_texels()
    payload, decoded = encode_texture(model, texels, stripes(texels), FINE)
    np.testing.assert_array_equal(decode_texture(payload, model, texels), decoded)
    # The mean of a cell is its own color; only what its texels differ by is coded.
    owners = model.index.locate(texels // scale)
    count = np.maximum(np.bincount(owners), 1)
    means = [np.bincount(owners, each[:, 0]) / count for each in (decoded, stripes(texels))]
    contrast = (decoded[:, 0] - means[0][owners]) - (stripes(texels)[:, 0] - means[1][owners])
    assert np.abs(contrast).max() < 8
    assert model.texture is not None
    model.texture.paint(texels, decoded)
    assert not len(model.uncolored_texels())


def test_a_second_part_is_predicted_from_the_first() -> None:
    cells = wall()
    left = cells[:, 0] < 0
    model = textured(2, cells[left])
    assert model.texture is not None
    for part in (None, cells[~left]):
        if part is not None:
            update = ModelUpdate.adding(part, np.full((len(part), 3), 128, np.int16))
            model.apply(update)
        texels = model.uncolored_texels()
        owners = np.unique(texels // 2, axis=0)
        expected = cells[left] if part is None else part
        np.testing.assert_array_equal(owners, np.unique(expected, axis=0))
        payload, decoded = encode_texture(model, texels, stripes(texels), FINE)
        np.testing.assert_array_equal(decode_texture(payload, model, texels), decoded)
        model.texture.paint(texels, decoded)


def test_texels_leave_with_their_cells_and_count_in_the_digest() -> None:
    model = textured(2, wall())
    assert model.texture is not None
    before = model.digest()
    texels = model.uncolored_texels()
    model.texture.paint(texels, stripes(texels))
    assert model.digest() != before
    gone = model.cells()[0][:7]
    model.apply(
        ModelUpdate(
            added=NONE, added_colors=NONE.astype(np.int16), removed=gone, recolored=NONE,
            recolored_colors=NONE.astype(np.int16),
        )
    )  # fmt: skip
    left = {tuple(cell) for cell in (model.texture.texels()[0] // 2).tolist()}
    assert not left & {tuple(cell) for cell in gone.tolist()}


def test_truncated_payloads_are_refused() -> None:
    model = textured(2, wall())
    texels = model.uncolored_texels()
    colors = np.random.default_rng(1).integers(0, 256, (len(texels), 3)).astype(np.int16)
    payload, _ = encode_texture(model, texels, colors, FINE)
    with pytest.raises(CorruptStream):
        decode_texture(payload[: len(payload) // 2], model, texels)


def test_texels_are_drawn_finer_than_cells() -> None:
    camera = Camera(width=96, height=80, fx=110.0, fy=110.0, cx=47.5, cy=39.5)
    pose = make_pose(np.eye(3), np.array([0.0, 0.0, 1.2]))
    spread = []
    for scale in (1, 2):
        model = textured(scale, wall())
        if model.texture is not None:
            texels = model.uncolored_texels()
            model.texture.paint(
                texels, np.repeat(np.where(texels[:, :1] % 2 == 0, 60, 190), 3, axis=1).astype(np.int16)
            )
        shown = RenderModel(model)
        shown.refresh(1)
        picture = Renderer(CameraRig.registered_to(camera), RenderConfig(threads=1)).draw({0: shown}, {0: pose})
        spread.append(picture.color[20:60, 20:70, 0].std())
    assert spread[0] == 0
    assert spread[1] > 20
