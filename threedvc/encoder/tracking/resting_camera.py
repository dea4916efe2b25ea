# SPDX-License-Identifier: MIT
"""Whether a camera stands still, by its pictures: before any model, and however much moves in front of it.

A person who fills a third of the picture pulls a tracked camera along; the edges of all else stay where they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats, Mask
from threedvc.frames.sequence import FrameSequence

__all__ = ["camera_rests"]

SAMPLED_FRAMES = 12
"""Frames that are held against the first one, spread over the sequence."""
BLUR_PX = 1.0
"""Standard deviation of the blur that takes most of the noise off."""
MIN_SLOPE = 6.0
"""Levels a pixel from which on there is an edge: noise of a good camera has one or two once it is blurred."""
MAX_SHIFT_PX, SPARE_LEVELS = 0.5, 2.0
"""An edge has stayed if its level changed by no more than so long a shift makes, and by noise."""
MIN_STAYED, MIN_USUALLY_STAYED = 0.45, 0.55
"""Share of the edges that stayed in every sampled frame, and in half of them. Measured: .52 at least before four
cameras at rest, whatever moved; .34 at most in the second sample or before where a hand held them."""
MAX_CHANGE = 0.03
"""Part of a depth by which it may change: noise of sensors at the end of their range."""
MIN_EDGES = 200
"""Pixels of edges of each kind without which nothing can be told."""
SOBEL = 8
"""The sum of the weights of its operator, which gives levels a pixel."""
DARK = 16.0
"""Level from which on gains of the camera are measured."""


def camera_rests(frames: FrameSequence) -> bool:
    """Tell whether the camera stands still: most edges, upright and level ones, and most depth stay in place."""
    if len(frames) < 2:
        return False
    first = _luma(frames[0].color)
    across, down = _slopes(first, 1, 0), _slopes(first, 0, 1)
    upright, level = (across > down) & (across > MIN_SLOPE), (down >= across) & (down > MIN_SLOPE)
    if min(np.count_nonzero(upright), np.count_nonzero(level)) < MIN_EDGES:
        return False
    stayed = list(_stayed(frames, first, frames[0].depth, [(upright, across[upright]), (level, down[level])]))
    return min(stayed) >= MIN_STAYED and float(np.median(stayed)) >= MIN_USUALLY_STAYED


def _stayed(
    frames: FrameSequence, first: Floats, depth: Floats, edges: Sequence[tuple[Mask, Floats]]
) -> Iterator[float]:
    """Yield the share of edges and of depth that stayed in sampled frames; end with the first that has too little.

    Edges are kinds of pixels (h, w), and how steep these are (n,); the least share of a kind, or of depth, counts.
    """
    share = 1.0
    for number in sorted({int(each) for each in np.linspace(1, len(frames) - 1, SAMPLED_FRAMES)}):
        if share < MIN_STAYED:
            return
        frame = frames[number]
        luma = _luma(frame.color)
        bright = (luma > DARK) & (first > DARK)
        gain = float(np.median(luma[bright] / first[bright])) if bright.any() else 1.0
        changes = np.abs(luma / gain - first)
        stayed = [float(np.mean(changes[kind] < MAX_SHIFT_PX * slopes + SPARE_LEVELS)) for kind, slopes in edges]
        share = min(*stayed, _same_depth(depth, frame.depth))
        yield share


def _same_depth(first: Floats, depth: Floats) -> float:
    """Return the share of pixels (h, w) measured in two frames that are about as far in both; 1 if there are none."""
    both = (first > 0) & (depth > 0)
    return float(np.mean(np.abs(depth - first)[both] < MAX_CHANGE * first[both])) if both.any() else 1.0


def _luma(color: NDArray[np.uint8]) -> Floats:
    """Return the blurred luma (h, w) of an RGB picture (h, w, 3)."""
    gray = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(gray, (0, 0), BLUR_PX), dtype=np.float32)


def _slopes(luma: Floats, across: int, down: int) -> Floats:
    """Return the absolute slope (h, w) of luma in levels a pixel, in one direction."""
    slopes = cv2.Sobel(luma, cv2.CV_32F, across, down, ksize=3) / SOBEL
    return np.abs(slopes).astype(np.float32)
