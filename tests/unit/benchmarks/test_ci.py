# SPDX-License-Identifier: MIT
"""The guard of speed and size: what counts as worse, and what its table says."""

from __future__ import annotations

import json

import pytest

from ci import BASELINE, Measurement, compare, speeds


@pytest.mark.parametrize(
    ("unit", "value", "baseline", "worse"),
    [
        ("yardsticks", 12.4, 10.0, False),
        ("yardsticks", 12.6, 10.0, True),
        ("yardsticks", 2.0, 10.0, False),
        ("bytes", 1019, 1000, False),
        ("bytes", 1021, 1000, True),
        ("dB", 29.95, 30.0, False),
        ("dB", 29.85, 30.0, True),
        ("share", 0.9, 0.901, False),
        ("share", 0.9, 0.903, True),
    ],
)
def test_what_is_worse(unit: str, value: float, baseline: float, worse: bool) -> None:
    measurement = Measurement("stage", value, unit)
    assert measurement.is_worse(baseline) is worse
    table, named = compare([measurement], {"stage": baseline})
    assert named == (["stage"] if worse else [])
    assert f"{value / baseline:.3f}" in table


def test_what_the_baseline_lacks_is_shown_and_no_worse() -> None:
    table, worse = compare([Measurement("new", 5.0, "bytes")], {})
    assert "new" in table
    assert worse == []


def test_speed_is_counted_in_yardsticks() -> None:
    def busy(rounds: int) -> int:
        return sum(k * k for k in range(rounds))

    (measured,) = speeds({"busy": lambda: busy(400_000)}, lambda: busy(100_000))
    assert measured.unit == "yardsticks"
    assert 2 < measured.value < 8


def test_the_committed_baseline_has_every_unit() -> None:
    measures = json.loads(BASELINE.read_text(encoding="utf-8"))["measures"]
    assert {"fusion", "tracking view", "drawing", "entropy coding", "live encode", "decode", "live stream"} <= set(
        measures
    )
    assert all(value > 0 for value in measures.values())
