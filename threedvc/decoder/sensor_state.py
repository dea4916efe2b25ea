# SPDX-License-Identifier: MIT
"""What a decoder keeps of each sensor: its cameras and clock, and what its next frame shows."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from threedvc.coding.gains import NEUTRAL, GainCoder
from threedvc.coding.poses import PoseCoder
from threedvc.errors import ConfigError, CorruptStream
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, identity, make_pose
from threedvc.render.captured_depth import FilmedDepth
from threedvc.stream.packets import RunHeader, SensorHeader, StreamHeader

__all__ = ["FrameRun", "SensorState", "nearest_multiple", "rig_of"]


def rig_of(header: StreamHeader | SensorHeader) -> CameraRig:
    """Return the cameras of a stream's first sensor, or of a further one.

    Raises
    ------
    CorruptStream
        If they are impossible.
    """
    try:
        color = _camera(header.color_camera)
        depth = _camera(header.depth_camera) if header.depth_camera else color
        mount = header.T_depth_base if isinstance(header, SensorHeader) else ()
        return CameraRig(
            color=color, depth=depth, T_color_depth=_transform(header.T_color_depth), T_depth_base=_transform(mount)
        )
    except ConfigError as error:
        raise CorruptStream(f"{header.packet_type.name} header: {error}") from None


def _transform(rows: tuple[float, ...]) -> Pose:
    """Return the transform of three rows, row by row; the identity if there are none."""
    if not rows:
        return identity()
    matrix = np.array(rows, dtype=np.float64).reshape(3, 4)
    return make_pose(matrix[:, :3], matrix[:, 3])


def nearest_multiple(frame: int, period_num: int, period_den: int) -> int:
    """Return ``frame * period_num / period_den`` rounded to the nearest integer, halves up."""
    return (2 * frame * period_num + period_den) // (2 * period_den)


def _camera(values: tuple[float, ...]) -> Camera:
    width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3 = values
    return Camera(
        width=int(width), height=int(height), fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3)
    )  # fmt: skip


class SensorState:
    """One sensor.

    Attributes
    ----------
    header, rig
        Its description.
    frames
        How many frames it has taken so far.
    shift, gain, correction_ns, filmed
        Of the next frame that it takes.
    """

    def __init__(self, header: StreamHeader | SensorHeader, steps: tuple[float, float]) -> None:
        self.header, self.rig = header, rig_of(header)
        self.frames = 0
        self.shift, self.shifts = identity(), PoseCoder(*steps)
        self.gain, self.gains = NEUTRAL, GainCoder(header.grey)
        self.correction_ns = 0
        self.filmed: FilmedDepth | None = None

    def next_time(self) -> int:
        """Return the time of its next frame."""
        header = self.header
        nominal = header.start_ns + nearest_multiple(self.frames, header.period_num, header.period_den)
        time, self.correction_ns = nominal + self.correction_ns, 0
        return time

    def next_filmed(self) -> FilmedDepth | None:
        """Return the depth of its next frame, if there is a video of it."""
        filmed, self.filmed = self.filmed, None
        return filmed


class FrameRun:
    """Frames of one BATCH that runs count: those of one sensor, or the first ones of all moments.

    Parameters
    ----------
    before
        How many such frames there were before the BATCH.
    frames
        Those in it.
    """

    def __init__(self, before: int, frames: Sequence[int]) -> None:
        self._before, self._frames = before, frames

    def of(self, header: RunHeader) -> tuple[int, Sequence[int]] | None:
        """Return the number of the first frame of a header, and all its frames; None if they are not there."""
        place = bisect_left(self._frames, header.frame)
        frames = self._frames[place : place + header.count]
        if len(frames) < header.count or frames[0] != header.frame:
            return None
        return self._before + place, frames
