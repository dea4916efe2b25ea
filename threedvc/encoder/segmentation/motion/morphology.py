# SPDX-License-Identifier: MIT
"""Masks without their specks, without their gaps, and grown."""

from __future__ import annotations

import cv2
import numpy as np

from threedvc.arrays import Mask

__all__ = ["closed", "grown", "opened", "square"]


def square(side: int) -> cv2.typing.MatLike:
    """Return a structuring element of `side` by `side` pixels."""
    return np.ones((side, side), np.uint8)


def opened(mask: Mask) -> Mask:
    """Return a mask (h, w) without what is less than three pixels wide."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, square(3)) > 0


def closed(mask: Mask) -> Mask:
    """Return a mask (h, w) without gaps that are less than three pixels wide."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, square(3)) > 0


def grown(mask: Mask, pixels: int) -> Mask:
    """Return a mask (h, w) with all that lies within so many pixels, along rows and columns."""
    return cv2.dilate(mask.astype(np.uint8), square(2 * pixels + 1)) > 0
