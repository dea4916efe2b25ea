# SPDX-License-Identifier: MIT
"""Depth as measured, decoded frame by frame as the camera's poses become known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.measured_depth.bounded_depth import depth_frames
from threedvc.coding.measured_depth.saturated import SaturatedPixels
from threedvc.errors import CorruptStream
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose, inverse
from threedvc.render.moved_depth import MovedDepth
from threedvc.stream.captured_headers import ResidualHeader
from threedvc.stream.wire import ByteReader

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
    saturated
        (h, w) where the largest raw depth stood in place of 0, None: nowhere.
    """

    raw: NDArray[np.uint16]
    depth_scale: float
    saturated: NDArray[np.bool_] | None = None

    def shown(self, drawn: NDArray[np.float32], threads: int) -> NDArray[np.float32]:
        """Return the depth (h, w) in meters; pictures of another size keep what is drawn."""
        if drawn.shape != self.raw.shape:
            return drawn
        return np.asarray(self.raw / np.float64(self.depth_scale), dtype=np.float32)


class MeasuredRun:
    """The frames of a RESIDUAL.

    Parameters
    ----------
    header
        Its header.
    payload
        Its payload.
    camera
        The depth camera.
    depth_scale
        Units per meter.
    threads
        Number of threads.

    Raises
    ------
    CorruptStream
        If what is told of saturated pixels is damaged.
    """

    def __init__(
        self, header: ResidualHeader, payload: bytes, camera: Camera, depth_scale: float, threads: int
    ) -> None:
        self._depth_scale, self._left = depth_scale, header.count
        self._poses: list[Pose] = []
        reader = ByteReader(payload)
        pixels = header.count * camera.width * camera.height
        self._saturated = SaturatedPixels(reader, pixels) if header.saturated else None
        predict = MovedDepth(camera, self._poses, depth_scale, threads)
        rest = reader.take(reader.remaining)
        self._frames = depth_frames(rest, camera.width, camera.height, header.count, predict, threads)

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
        saturated = None
        if self._saturated is not None:
            found = self._saturated.of(raw)
            saturated = found if found.any() else None
            if not self._left:
                self._saturated.finish()
        return MeasuredDepth(raw, self._depth_scale, saturated)
