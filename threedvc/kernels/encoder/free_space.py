# SPDX-License-Identifier: MIT
"""Loops of the division by motion: what other frames saw through, connected surfaces, labels of all pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats
from threedvc.kernels import kernel
from threedvc.kernels.encoder.fusion import project_point

__all__ = ["OtherFrames", "connect_surfaces", "count_free_space_votes", "measure_misfits", "spread_labels"]

MIN_Z_M = 0.05
"""Points nearer to another camera, or behind it, are not in its picture: no sensor measures there."""
MAX_SLOPE = 1.5
"""Slopes that no depth camera sees, of a field of 113 degrees."""
MAX_DIFFERENCE_M = 1e9
"""More than any two depths differ by."""
TIE_M = 1e-6
"""Meters that a pixel of distance counts for: of surfaces equally deep the nearer one gives its label."""


class OtherFrames(NamedTuple):
    """What other frames of the same camera saw.

    Attributes
    ----------
    T_other_frame
        (n, 4, 4): where points of a frame would be before the camera of each of them.
    pictures, slots
        (m, h, w, 2) least and largest depth about each pixel of frames in units of `unit_m`, 0 = unknown; the (n,)
        places of these frames among them.
    unit_m
        Unit of the pictures in meters.
    camera
        (10,) parameters of the camera.
    """

    T_other_frame: Doubles
    pictures: NDArray[np.uint16]
    slots: NDArray[np.int64]
    unit_m: float
    camera: Doubles


@kernel
def pixel_of(x, y, z, T, camera, width, height):
    """Return row, column and depth of a point before another camera; row -1 where it is not in the picture."""
    pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    # Far outside the picture a distortion polynomial may fold back into it.
    if pz < MIN_Z_M or abs(px) > MAX_SLOPE * pz or abs(py) > MAX_SLOPE * pz:
        return -1, 0, pz
    fu, fv = project_point(px, py, pz, camera)
    c, r = np.int64(np.floor(fu + 0.5)), np.int64(np.floor(fv + 0.5))
    if c < 0 or r < 0 or c >= width or r >= height:
        return -1, 0, pz
    return r, c, pz


@kernel
def count_free_space_votes(
    depth: Floats,
    rays: Doubles,
    chosen: NDArray[np.bool_],
    others: OtherFrames,
    margins: Doubles,
    through: NDArray[np.uint8],
    on: NDArray[np.uint8],
    start: int,
    stop: int,
) -> None:
    """Count for chosen pixels of rows ``start..stop`` how many other frames saw through them, and how many saw them.

    Parameters
    ----------
    depth, rays, chosen
        (h, w) meters, (h, w, 2) slopes, and which pixels count.
    others
        See `OtherFrames`.
    margins
        (n, 3): a point is seen through that lies nearer than the nearest depth z there by more than
        ``a + b z + c z^2``, and seen unless it lies behind the furthest by more than that.
    through, on
        (h, w) counts out; pixels that are not chosen are left as they are.
    """
    T_other_frame, pictures, slots, unit_m, camera = others
    height, width = depth.shape
    for v in range(start, stop):
        for u in range(width):
            z = np.float64(depth[v, u])
            if not chosen[v, u] or not z > 0.0:
                continue
            x, y = rays[v, u, 0] * z, rays[v, u, 1] * z
            passed, met = 0, 0
            for k in range(len(slots)):
                r, c, pz = pixel_of(x, y, z, T_other_frame[k], camera, width, height)
                if r < 0:
                    continue
                near, far = pictures[slots[k], r, c, 0], pictures[slots[k], r, c, 1]
                if near == 0:
                    continue
                margin = margins[k, 0] + pz * (margins[k, 1] + pz * margins[k, 2])
                if pz < near * unit_m - margin:
                    passed += 1
                elif pz < far * unit_m + margin:
                    met += 1
            through[v, u], on[v, u] = passed, met


@kernel
def measure_misfits(points: Doubles, others: OtherFrames, misfits: Doubles, start: int, stop: int) -> None:
    """Measure how far points (p, 3) lie from what the other frames ``start..stop`` show at them, in parts of the depth.

    `misfits` (n, p) is infinite where a frame shows nothing.
    """
    T_other_frame, pictures, slots, unit_m, camera = others
    height, width = pictures.shape[1], pictures.shape[2]
    for k in range(start, stop):
        for p in range(len(points)):
            misfits[k, p] = np.inf
            r, c, pz = pixel_of(points[p, 0], points[p, 1], points[p, 2], T_other_frame[k], camera, width, height)
            if r >= 0 and pictures[slots[k], r, c, 0] > 0:
                middle = 0.5 * (np.float64(pictures[slots[k], r, c, 0]) + np.float64(pictures[slots[k], r, c, 1]))
                misfits[k, p] = abs(middle * unit_m / pz - 1.0)


@kernel
def connect_surfaces(
    depth: Floats, chosen: NDArray[np.bool_], jump: float, groups: NDArray[np.int32], stack: NDArray[np.int32]
) -> int:
    """Number the connected surfaces of chosen pixels from 1 in `groups` (h, w), 0 elsewhere; return how many.

    Neighbors of which one is deeper by more than `jump` times the depth are not connected. `stack` has room for all
    pixels.
    """
    height, width = depth.shape
    groups[:, :] = 0
    count = 0
    for first in range(height * width):
        r, c = first // width, first % width
        if not chosen[r, c] or groups[r, c] or not depth[r, c] > 0.0:
            continue
        count += 1
        groups[r, c] = count
        stack[0] = first
        size = 1
        while size:
            size -= 1
            r, c = stack[size] // width, stack[size] % width
            for k in range(4):
                nr, nc = r + (k == 0) - (k == 1), c + (k == 2) - (k == 3)
                if nr < 0 or nc < 0 or nr >= height or nc >= width or groups[nr, nc] or not chosen[nr, nc]:
                    continue
                if not depth[nr, nc] > 0.0 or abs(depth[nr, nc] - depth[r, c]) > jump * depth[r, c]:
                    continue
                groups[nr, nc] = count
                stack[size] = nr * width + nc
                size += 1
    return count


@kernel
def spread_labels(
    depth: Floats,
    stride: int,
    coarse_labels: NDArray[np.uint8],
    coarse_depth: Floats,
    labels: NDArray[np.uint8],
    start: int,
    stop: int,
) -> None:
    """Give the pixels of rows ``start..stop`` the label of that pixel around, of every `stride`-th, next in depth.

    Where depth is not known the nearest one decides.
    """
    width = depth.shape[1]
    rows, columns = coarse_labels.shape
    for v in range(start, stop):
        for u in range(width):
            r, c = min((v + stride // 2) // stride, rows - 1), min((u + stride // 2) // stride, columns - 1)
            best, label = MAX_DIFFERENCE_M, coarse_labels[r, c]
            z = depth[v, u]
            if z > 0.0:
                for nr in range(max(v // stride, 0), min(v // stride + 2, rows)):
                    for nc in range(max(u // stride, 0), min(u // stride + 2, columns)):
                        there = coarse_depth[nr, nc]
                        if there > 0.0:
                            step = abs(there - z) + TIE_M * (abs(nr * stride - v) + abs(nc * stride - u))
                            if step < best:
                                best, label = step, coarse_labels[nr, nc]
            labels[v, u] = label
