# SPDX-License-Identifier: MIT
"""Which size of cells, and how fine a relief, a rate affords."""

from __future__ import annotations

from threedvc.config import with_step
from threedvc.encoder.fusion.surface_extraction import read_surface
from threedvc.encoder.rate.trial_coding import color_settings, one_shot
from threedvc.encoder.reconstruction.scene import Scene

__all__ = ["cheap_relief", "surface_bytes"]

CHEAP = 0.1
"""Share of the bytes of surfaces that one bit of relief may add."""


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
