# SPDX-License-Identifier: MIT
"""What a decoder keeps of each sensor: its cameras and clock, and what its next frame shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.gains import NEUTRAL, GainCoder
from threedvc.coding.poses import PoseCoder
from threedvc.coding.video.planes import ShownColor
from threedvc.decoder.measured_depth import MeasuredDepth, MeasuredRun
from threedvc.geometry.pose import Pose, identity
from threedvc.render.captured_depth import CapturedDepth
from threedvc.stream.headers import SensorHeader, StreamHeader
from threedvc.stream.sensor_description import nearest_multiple, rig_of

__all__ = ["SensorState"]


class SensorState:
    """One sensor.

    Parameters
    ----------
    header
        Its description.
    shift_coder
        Decodes where its depth camera stood when color pictures were taken.

    Attributes
    ----------
    header, rig
        Its description.
    frames
        How many frames it has taken so far.
    shift_coder, gain_coder
        Decoders of its SHIFT and GAIN packets.
    shift, gain
        Those of the next frame that it takes: see `FrameState`.
    """

    def __init__(self, header: StreamHeader | SensorHeader, shift_coder: PoseCoder) -> None:
        self.header, self.rig = header, rig_of(header)
        self.frames = 0
        self.shift_coder, self.gain_coder = shift_coder, GainCoder(header.gray)
        self.shift, self.gain = identity(), NEUTRAL
        self._correction_ns = 0
        self._captured_depth: CapturedDepth | None = None
        self._captured_color: ShownColor | None = None
        self._measured_run: MeasuredRun | None = None

    def set_shift(self, T_shifted_camera: Pose) -> None:
        """Place the depth camera for color pictures, from the next frame on."""
        self.shift = T_shifted_camera

    def set_gain(self, gain: NDArray[np.int64]) -> None:
        """Set the gain (3, 2) of the color camera, from the next frame on."""
        self.gain = gain

    def set_clock_correction(self, correction_ns: int) -> None:
        """Let the next frame alone stand so much later than the regular clock says."""
        self._correction_ns = correction_ns

    def set_captured_depth(self, depth: CapturedDepth) -> None:
        """Let a depth picture stand for the drawn one in the next frame alone."""
        self._captured_depth = depth

    def set_captured_color(self, color: ShownColor) -> None:
        """Let a color picture stand for the drawn one in the next frame alone."""
        self._captured_color = color

    def begin_measured_run(self, run: MeasuredRun) -> None:
        """Let measured depths stand for the drawn ones from the next frame on, as long as they last."""
        self._measured_run = run

    def take_time_ns(self) -> int:
        """Return the time of its next frame, whose correction is then used up."""
        header = self.header
        nominal = header.start_ns + nearest_multiple(self.frames, header.period_num, header.period_den)
        time, self._correction_ns = nominal + self._correction_ns, 0
        return time

    def take_captured_depth(self, T_world_camera: Pose) -> CapturedDepth | MeasuredDepth | None:
        """Return the depth of its next frame, taken from a pose, if the stream has it, which is then used up."""
        depth, self._captured_depth = self._captured_depth, None
        measured = None if self._measured_run is None else self._measured_run.next(T_world_camera)
        return measured or depth

    def take_captured_color(self) -> ShownColor | None:
        """Return the color of its next frame, if there is a video of it, which is then used up."""
        color, self._captured_color = self._captured_color, None
        return color
