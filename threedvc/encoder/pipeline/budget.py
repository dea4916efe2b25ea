# SPDX-License-Identifier: MIT
"""Bytes that a bit rate grants to a stream and to its surfaces."""

from __future__ import annotations

from threedvc.encoder.pipeline.fusion_pass import Reconstruction
from threedvc.encoder.rate.rate_control import surface_budget as rate_surface_budget

__all__ = ["bits_per_second", "stream_budget", "surface_budget"]


def stream_budget(state: Reconstruction) -> float | None:
    """Return the bytes that a stream may take at the bit rate asked for; None: as many as it needs."""
    rate = state.config.bitrate_bps
    return None if rate is None else rate * len(state.reports) / state.info.fps / 8


def bits_per_second(state: Reconstruction, stream_bytes: int) -> float:
    """Return the rate at which a stream takes so many bytes."""
    return stream_bytes * 8 * state.info.fps / len(state.reports)


def surface_budget(state: Reconstruction) -> float | None:
    """Return the bytes that surfaces may take if their cells are free to follow from them, else None.

    Before a camera at rest they are not: a picture stands for the background.
    """
    budget = stream_budget(state)
    if budget is None or state.config.voxel_size_m is not None or state.scene.objects[0].at_rest:
        return None
    return rate_surface_budget(len(state.reports), budget)
