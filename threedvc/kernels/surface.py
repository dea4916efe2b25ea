# SPDX-License-Identifier: MIT
"""MAP read-out of the evidence: the cells that a ray can meet first."""

from __future__ import annotations

from threedvc.kernels import kernel
from threedvc.kernels.blocks import find_cell

__all__ = ["count_neighbours", "mark_surface"]


@kernel
def mark_surface(
    start, stop, coords, tables, voxel_size, distance, weight, log_odds, min_weight, min_log_odds, surface
):
    """Mark the surface cells of blocks ``start..stop`` in `surface` (blocks, 512) uint8.

    The surface passes between two face neighbours whose signed distances differ in sign; the nearer of
    the two is occupied. A difference of far more than a cell is no surface but the rim of an occlusion.
    One of the two, or of the next two cells behind them, must be occupied by its log-odds: where poses
    scatter by more than the sensor, free space eats into the front of the surface.
    """
    root_origin, root, supers = tables
    flat_distance, flat_weight, flat_odds = distance.reshape(-1), weight.reshape(-1), log_odds.reshape(-1)
    for b in range(start, stop):
        for i in range(512):
            surface[b, i] = 0
            if weight[b, i] < min_weight:
                continue
            here = distance[b, i]
            x = coords[b, 0] * 8 + (i & 7)
            y = coords[b, 1] * 8 + ((i >> 3) & 7)
            z = coords[b, 2] * 8 + (i >> 6)
            for face in range(6):
                way = 1 - 2 * (face & 1)
                axis = face >> 1
                other = find_cell(
                    x + way * (axis == 0), y + way * (axis == 1), z + way * (axis == 2), root_origin, root, supers
                )
                if other < 0 or flat_weight[other] < min_weight:
                    continue
                there = flat_distance[other]
                if (here > 0) == (there > 0) or abs(here - there) > 2.5 * voxel_size:
                    continue
                nearer = abs(here) < abs(there) or (abs(here) == abs(there) and way > 0)
                if not nearer:
                    continue
                deeper = way if here > 0 else -way
                front = 0 if here > 0 else -1
                for step in range(front, front + 4):
                    k = deeper * step
                    cell = find_cell(
                        x + k * (axis == 0), y + k * (axis == 1), z + k * (axis == 2), root_origin, root, supers
                    )
                    if cell >= 0 and flat_odds[cell] > min_log_odds and flat_weight[cell] > 0.0:
                        surface[b, i] = 1
                if surface[b, i]:
                    break


@kernel
def count_neighbours(cells, positions, tables, flags, counts):
    """Count the set cells among the 26 neighbours of every listed cell; `flags` is (blocks * 512,)."""
    root_origin, root, supers = tables
    for n in range(cells.shape[0]):
        counts[n] = 0
        for k in range(27):
            other = find_cell(
                cells[n, 0] + k % 3 - 1,
                cells[n, 1] + k // 3 % 3 - 1,
                cells[n, 2] + k // 9 - 1,
                root_origin,
                root,
                supers,
            )
            if k != 13 and other >= 0 and flags[other]:
                counts[n] += 1
