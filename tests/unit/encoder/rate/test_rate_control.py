# SPDX-License-Identifier: MIT
"""Meeting a rate: bisection, cells, the leaky bucket, and what configurations allow."""

from __future__ import annotations

import io
from math import inf

import numpy as np
import pytest

from helpers.container_streams import end, stream_header
from threedvc.config import (
    ColorConfig,
    EncoderConfig,
    Preset,
    with_preset,
    with_quality,
    with_step,
)
from threedvc.encoder.rate.rate_control import (
    MAX_STEP,
    MIN_STEP,
    LeakyBucket,
    best_cells,
    bisect_step,
    cell_factor,
    error_at,
    live_cell_factor,
    stream_bytes,
    surface_budget,
)
from threedvc.errors import ConfigError
from threedvc.formats.container import StreamWriter, layout
from threedvc.stream.batch import pack_batch
from threedvc.stream.framing_sizes import (
    FILE_HEAD_BYTES,
    MAX_BATCH_FRAMING_BYTES,
    MAX_END_BYTES,
    MAX_INDEX_ENTRY_BYTES,
    MAX_MEMBER_FRAMING_BYTES,
    PACKET_FRAMING_BYTES,
)
from threedvc.stream.headers import BatchHeader, ModelHeader
from threedvc.stream.packets import Packet, PacketType


def made(step: float) -> int:
    """Return the size of a stream, which falls with the step."""
    return int(1000 + 90_000 / step)


@pytest.mark.parametrize("target", [1800, 5000, 20_000, 100_000])
def test_bisection_comes_close_from_below(target: int) -> None:
    step, size = bisect_step(made, target)
    assert 0.95 * target < size <= target
    assert made(step) == size


def test_bounds_of_the_step_are_kept() -> None:
    assert bisect_step(made, 10)[0] == pytest.approx(MAX_STEP, rel=0.05)
    assert bisect_step(made, 10**9)[0] == pytest.approx(MIN_STEP, rel=0.05)


def test_cells_follow_the_rate() -> None:
    assert cell_factor(20_000, 20_000) == 1.0
    assert cell_factor(80_000, 20_000) == pytest.approx(2.0, rel=0.01)
    assert cell_factor(5_000, 20_000) == pytest.approx(0.5, rel=0.01)
    assert cell_factor(10**9, surface_budget(300, 3_000)) == 4.0
    assert cell_factor(100, surface_budget(0, 10**9)) == 0.25


def test_live_cells_follow_the_rate() -> None:
    assert live_cell_factor(4000, 3000.0) == pytest.approx(1.0)
    assert live_cell_factor(16_000, 3000.0) == pytest.approx(2.0)
    assert live_cell_factor(1e9, 1000.0) == 4.0
    assert live_cell_factor(0, 1000.0) == 0.8


@pytest.mark.parametrize(
    ("best", "edge"),
    [(1.0, 1.0), (1.02, 1.0), (0.72, 0.72), (0.64, 0.64), (0.1, 0.512), (1.1, 1.1), (1.6, 1.25)],
    ids=["as is", "nearly", "between", "narrow", "least", "wider", "widest"],
)
def test_cells_of_the_least_error_are_found(best: float, edge: float) -> None:
    assert best_cells(lambda factor: 0.1 * np.log(factor / best) ** 2) == pytest.approx(edge)


def test_cells_that_may_not_be_are_not_taken() -> None:
    assert best_cells(lambda factor: inf if factor < 0.7 else factor) == pytest.approx(0.8)
    assert best_cells(lambda factor: inf if factor < 1 else 1.0) == 1


def test_errors_between_and_below_sizes() -> None:
    sizes, errors = [1000, 2000, 4000], [3.0, 2.5, 2.25]
    assert error_at(2000, sizes, errors) == pytest.approx(2.5)
    assert error_at(2000 * 2**0.5, sizes, errors) == pytest.approx(2.375)
    assert error_at(500, sizes, errors) == pytest.approx(3.5)
    assert error_at(10**6, sizes, errors) == pytest.approx(2.25)


def test_errors_below_sizes_that_say_little() -> None:
    for sizes in ([18, 18, 18, 18], [95, 96, 97, 98]):
        for errors in ([3.0, 3.0, 3.0, 3.0], [3.0, 2.95, 2.9, 2.9], [3.0, 3.01, 3.0, 3.0]):
            assert 3.0 + 0.39 < error_at(sizes[0] / np.e, sizes, errors) < 3.0 + 1.01
            assert error_at(sizes[-1] + 1, sizes, errors) == pytest.approx(errors[-1])


def test_a_bucket_never_gives_more_than_its_rate_and_buffer() -> None:
    bucket, sent, rng = LeakyBucket(1000.0, 2.0), 0, np.random.default_rng(5)
    for second in range(1, 200):
        bucket.wait(1.0)
        take = int(min(bucket.available, rng.integers(0, 4000)))
        bucket.take(take)
        sent += take
        assert sent <= 1000 * second + 2000
    assert sent > 0.9 * 1000 * 200
    bucket.wait(1e9)
    assert bucket.available == 2000


def test_stream_bytes_counts_headers() -> None:
    packet = Packet(type=PacketType.BATCH, header={"f": 0, "n": 3}, payload=bytes(100))
    assert 130 < stream_bytes([packet]) < 200
    assert stream_bytes([packet, packet]) > 2 * 128


def test_framing_takes_what_is_counted() -> None:
    assert layout.PACKET_HEAD.size + layout.CRC.size == PACKET_FRAMING_BYTES
    sink = io.BytesIO()
    writer = StreamWriter(sink)
    assert len(sink.getvalue()) == FILE_HEAD_BYTES == layout.FILE_HEAD_BYTES
    writer.write(stream_header().packet())
    for number in range(100):
        before, member = writer.offset, ModelHeader(object_id=255, frame=100_000 * number).packet(bytes(1000))
        packet = pack_batch(BatchHeader(frame=100_000 * number, count=100), [member])
        assert len(packet.payload) - 1000 <= MAX_MEMBER_FRAMING_BYTES
        writer.write(packet)
        assert writer.offset - before - len(packet.payload) <= MAX_BATCH_FRAMING_BYTES
    before = writer.offset
    writer.write(end(10_000_000))
    writer.close()
    assert len(sink.getvalue()) - before <= MAX_END_BYTES + 100 * MAX_INDEX_ENTRY_BYTES


def test_quality_is_monotone_and_fifty_is_the_default() -> None:
    plain = EncoderConfig()
    assert with_quality(plain, 50) == plain
    configs = [with_quality(plain, quality) for quality in range(1, 101)]
    steps, cells = [c.color.luma_step for c in configs], [c.cell_factor for c in configs]
    assert steps == sorted(steps, reverse=True)
    assert cells == sorted(cells, reverse=True)
    assert steps[0] > 8 * steps[-1]
    for quality in (0, 101, -3):
        with pytest.raises(ConfigError, match=r"within 1\.\.100"):
            with_quality(plain, quality)


def test_presets() -> None:
    plain = EncoderConfig()
    assert with_preset(plain, Preset.LIVE).causal
    assert with_preset(plain, Preset.MEDIUM) == plain
    fast, slow = with_preset(plain, Preset.FAST), with_preset(plain, Preset.SLOW)
    assert (fast.refine, fast.appearance.rounds, fast.causal) == (False, 0, False)
    assert slow.appearance.rounds > plain.appearance.rounds


def test_steps_stay_in_range() -> None:
    assert with_step(1e9).luma_step == with_step(1e9).chroma_step == 255
    assert with_step(ColorConfig().luma_step) == ColorConfig()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"bitrate_bps": 100.0}, "at least 0.5k"),
        ({"bitrate_bps": 4000.0, "causal": True}, "at least 8k"),
        ({"bitrate_bps": float("nan")}, "too low"),
        ({"cell_factor": 100.0}, "cell factor"),
        ({"live_buffer_s": 0.0}, "buffer"),
    ],
)
def test_impossible_rates_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        EncoderConfig(**changes)  # type: ignore[arg-type]
