# SPDX-License-Identifier: MIT
"""Features of pictures (ORB, Rublee et al. 2011), and which of two pictures' are the same."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles

__all__ = ["Descriptors", "detect_features", "match_features"]

Descriptors = NDArray[np.uint8]
"""(n, 32) binary descriptors of features."""
FAST_THRESHOLD = 7
"""Levels by which a corner differs from the circle around it: that which ORB-SLAM falls back to in plain pictures."""
ORB_BORDER = 31
"""Pixels at the border in which no features are looked for: the side of ORB's patch."""
MAX_RATIO = 0.8
"""The nearest descriptor must be nearer than this part of the second nearest's distance (Lowe 2004, sec. 7.1)."""


def detect_features(
    picture: NDArray[np.uint8], max_count: int, border: int = ORB_BORDER
) -> tuple[Doubles, Descriptors]:
    """Return pixels (n, 2) of features of a gray picture (h, w), and descriptors (n, 32)."""
    detector = cv2.ORB.create(max_count, edgeThreshold=border, fastThreshold=FAST_THRESHOLD)
    points, descriptors = detector.detectAndCompute(picture, None)
    if not len(points):
        return np.zeros((0, 2)), np.zeros((0, 32), np.uint8)
    return np.array([point.pt for point in points]), np.asarray(descriptors, dtype=np.uint8)


def match_features(query: Descriptors, train: Descriptors) -> tuple[list[int], list[int]]:
    """Return numbers of descriptors of one picture and of those in another that are clearly nearest to them."""
    pairs = [pair for pair in cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(query, train, k=2) if len(pair) == 2]
    clear = [best for best, second in pairs if best.distance < MAX_RATIO * second.distance]
    return [match.queryIdx for match in clear], [match.trainIdx for match in clear]
