# SPDX-License-Identifier: MIT
"""A sound recording in the plain layout that tests damage, and the one line that opening it then gives."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from helpers.recorded_room import SMALL, color_picture, depth_picture, poses, write_picture
from threedvc.errors import ConfigError, SequenceError
from threedvc.formats.sources import open_sequence

__all__ = ["FRAMES", "INTRINSICS", "POSE_LINES", "edit_intrinsics", "message", "write_sound_recording"]

FRAMES = 4
INTRINSICS = {"width": 64, "height": 48, "fx": 60.0, "fy": 61.0, "cx": 31.0, "cy": 24.5, "depth_scale": 1000, "fps": 30}
POSE_LINES = [f"{k} 0 0 0 0 0 0 1" for k in range(FRAMES)]


def write_sound_recording(folder: Path) -> Path:
    """Write a sound recording, for a test to damage, and return its folder."""
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(folder / "color" / f"{k:06d}.png", color_picture(SMALL, pose))
        write_picture(folder / "depth" / f"{k:06d}.png", depth_picture(SMALL, pose, 1000))
    (folder / "intrinsics.json").write_text(json.dumps(INTRINSICS))
    return folder


def edit_intrinsics(recording: Path, **changes: object) -> None:
    """Change entries of the recording's cameras; None removes one."""
    content = {key: value for key, value in {**INTRINSICS, **changes}.items() if value is not None}
    (recording / "intrinsics.json").write_text(json.dumps(content))


def message(recording: Path, **options: object) -> str:
    """Return the text of the error that opening raises; it must be one line."""
    with pytest.raises((SequenceError, ConfigError)) as caught:
        open_sequence(recording, **options)  # type: ignore[arg-type]
    text = str(caught.value)
    assert "\n" not in text
    return text
