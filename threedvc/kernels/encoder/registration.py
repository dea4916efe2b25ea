# SPDX-License-Identifier: MIT
"""Loops of registration: sampling a frame, association with a model's view, normal equations.

Points of the frame are ``p``, moved into the view's camera frame they are ``q``. Rows and chunks of
samples are fixed, whatever thread works on them, so sums do not depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats
from threedvc.kernels import kernel

__all__ = [
    "BEHIND",
    "FITTING",
    "LUMA_CENTER",
    "ROW",
    "UNKNOWNS",
    "UNSEEN",
    "ViewPictures",
    "accumulate_agreement",
    "accumulate_normal_equations",
    "associate",
    "estimate_normals",
    "halve_luma",
    "sample_frame",
    "sample_luma",
]

UNSEEN = 0
BEHIND = 1
FITTING = 2
"""States of a sample, see `associate`."""
UNKNOWNS = 8
"""Rotation, translation, gain and offset of luma."""
ROW = 11
"""Numbers that `associate` writes for a sample."""
LUMA_CENTER = 128.0
"""Level that gains leave as it is: in the middle of the range gain and offset hardly stand in for each other."""
SAME_RAY = 0.02
"""Slopes by which a point and the pixel that it falls on may differ: half a pixel of any camera is far less, and
where a distortion polynomial folds back it is far more."""
MIN_KNOWN = 3
"""Pixels of four that must be known for their mean: fewer lie too far to one side."""


class ViewPictures(NamedTuple):
    """A model's view, which samples of a frame are associated with.

    Attributes
    ----------
    depth, normals
        (h, w) meters, 0 = unknown, and (h, w, 3).
    luma, scale
        Luma of the view, shrunk by `scale`.
    rays, camera
        (h, w, 2) slopes and (9,) parameters of the camera.
    """

    depth: Floats
    normals: Floats
    luma: Floats
    scale: float
    rays: Doubles
    camera: Doubles


@kernel
def neighbor_step(
    depth: Floats, rays: Doubles, row: int, column: int, dr: int, dc: int, jump: float
) -> tuple[float, float, float]:
    """Return the surface step from one pixel towards another, or zeros across a hole or an edge."""
    height, width = depth.shape
    r, c = row + dr, column + dc
    if r < 0 or c < 0 or r >= height or c >= width:
        return 0.0, 0.0, 0.0
    z, here = float(depth[r, c]), float(depth[row, column])
    if not z > 0.0 or abs(z - here) > jump * here:
        return 0.0, 0.0, 0.0
    x = z * rays[r, c, 0] - here * rays[row, column, 0]
    y = z * rays[r, c, 1] - here * rays[row, column, 1]
    return x, y, z - here


@kernel
def surface_normal(
    depth: Floats, rays: Doubles, row: int, column: int, reach: int, jump: float
) -> tuple[float, float, float]:
    """Return the unit normal towards the camera at a pixel, or zeros where no surface can be told.

    Steps of `reach` pixels to both sides are added up where both exist, so that noise falls; at a hole
    or an edge one side serves.
    """
    ax, ay, az = neighbor_step(depth, rays, row, column, 0, reach, jump)
    bx, by, bz = neighbor_step(depth, rays, row, column, 0, -reach, jump)
    cx, cy, cz = neighbor_step(depth, rays, row, column, reach, 0, jump)
    dx, dy, dz = neighbor_step(depth, rays, row, column, -reach, 0, jump)
    ax, ay, az = ax - bx, ay - by, az - bz
    cx, cy, cz = cx - dx, cy - dy, cz - dz
    nx, ny, nz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    return nx / length, ny / length, nz / length


@kernel
def estimate_normals(
    depth: Floats, rays: Doubles, reach: int, jump: float, normals: Floats, start: int, stop: int
) -> None:
    """Write the normals (h, w, 3) of rows ``start..stop`` of a depth map; zeros where unknown."""
    for row in range(start, stop):
        for column in range(depth.shape[1]):
            normals[row, column, :] = 0.0
            if depth[row, column] > 0.0:
                x, y, z = surface_normal(depth, rays, row, column, reach, jump)
                normals[row, column, 0], normals[row, column, 1], normals[row, column, 2] = x, y, z


@kernel
def sample_frame(
    depth: Floats,
    mask: NDArray[np.bool_],
    rays: Doubles,
    stride: int,
    reach: int,
    jump: float,
    samples: Doubles,
    start: int,
    stop: int,
) -> None:
    """Write points, normals and pixels of every `stride`-th pixel of the sample rows ``start..stop``.

    `samples` (rows, columns, 8) receives ``x y z nx ny nz u v``; z = 0 marks a sample without surface.
    """
    for j in range(start, stop):
        for i in range(samples.shape[1]):
            row, column = j * stride + stride // 2, i * stride + stride // 2
            samples[j, i, 2] = 0.0
            z = float(depth[row, column])
            if not z > 0.0 or not mask[row, column]:
                continue
            nx, ny, nz = surface_normal(depth, rays, row, column, reach, jump)
            if nx == 0.0 and ny == 0.0 and nz == 0.0:
                continue
            samples[j, i, 0], samples[j, i, 1], samples[j, i, 2] = z * rays[row, column, 0], z * rays[row, column, 1], z
            samples[j, i, 3], samples[j, i, 4], samples[j, i, 5] = nx, ny, nz
            samples[j, i, 6], samples[j, i, 7] = column, row


@kernel
def halve_luma(luma: Floats, halved: Floats, start: int, stop: int) -> None:
    """Write rows ``start..stop`` of a picture of half the size: means of 2x2 pixels.

    NaN pixels are left out; fewer than three known pixels make NaN.
    """
    for row in range(start, stop):
        for column in range(halved.shape[1]):
            total = 0.0
            known = 0
            for dr in range(2):
                for dc in range(2):
                    value = luma[2 * row + dr, 2 * column + dc]
                    if value == value:
                        total += value
                        known += 1
            halved[row, column] = total / known if known >= MIN_KNOWN else np.nan


@kernel
def interpolate(luma: Floats, x: float, y: float) -> tuple[float, float, float]:
    """Return the bilinear value at (x, y) and its slopes along x and y; NaN beside unknown pixels."""
    height, width = luma.shape
    column, row = min(max(int(np.floor(x)), 0), width - 2), min(max(int(np.floor(y)), 0), height - 2)
    fx, fy = x - column, y - row
    a, b = luma[row, column], luma[row, column + 1]
    c, d = luma[row + 1, column], luma[row + 1, column + 1]
    top, bottom = a + fx * (b - a), c + fx * (d - c)
    return top + fy * (bottom - top), (b - a) + fy * ((d - c) - (b - a)), bottom - top


@kernel
def sample_luma(luma: Floats, scale: float, samples: Doubles, values: Doubles, start: int, stop: int) -> None:
    """Write the luma at the pixels of `samples` (n, 8) from a picture shrunk by `scale`."""
    for i in range(start, stop):
        x, y = (samples[i, 6] + 0.5) * scale - 0.5, (samples[i, 7] + 0.5) * scale - 0.5
        values[i], _, _ = interpolate(luma, x, y)


@kernel
def project(camera: Doubles, x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """Return pixel (u, v) of the ray slopes (x, y), and du/dx, du/dy, dv/dx, dv/dy."""
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    k1, k2, p1, p2, k3 = camera[4], camera[5], camera[6], camera[7], camera[8]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    u = fx * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + cx
    v = fy * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + cy
    cross = slope * x * y + 2.0 * (p1 * x + p2 * y)
    ux = fx * (radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x)
    vy = fy * (radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x)
    return u, v, ux, fx * cross, fy * cross, vy


@kernel
def associate(
    samples: Doubles,
    lumas: Doubles,
    sigmas: Doubles,
    view: ViewPictures,
    T_view_frame: Doubles,
    gates: Doubles,
    rows: Doubles,
    states: NDArray[np.uint8],
    start: int,
    stop: int,
) -> None:
    """Find for samples ``start..stop`` what the view shows at their place.

    Parameters
    ----------
    samples, lumas, sigmas
        (n, 8) of `sample_frame`, (n,) luma at this level and (n,) depth noise in meters.
    view
        See `ViewPictures`.
    T_view_frame
        (4, 4), ``q = T_view_frame @ p``.
    gates
        Largest distance relative to depth, in sigmas of depth noise, and smallest cosine between normals.
    rows
        (n, 11) out: ``q``, the view's normal, the distance to its plane, the luma's slope by q, the luma.
        NaN distance or luma: no such residual.
    states
        (n,) out: `UNSEEN` (nothing known there), `BEHIND` (another surface there) or `FITTING`.
    """
    view_depth, view_normals, view_luma, scale, rays, camera = view
    height, width = view_depth.shape
    for i in range(start, stop):
        states[i] = UNSEEN
        rows[i, 6], rows[i, 10] = np.nan, np.nan
        p, T = samples[i], T_view_frame
        qx = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
        qy = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
        qz = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        if not qz > 0.0:
            continue
        x, y = qx / qz, qy / qz
        u, v, ux, uy, vx, vy = project(camera, x, y)
        if not (u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5):
            continue
        column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
        z, rx, ry = float(view_depth[row, column]), rays[row, column, 0], rays[row, column, 1]
        # Far outside the picture a distortion polynomial may fold back into it.
        if not z > 0.0 or abs(rx - x) + abs(ry - y) > SAME_RAY:
            continue
        states[i] = BEHIND
        nx, ny, nz = view_normals[row, column, 0], view_normals[row, column, 1], view_normals[row, column, 2]
        ex, ey, ez = qx - z * rx, qy - z * ry, qz - z
        gate = max(gates[0] * z, gates[1] * sigmas[i])
        if ex * ex + ey * ey + ez * ez > gate * gate:
            continue
        mx = T[0, 0] * p[3] + T[0, 1] * p[4] + T[0, 2] * p[5]
        my = T[1, 0] * p[3] + T[1, 1] * p[4] + T[1, 2] * p[5]
        mz = T[2, 0] * p[3] + T[2, 1] * p[4] + T[2, 2] * p[5]
        if nx * mx + ny * my + nz * mz < gates[2]:
            continue
        states[i] = FITTING
        rows[i, 0], rows[i, 1], rows[i, 2] = qx, qy, qz
        rows[i, 3], rows[i, 4], rows[i, 5] = nx, ny, nz
        rows[i, 6] = nx * ex + ny * ey + nz * ez
        value, gu, gv = interpolate(view_luma, (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5)
        gx, gy = scale * (gu * ux + gv * vx) / qz, scale * (gu * uy + gv * vy) / qz
        rows[i, 7], rows[i, 8], rows[i, 9] = gx, gy, -(gx * x + gy * y)
        rows[i, 10] = value if lumas[i] == lumas[i] else np.nan


@kernel
def biweight(residual: float, bound: float) -> float:
    """Return Tukey's weight, 0 beyond `bound`."""
    ratio = residual / bound
    if not abs(ratio) < 1.0:
        return 0.0
    return (1.0 - ratio * ratio) ** 2


@kernel
def accumulate_normal_equations(
    rows: Doubles,
    lumas: Doubles,
    sigmas: Doubles,
    center: Doubles,
    exposure: Doubles,
    scales: Doubles,
    bound: float,
    chunk: int,
    sums: Doubles,
    start: int,
    stop: int,
) -> None:
    """Sum the normal equations of the sample chunks ``start..stop`` into their rows of `sums`.

    Unknowns are a rotation about `center` and a translation, both in the view's frame, then gain and
    offset of the frame's luma.

    Parameters
    ----------
    rows, lumas, sigmas
        As in `associate`.
    center
        (3,) meters.
    exposure
        Gain and offset: the view's luma is expected to be ``gain * (luma - 128) + offset``.
    scales
        Standard deviations of a depth residual in sigmas and of a luma residual, and the weights of both.
    bound
        Tukey's bound in those standard deviations.
    chunk
        Samples in a chunk.
    sums
        (chunks, 2, 8, 9) out: of the depth and of the luma residuals, the matrix, and the right side in
        its last column.
    """
    equation = np.zeros(UNKNOWNS + 1)
    for c in range(start, stop):
        sums[c, :, :, :] = 0.0
        for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
            for term in range(2):
                residual = rows[i, 6]
                deviation, factor, first = scales[0] * sigmas[i], scales[2], 3
                equation[6], equation[7] = 0.0, 0.0
                if term == 1:
                    level = lumas[i] - LUMA_CENTER
                    residual = rows[i, 10] - exposure[0] * level - exposure[1]
                    deviation, factor, first = scales[1], scales[3], 7
                    equation[6], equation[7] = -level, -1.0
                weight = factor * biweight(residual, bound * deviation) / (deviation * deviation)
                if weight == 0.0:
                    continue
                qx, qy, qz = rows[i, 0] - center[0], rows[i, 1] - center[1], rows[i, 2] - center[2]
                gx, gy, gz = rows[i, first], rows[i, first + 1], rows[i, first + 2]
                equation[0], equation[1], equation[2] = qy * gz - qz * gy, qz * gx - qx * gz, qx * gy - qy * gx
                equation[3], equation[4], equation[5] = gx, gy, gz
                equation[8] = residual
                for a in range(UNKNOWNS):
                    weighted = weight * equation[a]
                    for b in range(UNKNOWNS + 1):
                        sums[c, term, a, b] += weighted * equation[b]


@kernel
def accumulate_agreement(
    rows: Doubles,
    states: NDArray[np.uint8],
    surface: Doubles,
    sigma: Doubles,
    slopes: Doubles,
    luma: Doubles,
    rotation: Doubles,
    center: Doubles,
    focal: Doubles,
    every: int,
    shape: Doubles,
    picture: Doubles,
) -> None:
    """Sum products of what a small motion does to a sample by the view's account and by the frame's own.

    Parameters
    ----------
    rows, states
        (n, ROW) and (n,) as `associate` leaves them.
    surface, sigma
        (n, 8) rows of `sample_frame`, and (n,) depth noise in meters.
    slopes, luma
        (n, 2) slopes of the frame's luma by pixel, and (n,) that luma.
    rotation
        (3, 3) turn from the frame to the view.
    center
        (3,) about which motions turn, in the view's camera.
    focal
        fx and fy.
    every
        Of so many samples one counts.
    shape
        (6, 6) sums over normals, turn then shift, by 1 / sigma^2; added to.
    picture
        (8, 8) sums over slopes of luma, turn, shift, gain, offset; added to.
    """
    view, frame, seen = np.empty(UNKNOWNS), np.empty(UNKNOWNS), np.empty(3)
    for k in range(0, len(rows), every):
        arm_x, arm_y, arm_z = rows[k, 0] - center[0], rows[k, 1] - center[1], rows[k, 2] - center[2]
        for part in range(2):
            if part == 0:
                if states[k] != FITTING:
                    continue
                first, size = 3, 6
                a, b, c = surface[k, 3], surface[k, 4], surface[k, 5]
                weight = 1.0 / (sigma[k] * sigma[k])
            else:
                known = np.isfinite(rows[k, 10]) and np.isfinite(rows[k, 7]) and np.isfinite(luma[k])
                if not (known and np.isfinite(slopes[k, 0]) and np.isfinite(slopes[k, 1])):
                    continue
                first, size = 7, UNKNOWNS
                z = surface[k, 2]
                a, b = slopes[k, 0] * focal[0] / z, slopes[k, 1] * focal[1] / z
                c = -(a * surface[k, 0] + b * surface[k, 1]) / z
                weight = 1.0
            for row in range(3):
                seen[row] = rotation[row, 0] * a + rotation[row, 1] * b + rotation[row, 2] * c
                view[3 + row], frame[3 + row] = rows[k, first + row], seen[row]
            for account in (view, frame):
                account[0] = arm_y * account[5] - arm_z * account[4]
                account[1] = arm_z * account[3] - arm_x * account[5]
                account[2] = arm_x * account[4] - arm_y * account[3]
                account[6], account[7] = LUMA_CENTER - luma[k], -1.0
            sums = shape if part == 0 else picture
            for i in range(size):
                for j in range(size):
                    sums[i, j] += weight * view[i] * frame[j]
