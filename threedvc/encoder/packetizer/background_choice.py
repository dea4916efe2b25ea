# SPDX-License-Identifier: MIT
"""How the stream shows a background at rest: by an image, by a depth map, or by colored cells."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.video.av1 import can_encode_av1
from threedvc.coding.video.still import CodedStill
from threedvc.config import EncoderConfig, RenderConfig
from threedvc.encoder.appearance.appearance_fit import FittedAppearance
from threedvc.encoder.appearance.background.background_depth import CodedDepthMap
from threedvc.encoder.fusion.surface_extraction import Surface
from threedvc.encoder.rate.region_of_interest import object_weight, with_steps_scaled
from threedvc.encoder.rate.trial_coding import coded_size, color_settings
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.model.decoded_model import DecodedModel
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer

__all__ = ["COLORED_CELLS", "BackgroundChoice", "choose_background"]


class BackgroundChoice(NamedTuple):
    """What stands for the background.

    Attributes
    ----------
    image
        The coded image that colors it; None: its cells are colored.
    depth_map
        The depth map that its cells are made of; None: they are sent.
    """

    image: CodedStill | None = None
    depth_map: CodedDepthMap | None = None


COLORED_CELLS = BackgroundChoice()
"""No image: the background is cells as any other object."""


def choose_background(
    scene: Scene, config: EncoderConfig, fitted: FittedAppearance | None, luma_step: float
) -> BackgroundChoice:
    """Choose between the image of the background, at the best of its qualities, and colored cells.

    That of the least squared error plus price of the bits is taken. A bit that quantizes a cell's color finer saves
    ``q^2 ln 2 / 6`` at every pixel of the cell: that is the price.

    Parameters
    ----------
    scene
        The finished scene.
    config
        Choices.
    finished
        What the fit to the pictures found; None: nothing is known but the cells.
    luma_step
        Step q that the quality of the image follows.
    """
    if fitted is None:
        return COLORED_CELLS
    if fitted.backdrop is None or not can_encode_av1():
        return BackgroundChoice(depth_map=fitted.depths if fitted.colorless else None)
    price = 8 * luma_step**2 * np.log(2) / 6 * fitted.pixels_per_cell / object_weight(config.focus, 0)
    image, image_cost = fitted.backdrop.best(price)
    size, picture = _drawn_cells(scene, config, fitted)
    cells_cost = fitted.backdrop.error(picture) + price * (size - _colorless_size(scene, config, fitted))
    return BackgroundChoice(image, fitted.depths) if image_cost < cells_cost else COLORED_CELLS


def _drawn_cells(scene: Scene, config: EncoderConfig, fitted: FittedAppearance) -> tuple[int, NDArray[np.uint8]]:
    """Return the bytes of the background's cells with their colors, and the picture (h, w, 3) drawn of them."""
    size, decoded = _coded(scene, config, fitted.surfaces[0])
    model = RenderModel(decoded)
    model.refresh(config.threads)
    renderer = Renderer(scene.info.rig, RenderConfig(supersample=1, threads=config.threads))
    return size, renderer.draw({0: model}, {0: scene.objects[0].poses[0]}).color


def _colorless_size(scene: Scene, config: EncoderConfig, fitted: FittedAppearance) -> int:
    """Return the bytes of the background's geometry alone."""
    if fitted.depths is not None:
        return len(fitted.depths.payload)
    surface = fitted.surfaces[0]
    return _coded(scene, config, replace(surface, colors=np.zeros_like(surface.colors)))[0]


def _coded(scene: Scene, config: EncoderConfig, surface: Surface) -> tuple[int, DecodedModel]:
    """Return the bytes of a surface of the background sent at once, and the model with it."""
    settings = with_steps_scaled(color_settings(config.color, scene.info.gray), object_weight(config.focus, 0))
    voxel_size_m = scene.objects[0].evidence.voxel_size_m
    return coded_size(surface, voxel_size_m, config.appearance.relief_bits or 0, settings)
