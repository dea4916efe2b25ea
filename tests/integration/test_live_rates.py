# SPDX-License-Identifier: MIT
"""Live streams of recorded rooms at a rate: never beyond it, and as whole as they can be."""

from __future__ import annotations

import io
from collections.abc import Callable
from itertools import combinations, islice
from pathlib import Path

import pytest

from threedvc.config import EncoderConfig, Motion
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.formats.container import StreamWriter
from threedvc.formats.sources import open_sequence
from threedvc.stream.packets import PacketType

FRAMES = 70


@pytest.mark.parametrize(("name", "rate"), [("two_toys", 16e3), ("fr1_rpy", 32e3)])
def test_no_span_of_time_takes_more_than_its_rate_and_a_second(
    sequence_dir: Callable[[str], Path], name: str, rate: float
) -> None:
    sequence = open_sequence(sequence_dir(name))
    encoder = Encoder(sequence.info, EncoderConfig(causal=True, motion=Motion.KNOWN, bitrate_bps=rate, threads=2))
    writer, written = StreamWriter(io.BytesIO()), [(0.0, 0)]
    for packet in encoder.packets(islice(sequence, FRAMES)):
        writer.write(packet)
        if packet.type == PacketType.BATCH:
            # A batch goes out when its last frame is over.
            written.append(((packet.header["f"] + packet.header["n"]) / sequence.info.fps, writer.offset))
    writer.close()
    written.append((written[-1][0], writer.offset))
    assert len(written) > FRAMES / sequence.info.fps
    for (start, before), (stop, after) in combinations(written, 2):
        assert after - before <= rate / 8 * (stop - start + 1), f"{start} s to {stop} s"
