# SPDX-License-Identifier: MIT
"""What batches of a live stream may take."""

from __future__ import annotations

import pytest

from threedvc.config import EncoderConfig
from threedvc.encoder.packetizer.batch_budget import BatchBudget
from threedvc.stream.headers import BatchHeader
from threedvc.stream.packets import Packet

FPS = 30


def batch_of(size: int) -> Packet:
    return BatchHeader(frame=0, count=FPS).packet(bytes(size))


@pytest.mark.parametrize("rate", [24e3, 48e3])
def test_long_streams_have_as_much_for_each_batch_as_short_ones(rate: float) -> None:
    budget = BatchBudget(EncoderConfig(causal=True, bitrate_bps=rate), FPS, ())
    offered = []
    for _ in range(3000):
        offered.append(budget.open_batch(FPS, (), last=False))
        budget.close_batch(batch_of(int(offered[-1])))
    assert min(offered[1:]) > 0.9 * rate / 8
    assert sum(offered) < rate / 8 * (len(offered) + 1)


def test_files_have_no_budget() -> None:
    budget = BatchBudget(EncoderConfig(bitrate_bps=24e3), FPS, ())
    assert budget.open_batch(FPS, (), last=True) == float("inf")
