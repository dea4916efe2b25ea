# SPDX-License-Identifier: MIT
"""MAP read-out of the evidence: the cells that a ray can meet first."""

from __future__ import annotations

import numpy as np

from threedvc.kernels import kernel
from threedvc.kernels.blocks import BLOCK_CELLS, BLOCK_SIDE, find_cell

__all__ = ["count_neighbors", "find_crossings", "mark_surface", "smooth_distances"]

REACH = 3.0
"""Cells from the surface within which distances are straightened: what is read out lies nearer."""
MAX_JUMP = 4.0
"""Distances, in cells, by which opposite neighbors on one surface may differ: they are up to 2 sqrt(3) = 3.5 cells
apart."""
BEND = 0.5
"""Cells by which neighbors bend that count half: so edges stay (decision 0011)."""
MAX_CHANGE = 2.5
"""Distances, in cells, by which face neighbors on one surface may differ: they are one cell apart, the rest is noise.
What differs by more is the rim of an occlusion."""
EVIDENT_CELLS = 4
"""Cells of which one must be occupied: the two at the change of sign and the next two behind them (decision 0003:
measured on the kitchen, two more lower the share of lost depth from .050 to .001)."""
NO_CROSSING = 2.0
"""In cells: none is as far from a center as its neighbor's."""


@kernel
def smooth_distances(start, stop, coords, tables, voxel_size, distance, weight, min_weight, trust, smooth):
    """Straighten the signed distances of blocks ``start..stop`` near the surface; write them to `smooth` (blocks, 512).

    A cell is drawn to the mean of its opposite neighbors, which on a plane is its own distance: with the weight
    `trust` against its own, and little where they tell of an edge rather than of noise.
    """
    root_origin, root, supers = tables
    flat_distance, flat_weight = distance.reshape(-1), weight.reshape(-1)
    for b in range(start, stop):
        for i in range(BLOCK_CELLS):
            here = distance[b, i]
            smooth[b, i] = here
            if weight[b, i] < min_weight or abs(here) > REACH * voxel_size:
                continue
            x = coords[b, 0] * BLOCK_SIDE + (i & 7)
            y = coords[b, 1] * BLOCK_SIDE + ((i >> 3) & 7)
            z = coords[b, 2] * BLOCK_SIDE + (i >> 6)
            total, mean = 0.0, 0.0
            for k in range(13):
                dx, dy, dz = k % 3 - 1, k // 3 % 3 - 1, k // 9 - 1
                one = find_cell(x + dx, y + dy, z + dz, root_origin, root, supers)
                two = find_cell(x - dx, y - dy, z - dz, root_origin, root, supers)
                if one < 0 or two < 0 or min(flat_weight[one], flat_weight[two]) < min_weight:
                    continue
                if abs(flat_distance[one] - flat_distance[two]) > MAX_JUMP * voxel_size:
                    continue
                between = 0.5 * (flat_distance[one] + flat_distance[two])
                bend = (between - here) / (BEND * voxel_size)
                w = min(flat_weight[one], flat_weight[two]) / (1.0 + bend * bend)
                total += w
                mean += w * between
            if total > 0.0:
                share = trust / (trust + weight[b, i])
                smooth[b, i] = here + share * (mean / total - here)


@kernel
def mark_surface(
    start, stop, coords, tables, voxel_size, distance, weight, log_odds, min_weight, min_log_odds, surface
):
    """Mark the surface cells of blocks ``start..stop`` in `surface` (blocks, 512) uint8.

    The surface passes between two face neighbors whose signed distances differ in sign; the nearer of
    the two is occupied. A difference of far more than a cell is no surface but the rim of an occlusion.
    One of the two, or of the next two cells behind them, must be occupied by its log-odds: where poses
    scatter by more than the sensor, free space eats into the front of the surface.
    """
    root_origin, root, supers = tables
    flat_distance, flat_weight, flat_odds = distance.reshape(-1), weight.reshape(-1), log_odds.reshape(-1)
    for b in range(start, stop):
        for i in range(BLOCK_CELLS):
            surface[b, i] = 0
            if weight[b, i] < min_weight:
                continue
            here = distance[b, i]
            x = coords[b, 0] * BLOCK_SIDE + (i & 7)
            y = coords[b, 1] * BLOCK_SIDE + ((i >> 3) & 7)
            z = coords[b, 2] * BLOCK_SIDE + (i >> 6)
            for face in range(6):
                way = 1 - 2 * (face & 1)
                axis = face >> 1
                other = find_cell(
                    x + way * (axis == 0), y + way * (axis == 1), z + way * (axis == 2), root_origin, root, supers
                )
                if other < 0 or flat_weight[other] < min_weight:
                    continue
                there = flat_distance[other]
                if (here > 0) == (there > 0) or abs(here - there) > MAX_CHANGE * voxel_size:
                    continue
                nearer = abs(here) < abs(there) or (abs(here) == abs(there) and way > 0)
                if not nearer:
                    continue
                deeper = way if here > 0 else -way
                front = 0 if here > 0 else -1
                for step in range(front, front + EVIDENT_CELLS):
                    k = deeper * step
                    cell = find_cell(
                        x + k * (axis == 0), y + k * (axis == 1), z + k * (axis == 2), root_origin, root, supers
                    )
                    if cell >= 0 and flat_odds[cell] > min_log_odds and flat_weight[cell] > 0.0:
                        surface[b, i] = 1
                if surface[b, i]:
                    break


@kernel
def count_neighbors(cells, positions, tables, flags, counts):
    """Count the set cells among the 26 neighbors of every listed cell; `flags` is (blocks * 512,)."""
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


@kernel
def find_crossings(cells, positions, tables, distance, weight, subvoxel_offsets):
    """Write where a surface passes from the centers of cells (n, 3) along each axis, in cells, to `subvoxel_offsets`
    (n, 3).

    `distance` and `weight` are (blocks * 512,), see `EvidenceModel`. Without a change of sign on either side it is the
    end of the cell that is nearer to one.
    """
    root_origin, root, supers = tables
    for n in range(len(cells)):
        here = np.float64(distance[positions[n]])
        for axis in range(3):
            crossing, slope = NO_CROSSING, 0.0
            for way in (-1, 1):
                other = find_cell(
                    cells[n, 0] + way * (axis == 0),
                    cells[n, 1] + way * (axis == 1),
                    cells[n, 2] + way * (axis == 2),
                    root_origin,
                    root,
                    supers,
                )
                if other < 0 or weight[other] <= 0.0:
                    continue
                there = np.float64(distance[other])
                slope += way * (there - here)
                if (here > 0) != (there > 0) and here / (here - there) < abs(crossing):
                    crossing = way * here / (here - there)
            if crossing == NO_CROSSING:
                crossing = 0.5 if (here > 0) == (slope < 0) else -0.5
            subvoxel_offsets[n, axis] = crossing
