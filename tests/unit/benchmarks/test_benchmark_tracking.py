# SPDX-License-Identifier: MIT
"""The table of tracking: what is disturbed, and what stands in its cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tracking
from helpers.streams import gradient_frame
from threedvc.cli.main import main as command
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import identity, make_pose
from threedvc.stream.pose_status import PoseStatus
from tracking import DISTURBANCES, StreamTimeline


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [gradient_frame(index) for index in range(140)]


def test_disturbances(frames: list[Frame]) -> None:
    black, covered = DISTURBANCES["black"](frames), DISTURBANCES["covered"](frames)
    dark = [frame.index for frame in black if not frame.depth.any()]
    assert dark == list(range(100, 111)) == [frame.index for frame in covered if not frame.color.any()]
    assert all(frame.color.any() for frame in black)
    left = DISTURBANCES["removed"](frames)
    assert [frame.index for frame in left] == list(range(110))
    assert left[100].timestamp_ns == frames[130].timestamp_ns
    assert DISTURBANCES[""](frames) == frames


def test_row() -> None:
    shifted = make_pose(np.eye(3), np.array([0.0, 0.0, 1.0]))
    timeline = StreamTimeline(
        status=[PoseStatus.TRACKED, PoseStatus.WEAK, PoseStatus.LOST],
        camera=[(identity(), shifted), (shifted, shifted @ shifted)],
        numbers=[0, 1],
        objects={1: [(identity(), shifted)] * 2},
        tracking_s=0.5,
        seconds=1.5,
    )
    assert timeline.row("desk", "black") == [
        "desk", "black", "3", "1", "1", "0", "1", "0.0", "0.0", "0.000", "0.00", "0.00", "6.0", "2.0"
    ]  # fmt: skip
    assert StreamTimeline(status=[PoseStatus.TRACKED], tracking_s=1, seconds=1).row("a", "")[7:12] == ["-"] * 5


def test_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, table = tmp_path / "toy", tmp_path / "table.md"
    command(["synth", str(folder), "--scene", "objects", "--frames", "4", "--size", "64x48"], standalone_mode=False)
    tracking.main([str(folder), "--out", str(table)])
    assert "# Tracking" in table.read_text(encoding="utf-8")
    assert capsys.readouterr().out.splitlines()[-1].split("\t")[:3] == ["toy", "", "4"]
