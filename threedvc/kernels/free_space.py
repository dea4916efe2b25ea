# SPDX-License-Identifier: MIT
"""Loops of the division by motion: what other frames saw through, connected surfaces, labels of all pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.kernels import kernel
from threedvc.kernels.fusion import project_point

__all__ = ["connect_surfaces", "count_sights", "spread_labels"]

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]


@kernel
def count_sights(
    depth: Floats,
    rays: Doubles,
    chosen: NDArray[np.bool_],
    T_other_frame: Doubles,
    nearest: NDArray[np.uint16],
    furthest: NDArray[np.uint16],
    unit_m: float,
    camera: Doubles,
    margins: Doubles,
    through: NDArray[np.uint8],
    on: NDArray[np.uint8],
    start: int,
    stop: int,
) -> None:
    """Count for the points of rows ``start..stop`` how many other frames saw through them, and how many saw them.

    Parameters
    ----------
    depth, rays, chosen
        (h, w) metres, (h, w, 2) slopes, and which pixels count.
    T_other_frame
        (n, 4, 4): where the points would be before the camera of each other frame.
    nearest, furthest
        (n, h, w) least and largest depth about each pixel of the other frames in units of `unit_m`, 0 = unknown; the
        camera is the same.
    camera
        (10,) parameters of the camera.
    margins
        (n, 3): a point is seen through that lies nearer than the nearest depth z there by more than
        ``a + b z + c z^2``, and seen unless it lies behind the furthest by more than that.
    through, on
        (h, w) counts out.
    """
    height, width = depth.shape
    for v in range(start, stop):
        for u in range(width):
            through[v, u], on[v, u] = 0, 0
            z = np.float64(depth[v, u])
            if not z > 0.0 or not chosen[v, u]:
                continue
            x, y = rays[v, u, 0] * z, rays[v, u, 1] * z
            for k in range(T_other_frame.shape[0]):
                T = T_other_frame[k]
                pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
                if pz < 0.05:
                    continue
                px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
                py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
                # Far outside the picture a distortion polynomial may fold back into it.
                if abs(px) > 1.5 * pz or abs(py) > 1.5 * pz:
                    continue
                fu, fv = project_point(px, py, pz, camera)
                c, r = np.int64(np.floor(fu + 0.5)), np.int64(np.floor(fv + 0.5))
                if c < 0 or r < 0 or c >= width or r >= height or nearest[k, r, c] == 0:
                    continue
                margin = margins[k, 0] + pz * (margins[k, 1] + pz * margins[k, 2])
                if pz < nearest[k, r, c] * unit_m - margin:
                    through[v, u] += 1
                elif pz < furthest[k, r, c] * unit_m + margin:
                    on[v, u] += 1


@kernel
def connect_surfaces(
    depth: Floats, chosen: NDArray[np.bool_], jump: float, groups: NDArray[np.int32], stack: NDArray[np.int32]
) -> int:
    """Number the connected surfaces of chosen pixels from 1 in `groups` (h, w), 0 elsewhere; return how many.

    Neighbours of which one is deeper by more than `jump` times the depth are not connected. `stack` has room for all
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
            best, label = 1e9, coarse_labels[r, c]
            z = depth[v, u]
            if z > 0.0:
                for nr in range(max(v // stride, 0), min(v // stride + 2, rows)):
                    for nc in range(max(u // stride, 0), min(u // stride + 2, columns)):
                        there = coarse_depth[nr, nc]
                        if there > 0.0:
                            step = abs(there - z) + 1e-6 * (abs(nr * stride - v) + abs(nc * stride - u))
                            if step < best:
                                best, label = step, coarse_labels[nr, nc]
            labels[v, u] = label
