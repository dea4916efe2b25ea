# SPDX-License-Identifier: MIT
"""Frames at the working resolution of the segmentation."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import CameraRig
from threedvc.kernels.encoder.free_space import spread_labels
from threedvc.parallel import for_ranges

__all__ = ["WORKING_PIXELS", "Downsampling"]

WORKING_PIXELS = 80_000
"""Pixels that frames are downsampled to at most: 640x480 becomes 320x240, which takes about 0.1 s a frame (decision
0016)."""


class Downsampling:
    """Frames at every n-th pixel, so that no more than `WORKING_PIXELS` are left.

    Parameters
    ----------
    info
        The sequence.

    Attributes
    ----------
    stride
        n.
    rig
        Cameras of the downsampled frames.
    """

    def __init__(self, info: SequenceInfo) -> None:
        camera = info.rig.depth
        self.stride = 1
        while camera.width * camera.height > WORKING_PIXELS * self.stride**2:
            self.stride += 1
        self._registered = info.rig.registered
        small = camera.every(self.stride)
        self.rig = CameraRig.registered_to(small) if self._registered else replace(info.rig, depth=small)

    def downsampled(self, frame: Frame) -> Frame:
        """Return a frame downsampled, without its mask."""
        n, color = self.stride, frame.color
        if self._registered and n > 1:
            color = np.ascontiguousarray(cv2.blur(color, (n, n))[::n, ::n])
        return replace(frame, color=color, depth=self._downsampled_depth(frame.depth), mask=None)

    def _downsampled_depth(self, depth: Floats) -> Floats:
        return np.ascontiguousarray(depth[:: self.stride, :: self.stride])

    def upsample_labels(self, labels: NDArray[np.uint8], depth: Floats, threads: int) -> NDArray[np.uint8]:
        """Return the labels of all pixels of a depth picture (h, w) from those of the downsampled one."""
        full, small = np.empty(depth.shape, np.uint8), self._downsampled_depth(depth)

        def work(start: int, stop: int) -> None:
            spread_labels(depth, self.stride, labels, small, full, start, stop)

        for_ranges(work, len(depth), threads)
        return full
