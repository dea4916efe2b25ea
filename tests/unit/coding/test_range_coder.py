# SPDX-License-Identifier: MIT
"""The range coder against exact arithmetic, and its behavior at the end of the data."""

from __future__ import annotations

import numpy as np
import pytest

from reference.coding import ExactCoder, ExactCounter, write_number
from threedvc.coding.entropy.range_coder import RangeReader, RangeWriter, new_counters
from threedvc.errors import CorruptStream
from threedvc.kernels.coding.mixing import INPUT_LIMIT, SQUASH_TABLE, STRETCH_TABLE
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS, adapt_counter, code_bit, counter_probability


@pytest.mark.parametrize("skew", [0.5, 0.02, 0.999])
def test_bits_match_exact_arithmetic(rng: np.random.Generator, skew: float) -> None:
    bits = (rng.random(3000) < skew).astype(int).tolist()
    probabilities = rng.integers(32, 65504, len(bits)).tolist()
    exact, writer = ExactCoder(), RangeWriter()
    writer.reserve(2 * len(bits))
    for bit, probability in zip(bits, probabilities, strict=True):
        exact.write(bit, probability)
        code_bit(writer.coder, bit, probability)
    payload = writer.finish()
    assert payload == exact.finish()
    reader = RangeReader(payload)
    assert [code_bit(reader.coder, 0, probability) for probability in probabilities] == bits
    reader.finish()


def test_carries_run_through_many_bytes() -> None:
    writer, exact = RangeWriter(), ExactCoder()
    for bit, probability in [(0, 1), *[(1, 65504)] * 5, *[(0, 32)] * 40, (0, 65504)]:
        writer.reserve(8)
        code_bit(writer.coder, bit, probability)
        exact.write(bit, probability)
    assert writer.finish() == exact.finish()


def test_counter_matches_exact_counter(rng: np.random.Generator) -> None:
    counters, exact = new_counters(1), ExactCounter()
    for bit in (rng.random(2000) < 0.9).astype(int).tolist():
        assert exact.probability == min(max(counter_probability(int(counters[0])), 32), 65504)
        adapt_counter(counters, 0, bit, 255)
        exact.adapt(bit, 255)


def test_numbers_match_exact_arithmetic() -> None:
    values = [0, 1, 2, 3, 7, 8, 100, 65535, 2**31 - 2, 5, 5, 5]
    writer, exact = RangeWriter(), ExactCoder()
    counters, exact_counters = new_counters(NUMBER_COUNTERS), dict[int, ExactCounter]()
    for value in values:
        assert writer.number(value, counters) == value
        write_number(exact, exact_counters, value, 255)
    payload = writer.finish()
    assert payload == exact.finish()
    reader, counters = RangeReader(payload), new_counters(NUMBER_COUNTERS)
    assert [reader.number(0, counters) for _ in values] == values


def test_signed_numbers_come_back() -> None:
    values = [0, -1, 1, -(2**31 - 2), 2**31 - 2, 17, -17]
    writer, counters = RangeWriter(), new_counters(NUMBER_COUNTERS)
    for value in values:
        writer.signed(value, counters)
    reader, counters = RangeReader(writer.finish()), new_counters(NUMBER_COUNTERS)
    assert [reader.signed(0, counters) for _ in values] == values


def test_nothing_costs_nothing() -> None:
    payload = RangeWriter().finish()
    assert payload == b""
    RangeReader(payload).finish()


def test_even_bits_cost_one_bit_each(rng: np.random.Generator) -> None:
    writer = RangeWriter()
    for bit in rng.integers(2, size=800).tolist():
        writer.bit(bool(bit))
    assert len(writer.finish()) in (100, 101)


def test_missing_and_spare_bytes_are_noticed(rng: np.random.Generator) -> None:
    writer, counters = RangeWriter(), new_counters(NUMBER_COUNTERS)
    for value in rng.integers(1 << 20, size=50).tolist():
        writer.number(value, counters)
    payload = writer.finish()
    short = RangeReader(payload[:-20])
    counters = new_counters(NUMBER_COUNTERS)
    for _ in range(50):
        short.number(0, counters)
    with pytest.raises(CorruptStream, match=f"payload of {len(payload) - 20} bytes ends too early"):
        short.finish()
    with pytest.raises(CorruptStream, match="goes on after its end"):
        RangeReader(payload + b"\1").finish()


def test_tables_do_not_depend_on_the_mathematics_library() -> None:
    """No table entry comes so near to a rounding boundary that another library could round it otherwise."""
    p = (np.arange(4096) + 0.5) / 4096
    x = np.arange(-INPUT_LIMIT, INPUT_LIMIT + 1)
    for exact, table in (
        (256 * np.log(p / (1 - p)), STRETCH_TABLE),
        (65536 / (1 + np.exp(-x / 256)), SQUASH_TABLE),
    ):
        inside = np.abs(table) < INPUT_LIMIT if table is STRETCH_TABLE else np.ones(len(table), dtype=bool)
        assert np.abs(np.abs(exact - np.floor(exact)) - 0.5)[inside].min() > 1e-6
        assert np.all(np.abs(exact - table)[inside] <= 0.5)
