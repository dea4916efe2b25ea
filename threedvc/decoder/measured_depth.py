# SPDX-License-Identifier: MIT
"""Depth as measured, decoded frame by frame as the camera's poses become known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.bounded_depth import depth_frames
from threedvc.errors import CorruptStream
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse
from threedvc.render.moved_depth import MovedDepth

__all__ = ["MeasuredDepth", "MeasuredRun"]


@dataclass(frozen=True, eq=False)
class MeasuredDepth:
    """The depth of one frame.

    Attributes
    ----------
    raw
        (h, w) uint16 of the depth camera, 0 = not measured.
    depth_scale
        Its units per meter.
    """

    raw: NDArray[np.uint16]
    depth_scale: float

    def shown(self, drawn: NDArray[np.float32], threads: int) -> NDArray[np.float32]:
        """Return the depth (h, w) in meters; pictures of another size keep what is drawn."""
        if drawn.shape != self.raw.shape:
            return drawn
        return np.asarray(self.raw / np.float64(self.depth_scale), dtype=np.float32)


class MeasuredRun:
    """The frames of a RESIDUAL.

    Parameters
    ----------
    payload
        Its payload.
    count
        Number of its frames.
    camera
        The depth camera.
    depth_scale
        Units per meter.
    threads
        Number of threads.
    """

    def __init__(self, payload: bytes, count: int, camera: Camera, depth_scale: float, threads: int) -> None:
        self._depth_scale = depth_scale
        self._poses: list[Pose] = []
        predict = MovedDepth(camera, self._poses, depth_scale, threads)
        self._frames = depth_frames(payload, camera.width, camera.height, count, predict, threads)
        self._left = count

    def next(self, T_world_camera: Pose) -> MeasuredDepth | None:
        """Return the depth of the next frame, which was taken from a pose; None after the last one.

        Raises
        ------
        CorruptStream
            If the payload is damaged.
        LimitExceeded
            If it speaks of more than a reader accepts.
        """
        if not self._left:
            return None
        self._left -= 1
        self._poses.append(inverse(T_world_camera))
        raw = next(self._frames)
        if not self._left and next(self._frames, None) is not None:  # its end is checked
            raise CorruptStream("measured depth has more frames than its packet tells; the stream is damaged")
        return MeasuredDepth(raw, self._depth_scale)
