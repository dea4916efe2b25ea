# SPDX-License-Identifier: MIT
"""Runs of frames that have something in common."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["runs_of"]


def runs_of(flags: Iterable[bool], max_gap: int = 0) -> list[tuple[int, int]]:
    """Return the ranges ``start..stop`` of places whose flag is set; gaps of up to `max_gap` do not divide them."""
    runs: list[tuple[int, int]] = []
    for place, flag in enumerate(flags):
        if not flag:
            continue
        if runs and place - runs[-1][1] <= max_gap:
            runs[-1] = (runs[-1][0], place + 1)
        else:
            runs.append((place, place + 1))
    return runs
