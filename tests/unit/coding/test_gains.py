# SPDX-License-Identifier: MIT
"""Gains of the color camera and the light on objects: units and payloads."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.coding.gains import NEUTRAL, GainCoder, apply_gain, quantized_gain
from threedvc.coding.light import pack_light, unpack_light
from threedvc.errors import CorruptStream

Gains = NDArray[np.int64]


def wandering(count: int, *, gray: bool = False) -> Gains:
    rng = np.random.default_rng(3)
    gains = NEUTRAL + np.cumsum(rng.integers(-2, 3, (count, 3, 2)), axis=0)
    return np.repeat(gains[:, :1], 3, axis=1) if gray else gains


@pytest.mark.parametrize("gray", [False, True])
def test_round_trip_over_several_payloads(gray: bool) -> None:
    gains = wandering(50, gray=gray)
    writer, reader = GainCoder(gray), GainCoder(gray)
    for part in (gains[:1], gains[1:30], gains[30:]):
        np.testing.assert_array_equal(reader.decode(writer.encode(part), len(part)), part)


def test_steady_gains_cost_next_to_nothing() -> None:
    still = np.repeat(NEUTRAL[None], 300, axis=0)
    assert len(GainCoder(False).encode(still)) < 30


def test_what_cannot_be_a_gain_is_refused() -> None:
    dark = NEUTRAL.copy()[None]
    dark[0, :, 0] = 0
    payload = GainCoder(False).encode(dark)
    with pytest.raises(CorruptStream, match="out of range"):
        GainCoder(False).decode(payload, 1)
    with pytest.raises(CorruptStream, match="ends too early"):
        GainCoder(False).decode(GainCoder(False).encode(wandering(2)), 30)


def test_units_are_what_they_say() -> None:
    gain, offset = np.array([0.8, 1.0, 1.3]), np.array([20.0, 0.0, -40.0])
    units = quantized_gain(gain, offset)
    got_gain, got_offset = apply_gain(units)
    levels = np.arange(256.0)[:, None]
    assert np.abs((levels * got_gain + got_offset) - (levels * gain + offset)).max() < 1.0
    one, zero = apply_gain(NEUTRAL)
    assert (one.tolist(), zero.tolist()) == ([1, 1, 1], [0, 0, 0])
    wild = quantized_gain(np.array([1e6, -3.0, 1.0]), np.array([0.0, 1e9, -1e9]))
    GainCoder(False).decode(GainCoder(False).encode(wild[None]), 1)


def test_light_has_eight_bytes() -> None:
    factors = np.array([0.5, -0.25, 0.0, 1.0, -1.5, 0.125, 9.0, -9.0])
    payload = pack_light(factors)
    assert len(payload) == 8
    np.testing.assert_allclose(unpack_light(payload), np.clip(factors, -127 / 64, 127 / 64))
    with pytest.raises(CorruptStream, match="7 bytes instead of 8"):
        unpack_light(payload[:-1])
