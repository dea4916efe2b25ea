# SPDX-License-Identifier: MIT
"""What a decoder keeps of each sensor: its cameras and clock, and what its next frame shows."""

from __future__ import annotations

from threedvc.coding.gains import NEUTRAL, GainCoder
from threedvc.coding.poses import PoseCoder
from threedvc.geometry.pose import identity
from threedvc.render.captured_depth import CapturedDepth
from threedvc.stream.headers import SensorHeader, StreamHeader
from threedvc.stream.sensor_description import nearest_multiple, rig_of

__all__ = ["SensorState"]


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
        self.filmed: CapturedDepth | None = None

    def next_time(self) -> int:
        """Return the time of its next frame."""
        header = self.header
        nominal = header.start_ns + nearest_multiple(self.frames, header.period_num, header.period_den)
        time, self.correction_ns = nominal + self.correction_ns, 0
        return time

    def next_filmed(self) -> CapturedDepth | None:
        """Return the depth of its next frame, if there is a video of it."""
        filmed, self.filmed = self.filmed, None
        return filmed
