# SPDX-License-Identifier: MIT
"""The encoder's report: round trip, and payloads that lie."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.limits import MAX_COUNT
from threedvc.stream.notes.frame_report import STATUSES, FrameReport, report_packet, unpack_report
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.pose_status import PoseStatus
from threedvc.stream.wire import pack_signed_varint, pack_varint

MEGABYTE = 1 << 20


def frame(index: int, status: PoseStatus = PoseStatus.TRACKED, bits: float = 1000.0) -> FrameReport:
    return FrameReport(index=index, timestamp_ns=index, status=status, entropy_bits=bits)


def packet_of(content: bytes) -> Packet:
    return raw_packet(zstandard.ZstdCompressor().compress(content))


def raw_packet(payload: bytes) -> Packet:
    return Packet(type=PacketType.META, header={"k": "report"}, payload=payload, critical=False)


def varints(*values: int) -> bytes:
    return b"".join(map(pack_varint, values))


@contextmanager
def little_memory(megabytes: float) -> Iterator[None]:
    """Fail if Python allocates more than so much inside."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < megabytes * MEGABYTE


@given(st.lists(st.tuples(st.sampled_from(STATUSES), st.floats(0, 1e12)), max_size=50))
def test_round_trip_keeps_statuses_and_entropies_to_two_percent(told: list[tuple[str, float]]) -> None:
    packet = report_packet([frame(index, status, bits) for index, (status, bits) in enumerate(told)])
    assert (packet.type, packet.critical) == (PacketType.META, False)
    report = unpack_report(packet)
    assert report is not None
    assert report.status == tuple(status for status, _ in told)
    for read, (_, bits) in zip(report.entropy_bits, told, strict=True):
        assert read == pytest.approx(max(bits, 1.0), rel=0.02)


def test_a_quiet_sequence_costs_bytes_and_not_kilobytes() -> None:
    quiet = [frame(index, bits=1e6 / (1 + index)) for index in range(300)]
    assert len(report_packet(quiet).payload) < 300
    assert len(report_packet([frame(index) for index in range(100_000)]).payload) < 100


@pytest.mark.parametrize(
    "payload",
    [b"", b"not zstd", report_packet([frame(0)]).payload[:-1], report_packet([frame(0)]).payload + b"\0"],
    ids=["empty", "text", "cut", "longer"],
)
def test_damaged_compression(payload: bytes) -> None:
    with pytest.raises(CorruptStream, match="the encoder's report"):
        unpack_report(raw_packet(payload))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        varints(1),
        varints(2, 1, 1, 2) + pack_signed_varint(5),
        varints(1, 1, len(STATUSES), 1, 0),
        varints(3, 1, 1, 2, 0, 0),
        varints(1, 1, 1, 2, 0, 0),
        varints(1, 2, 1, 0, 1, 1, 0),
        varints(1, 1, 1, 1) + pack_signed_varint(-1),
        varints(1, 1, 1, 1) + pack_signed_varint(64 * 32),
        varints(1, 1, 1, 1, 0, 0),
        varints(0, 1),
    ],
    ids=["empty", "no runs", "levels missing", "unknown status", "runs too short", "runs too long", "empty run",
         "negative entropy", "absurd entropy", "bytes left", "runs without frames"],
)  # fmt: skip
def test_malformed_content(content: bytes) -> None:
    with pytest.raises(CorruptStream):
        unpack_report(packet_of(content))


def stating(size: int) -> bytes:
    """Return a Zstandard frame of no blocks that states a content size."""
    return b"\x28\xb5\x2f\xfd" + b"\xe0" + size.to_bytes(8, "little") + b"\x01\x00\x00"


@pytest.mark.parametrize("size", [1 << 25, 1 << 40, (1 << 64) - 3])
def test_a_huge_content_size_is_refused_before_memory_is_taken(size: int) -> None:
    assert zstandard.frame_content_size(stating(size)) == size
    with little_memory(1), pytest.raises(CorruptStream, match=f"states {size} bytes"):
        unpack_report(raw_packet(stating(size)))


def test_a_frame_must_state_its_content_size() -> None:
    silent = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(100))
    with pytest.raises(CorruptStream, match="does not state its size"):
        unpack_report(raw_packet(silent))


@pytest.mark.parametrize("count", [MAX_COUNT + 1, 1 << 40, (1 << 64) - 1])
def test_huge_counts_and_runs_are_refused_before_memory_is_taken(count: int) -> None:
    with little_memory(1), pytest.raises(CorruptStream, match=f"report of {count} frames"):
        unpack_report(packet_of(varints(count, 1, 1, count)))
    with little_memory(1), pytest.raises(CorruptStream, match=f"run of {count} frames"):
        unpack_report(packet_of(varints(10, 1, 1, count)))
    with little_memory(1), pytest.raises(CorruptStream, match=f"{count} runs"):
        unpack_report(packet_of(varints(10, count, 1, 1)))


def test_the_writer_keeps_to_the_limit() -> None:
    with pytest.raises(LimitExceeded, match=f"a report of {MAX_COUNT + 1} frames"):
        report_packet([frame(0)] * (MAX_COUNT + 1))
