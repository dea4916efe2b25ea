# SPDX-License-Identifier: MIT
"""Cameras that cannot be, and matrices whose order their writer mixed up."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from threedvc.errors import SequenceError
from threedvc.formats.sources.notices import Notice
from threedvc.geometry.camera import Camera, CameraRig

__all__ = ["check_camera", "check_rig", "doubts_of", "matrix_parameters"]

EDGE = 0.02
"""Share of the picture: a principal point that near its edge, or beyond, is that of another picture's size or unit."""
MIN_VIEW_DEG, MAX_VIEW_DEG = 5.0, 150.0
"""No depth camera is a telescope, and a pinhole model does not hold for a fisheye."""
MAX_PIXEL_RATIO = 2.0
"""Of width and height of pixels, or the other way round: beyond, focal lengths or their order are wrong."""
DOUBTFUL_PIXEL_RATIO = 1.5
"""Pictures that were resized to another shape have pixels up to 1.33 times as wide as high (16:9 to 4:3)."""
MAX_BASELINE_M = 1.0
"""Cameras of one sensor are centimeters apart; millimeters taken for meters make that tens of meters."""
MAX_BETWEEN_AXES_DEG = 90.0
"""Cameras of one sensor that look apart so far share no view."""
CENTERED = (0.38, 0.62)
"""Where principal points lie in width and height; one that is off by the same share in both is of another size."""
SAME_SHARE = 0.03
"""Of width and height, by which a principal point's places in both may differ to be the same share."""


def matrix_parameters(matrix: Sequence[float], source: str) -> list[float]:
    """Return fx, fy, cx, cy of the nine numbers of a camera matrix, by columns or by rows, whichever they are in.

    Raises
    ------
    SequenceError
        If the numbers are not nine, or could be neither or both.
    """
    if len(matrix) != 9:
        raise SequenceError(f"{source}: {len(matrix)} numbers, expected the 9 of a 3x3 matrix; correct the file")
    by_rows, by_columns = (matrix[2], matrix[5]), (matrix[6], matrix[7])
    if any(by_rows) == any(by_columns):
        raise SequenceError(
            f"{source}: has cx, cy = {by_columns[0]:g}, {by_columns[1]:g} if written by columns, as Open3D does, and "
            f"{by_rows[0]:g}, {by_rows[1]:g} if by rows; correct the matrix: fx 0 0 0 fy 0 cx cy 1"
        )
    return [matrix[0], matrix[4], *(by_rows if any(by_rows) else by_columns)]


def check_camera(camera: Camera, source: str, remedy: str) -> None:
    """Check that a camera of an RGB-D sensor could be this one.

    Raises
    ------
    SequenceError
        If its principal point lies at or beyond the edge, it sees too little or too much, or its pixels are far from
        square.
    """
    width, height = camera.width, camera.height
    at = camera.cx / width, camera.cy / height
    if not all(EDGE <= share <= 1 - EDGE for share in at):
        raise SequenceError(
            f"{source}: principal point {camera.cx:g},{camera.cy:g} is not inside pictures of {width}x{height}; "
            f"{remedy} in pixels of these pictures"
        )
    for name, focal, side in (("fx", camera.fx, width), ("fy", camera.fy, height)):
        view = math.degrees(2 * math.atan(side / 2 / focal))
        if not MIN_VIEW_DEG <= view <= MAX_VIEW_DEG:
            raise SequenceError(
                f"{source}: {name} {focal:g} sees {view:.3g} degrees in {side} pixels; {remedy} in pixels of these "
                "pictures"
            )
    ratio = max(camera.fx / camera.fy, camera.fy / camera.fx)
    if ratio > MAX_PIXEL_RATIO:
        raise SequenceError(
            f"{source}: fx {camera.fx:g} and fy {camera.fy:g} differ {ratio:.2g} times; {remedy} in this order"
        )


def check_rig(rig: CameraRig, source: str) -> None:
    """Check that the color and the depth camera of one sensor could lie so.

    Raises
    ------
    SequenceError
        If they are meters apart or look away from each other.
    """
    apart = float(np.linalg.norm(rig.T_color_depth[:3, 3]))
    if apart > MAX_BASELINE_M:
        raise SequenceError(
            f"{source}: T_color_depth puts the color camera {apart:.3g} m from the depth camera; write its "
            "translation in meters"
        )
    between = math.degrees(math.acos(float(np.clip(rig.T_color_depth[2, 2], -1, 1))))
    if between >= MAX_BETWEEN_AXES_DEG:
        raise SequenceError(
            f"{source}: T_color_depth turns the color camera by {between:.0f} degrees from the depth camera's view; "
            "write it for axes x right, y down, z forward"
        )


def doubts_of(camera: Camera, source: str) -> list[Notice]:
    """Return what is odd about a camera that could be."""
    doubts = []
    across, down = (camera.cx + 0.5) / camera.width, (camera.cy + 0.5) / camera.height
    if abs(across - down) < SAME_SHARE and not CENTERED[0] < across < CENTERED[1]:
        width, height = round(2 * camera.cx + 1), round(2 * camera.cy + 1)
        doubts.append(
            f"{source}: principal point {camera.cx:g},{camera.cy:g} lies at {across:.0%} of width and height; this "
            f"looks like a camera of {width}x{height} pictures, and these are {camera.width}x{camera.height}: scale "
            "fx, fy, cx, cy if it is"
        )
    ratio = max(camera.fx / camera.fy, camera.fy / camera.fx)
    if ratio > DOUBTFUL_PIXEL_RATIO:
        doubts.append(
            f"{source}: fx {camera.fx:g} and fy {camera.fy:g} differ {ratio:.2g} times; the order is fx, fy, cx, cy"
        )
    return [Notice(text, warning=True) for text in doubts]
