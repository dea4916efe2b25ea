# SPDX-License-Identifier: MIT
"""What surfaces would take if they were sent at once, for choices by measurement."""

from __future__ import annotations

from threedvc.coding.color import ColorSettings
from threedvc.coding.relief import encode_relief
from threedvc.coding.update import encode_update_with_result
from threedvc.config import ColorConfig
from threedvc.encoder.fusion.surface_extraction import Surface
from threedvc.encoder.rate.model_updates import first_visible_update
from threedvc.model.decoded_model import DecodedModel

__all__ = ["coded_size", "color_settings"]


def color_settings(color: ColorConfig, gray: bool) -> ColorSettings:
    """Return how finely colors are coded."""
    return ColorSettings(luma_step=color.luma_step, chroma_step=color.chroma_step, gray=gray)


def coded_size(
    surface: Surface, voxel_size_m: float, relief_bits: int, settings: ColorSettings
) -> tuple[int, DecodedModel]:
    """Return the bytes of a surface sent at once, and the model with it."""
    model = DecodedModel(voxel_size_m, relief_bits=relief_bits)
    payload, decoded = encode_update_with_result(first_visible_update(surface, model, None), *model.cells(), settings)
    model.apply(decoded)
    size = len(payload)
    if relief_bits and len(surface.cells):
        size += len(encode_relief(model, surface.offsets_at(model.cells_without_offset()[0])))
    return size, model
