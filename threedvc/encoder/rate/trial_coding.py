# SPDX-License-Identifier: MIT
"""What surfaces would take if they were sent at once, for choices by measurement."""

from __future__ import annotations

from threedvc.coding.color import ColorSettings
from threedvc.coding.relief import encode_relief
from threedvc.coding.update import encode_update_with_result
from threedvc.config import ColorConfig, with_step
from threedvc.encoder.fusion.surface_extraction import Surface, first_sights, read_surface
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.model.decoded_model import DecodedModel

__all__ = ["cheap_relief", "color_settings", "one_shot", "surface_bytes"]

CHEAP = 0.1
"""Share of the bytes of surfaces that one bit of relief may add."""


def color_settings(color: ColorConfig, grey: bool) -> ColorSettings:
    """Return how finely colours are coded."""
    return ColorSettings(luma_step=color.luma_step, chroma_step=color.chroma_step, grey=grey)


def one_shot(
    surface: Surface, voxel_size_m: float, relief_bits: int, settings: ColorSettings
) -> tuple[int, DecodedModel]:
    """Return the bytes of a surface sent at once, and the model with it."""
    model = DecodedModel(voxel_size_m, relief_bits=relief_bits)
    payload, decoded = encode_update_with_result(first_sights(surface, model, None), *model.cells(), settings)
    model.apply(decoded)
    size = len(payload)
    if relief_bits and len(surface.cells):
        size += len(encode_relief(model, surface.crossings_of(model.untold_cells()[0])))
    return size, model


def surface_bytes(scene: Scene, luma_step: float, relief_bits: int | None = None) -> int:
    """Return how many bytes the surfaces of a scene take, each sent at once with colours of a luma step.

    Without `relief_bits` they have as many as the scene's choices say.
    """
    settings = color_settings(with_step(luma_step), scene.info.grey)
    bits = scene.config.appearance.relief_bits or 0 if relief_bits is None else relief_bits
    threads = scene.config.threads
    sizes = (
        one_shot(read_surface(item.evidence, threads, smooth=True), item.evidence.voxel_size_m, bits, settings)
        for item in scene.objects.values()
    )
    return sum(size for size, _ in sizes)


def cheap_relief(scene: Scene, luma_step: float) -> int:
    """Return 1 if one bit of relief costs little beside the surfaces, else 0.

    On smooth surfaces it does, and there it is needed most: cells lie in wide steps, whose height the decoder cannot
    tell from their neighbours. Noise makes it dear, and stands in for it.
    """
    plain, fine = (surface_bytes(scene, luma_step, bits) for bits in (0, 1))
    return 1 if fine < (1 + CHEAP) * plain else 0
