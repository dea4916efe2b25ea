# SPDX-License-Identifier: MIT
"""The picture that puts input and decoded frames side by side."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import montage


def write_sequence(folder: Path, frames: int, suffix: str) -> None:
    """Write a plain sequence whose color tells the frame and whose depth grows to the right, 1 to 2 m."""
    for kind in ("color", "depth"):
        (folder / kind).mkdir(parents=True)
    (folder / "intrinsics.json").write_text(json.dumps({"depth_scale": 1000.0}), encoding="utf-8")
    depth = np.linspace(1000, 2000, 40, dtype=np.uint16)[None].repeat(30, axis=0)
    depth[0] = 0
    for index in range(frames):
        color = np.full((30, 40, 3), 40 * index, dtype=np.uint8)
        assert cv2.imwrite(str(folder / "color" / f"{index:06}{suffix}"), color)
        assert cv2.imwrite(str(folder / "depth" / f"{index:06}.png"), depth)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    write_sequence(tmp_path / "input", 5, ".jpg")
    write_sequence(tmp_path / "decoded", 5, ".png")
    return tmp_path / "input", tmp_path / "decoded"


def test_one_row_of_four_pictures_for_each_frame(folders: tuple[Path, Path], tmp_path: Path) -> None:
    montage.main([*map(str, folders), str(tmp_path / "out.png"), "--frames", "1,4", "--height", "60"])
    picture = cv2.imread(str(tmp_path / "out.png"))
    assert picture is not None
    assert picture.shape == (2 * (60 + montage.LABEL_HEIGHT), 4 * 80, 3)
    second_row = picture[-30, 80:160]
    np.testing.assert_array_equal(second_row, np.full_like(second_row, 160))


def test_no_measurement_is_black_and_near_differs_from_far() -> None:
    colored = montage.colored_depth(np.array([[0.0, 1.0, 2.0]]), 1.0, 2.0)
    assert not colored[0, 0].any()
    assert np.abs(colored[0, 1].astype(int) - colored[0, 2]).max() > 60


def test_frames_are_spread_over_the_sequence() -> None:
    assert montage.chosen_frames(None, 100) == [0, 33, 66, 99]
    assert montage.chosen_frames(None, 2) == [0, 1]


def test_missing_frame_is_named(folders: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"frame 7 is not within 0\.\.4"):
        montage.main([*map(str, folders), str(tmp_path / "out.png"), "--frames", "7"])


def test_folder_without_pictures_is_named(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"color: no pictures"):
        montage.pictures(tmp_path, "color")
