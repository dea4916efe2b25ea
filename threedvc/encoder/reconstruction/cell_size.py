# SPDX-License-Identifier: MIT
"""The size of a cell: asked for, or from the distance of a surface, the pixels that see it, and the rate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Mask
from threedvc.config import EncoderConfig
from threedvc.config.encoder import MIN_VOXEL_SIZE_M
from threedvc.encoder.rate.rate_control import live_cell_factor
from threedvc.encoder.reconstruction.frame_intake import SETTLED_SHARE
from threedvc.encoder.reconstruction.scene_object import MIN_PIXELS, SceneObject
from threedvc.encoder.registration.frame_resolutions import FrameResolutions
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import CameraRig

__all__ = ["CellSizes", "default_voxel_size"]

PIXELS_PER_CELL = 4.0
"""Pixels of a 640x480 picture that a cell covers: with fewer, cells cost more than the pictures gain by them."""
MIN_PIXELS_PER_CELL = 1.3
"""Cells of fewer pixels would have holes between the rays."""
REFERENCE_PIXELS = 640 * 480
"""Of the picture that `PIXELS_PER_CELL` counts in."""
BACKGROUND_IMAGE_FACTOR = 1.1
"""A background at rest before a camera at rest is colored by a picture: its cells may be a little wider."""
TRANSIENT_FACTOR = 2.0
"""By how much wider the cells are of what is there for a moment."""
RESIZED = 4
"""Cells of a background that only specks have shown are chosen anew where a frame has so many times the depth."""
SIZE_DIGITS = 4
"""Edges are rounded to a tenth of a millimeter: the stream tells them."""


def default_voxel_size(depth: NDArray[np.float32], mask: NDArray[np.bool_], rig: CameraRig) -> float:
    """Choose a cell that covers about 4 pixels of a 640x480 picture at the depth that 3/4 of an object do not exceed.

    Small pictures get finer cells against their pixels; the size is rounded to a millimeter.
    """
    seen = depth[mask & (depth > 0)]
    distance = float(np.percentile(seen, 75)) if len(seen) else 1.0
    pixels = max(PIXELS_PER_CELL * float(np.sqrt(depth.size / REFERENCE_PIXELS)), MIN_PIXELS_PER_CELL)
    return max(round(pixels * distance / rig.depth.fx, 3), 0.001)


class CellSizes:
    """Chooses the edges of objects' cells.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.
    """

    def __init__(self, info: SequenceInfo, config: EncoderConfig) -> None:
        self._info, self._config = info, config
        self._live_factor: float | None = None

    def observe(self, frame: Frame, labels: NDArray[np.uint8]) -> None:
        """Let the first frame that shows much tell by how much wider cells a live encoder takes for its rate."""
        if self._live_factor is None:
            self._live_factor = self._rated_factor(frame, labels)

    def size_for(
        self, number: int, views: FrameResolutions, mask: Mask, *, tracked: bool, transient: bool = False
    ) -> float:
        """Return the edge of the cells of an object that a frame shows at `mask` (h, w), meters."""
        size = self._size(number, views, mask, tracked=tracked)
        return max(round(TRANSIENT_FACTOR * size, SIZE_DIGITS), MIN_VOXEL_SIZE_M) if transient else size

    def outgrown(self, background: SceneObject, shown: int, frame: Frame) -> bool:
        """Tell whether a frame shows so much more of the background than those before that its cells follow from it."""
        by_specks = background.sized_by < SETTLED_SHARE * frame.depth.size and self._config.voxel_size_m is None
        return by_specks and shown >= max(RESIZED * background.sized_by, MIN_PIXELS)

    def _size(self, number: int, views: FrameResolutions, mask: Mask, *, tracked: bool) -> float:
        if self._config.voxel_size_m is not None:
            return self._config.voxel_size_m
        size = default_voxel_size(views.frame.depth, mask, views.rig)
        if number == 0 and not tracked and not self._info.has_camera_poses and not self._config.causal:
            size *= BACKGROUND_IMAGE_FACTOR
        size *= self._config.cell_factor * (self._live_factor or 1.0)
        return max(round(size, SIZE_DIGITS), MIN_VOXEL_SIZE_M)

    def _rated_factor(self, frame: Frame, labels: NDArray[np.uint8]) -> float:
        rate = self._config.bitrate_bps
        if rate is None or not self._config.causal or not frame.depth.any():
            return 1.0
        cells, rig = 0.0, self._info.rigs[frame.sensor]
        for number in np.unique(labels).tolist():
            mask = labels == number
            pixel = frame.depth[mask] / rig.depth.fx
            area = float(np.square(pixel, dtype=np.float64).sum())
            cells += area / default_voxel_size(frame.depth, mask, rig) ** 2
        return live_cell_factor(cells, rate / 8)
