# SPDX-License-Identifier: MIT
"""Coding of the color camera's gains: exposure and white balance of every frame against those of the models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.entropy.range_coder import RangeCoder, RangeReader, RangeWriter, new_counters
from threedvc.errors import CorruptStream
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS

__all__ = ["NEUTRAL", "GainCoder", "apply_gain", "quantized_gain"]

GAIN_UNIT = 1 / 128
"""At the ends of the range a step is one level. All numbers here are part of the format (docs/coding.md)."""
LIFT_UNIT = 0.5
"""Half a level."""
PIVOT = 128.0
"""Level that gains leave as it is, the middle of the range: so factor and lift are coded almost independently."""
MAX_GAIN = round(8 / GAIN_UNIT)
"""Three stops of exposure."""
MAX_LIFT = round(512 / LIFT_UNIT)
"""Twice the range of a channel."""
NEUTRAL = np.array([[round(1 / GAIN_UNIT), 0]] * 3, dtype=np.int64)
"""(3, 2): per channel the gain about middle gray in 1/128, and the lift in half levels."""
CHANGE_COUNTERS = 6
"""Sets of counters: of factor and lift, each of green, red and blue."""


def quantized_gain(gain: NDArray[np.float64], offset: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the nearest (3, 2) units of ``color * gain + offset``, each (3,)."""
    lift = offset + PIVOT * (gain - 1)
    units = np.stack([np.rint(gain / GAIN_UNIT), np.rint(lift / LIFT_UNIT)], axis=1).astype(np.int64)
    units[:, 0] = np.clip(units[:, 0], 1, MAX_GAIN)
    units[:, 1] = np.clip(units[:, 1], -MAX_LIFT, MAX_LIFT)
    return units


def apply_gain(units: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return gain and offset (3,) float32 of units (3, 2), to be used as ``color * gain + offset``."""
    gain = units[:, 0] * GAIN_UNIT
    return gain.astype(np.float32), (PIVOT * (1 - gain) + units[:, 1] * LIFT_UNIT).astype(np.float32)


class GainCoder:
    """Codes gains as changes from frame to frame; encoder and decoder hold one each, in the same state.

    Parameters
    ----------
    gray
        Whether the three channels are one.
    """

    def __init__(self, gray: bool) -> None:
        self._gray = gray
        self.last = NEUTRAL.copy()
        self._counters = [new_counters(NUMBER_COUNTERS) for _ in range(CHANGE_COUNTERS)]

    def encode(self, gains: NDArray[np.int64]) -> bytes:
        """Return the payload of the gains (k, 3, 2) of consecutive frames."""
        writer = RangeWriter()
        for units in gains:
            self._code(writer, units)
        return writer.finish()

    def decode(self, payload: bytes, count: int) -> NDArray[np.int64]:
        """Return the (count, 3, 2) gains of a payload.

        Raises
        ------
        CorruptStream
            If the payload does not hold so many, or impossible ones.
        """
        reader = RangeReader(payload)
        gains = np.empty((count, 3, 2), dtype=np.int64)
        for row in gains:
            row[:] = self._code(reader, NEUTRAL)
            reader.check()
            if row[:, 0].min() < 1 or row[:, 0].max() > MAX_GAIN or np.abs(row[:, 1]).max() > MAX_LIFT:
                raise CorruptStream(f"a gain of {row.tolist()} is out of range; the stream is damaged")
        reader.finish()
        return gains

    def _code(self, coder: RangeCoder, units: NDArray[np.int64]) -> NDArray[np.int64]:
        """Code the change of green, then how those of red and blue differ from it."""
        change = units - self.last
        decoded = np.empty_like(change)
        for kind in range(2):
            green = coder.signed(int(change[1, kind]), self._counters[kind])
            decoded[:, kind] = green
            if not self._gray:
                for channel in (0, 2):
                    counters = self._counters[2 + 2 * (channel // 2) + kind]
                    decoded[channel, kind] = green + coder.signed(int(change[channel, kind]) - green, counters)
        self.last = self.last + decoded
        return self.last
