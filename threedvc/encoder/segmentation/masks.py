# SPDX-License-Identifier: MIT
"""Segmentation of a frame by what comes with it, before anything is known about motion: by masks, or by depth.

The result is a label picture in the depth camera: 0 is the background object, every other label a rigid object.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.config import SegmentationConfig, SegmentationMode
from threedvc.errors import SequenceError
from threedvc.frames.frame import Frame, SequenceInfo

__all__ = ["resolved_mode", "segment"]

OBJECT_LABEL = 1
"""Label of the one object that a range of depth tells from the background, 0."""


def resolved_mode(config: SegmentationConfig, info: SequenceInfo) -> SegmentationMode:
    """Return the mode that is meant: automatic means masks where the sequence has them, else none."""
    if config.mode is not SegmentationMode.AUTO:
        return config.mode
    return SegmentationMode.MASKS if info.has_masks else SegmentationMode.NONE


def segment(frame: Frame, config: SegmentationConfig, info: SequenceInfo) -> NDArray[np.uint8]:
    """Label the pixels of a frame's depth picture.

    Parameters
    ----------
    frame
        The frame; its mask is used in mask mode.
    config
        ``none``: all pixels are object 0. ``depth``: pixels with ``near_m <= depth < far_m`` are object
        1, all others, also those without depth, the static background 0. ``masks``: as in the mask.
    info
        What the sequence has.

    Returns
    -------
    numpy.ndarray
        (h, w) uint8 labels in the depth camera.

    Raises
    ------
    SequenceError
        If masks are asked for and this frame has none, or one of another size than its depth.
    """
    mode = resolved_mode(config, info)
    if mode is SegmentationMode.MASKS:
        return _mask_labels(frame, info)
    if mode is SegmentationMode.DEPTH:
        inside = (frame.depth >= config.near_m) & (frame.depth < config.far_m) & (frame.depth > 0)
        return np.where(inside, np.uint8(OBJECT_LABEL), np.uint8(0))
    return np.zeros(frame.depth.shape, dtype=np.uint8)


def _mask_labels(frame: Frame, info: SequenceInfo) -> NDArray[np.uint8]:
    if frame.mask is None:
        raise SequenceError(f"{info.name}: frame {frame.index} has no mask; add it, or use --segment none")
    if frame.mask.shape != frame.depth.shape:
        raise SequenceError(
            f"{info.name}: mask of frame {frame.index} has {_size(frame.mask)} pixels, its depth {_size(frame.depth)}; "
            "masks belong to the depth camera"
        )
    return frame.mask


def _size(picture: NDArray[np.generic]) -> str:
    return f"{picture.shape[1]}x{picture.shape[0]}"
