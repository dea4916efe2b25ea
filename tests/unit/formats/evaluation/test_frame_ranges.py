# SPDX-License-Identifier: MIT
"""Frames in a row."""

from __future__ import annotations

import pytest

from threedvc.formats.evaluation.frame_ranges import FrameSpan, ranges_of


@pytest.mark.parametrize(
    ("frames", "text"),
    [([], ""), ([7], "7"), ([0, 1, 2], "0-2"), ([100, 101, 102, 154], "100-102, 154"), ([1, 3, 5], "1, 3, 5")],
)
def test_text(frames: list[int], text: str) -> None:
    assert ", ".join(map(str, ranges_of(frames))) == text


def test_first_and_last() -> None:
    assert ranges_of(iter([4, 5, 9])) == (FrameSpan(4, 5), FrameSpan(9, 9))
