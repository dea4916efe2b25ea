# SPDX-License-Identifier: MIT
"""Streams of this and all earlier versions decode to what they decoded to when they were written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import threedvc
from golden import make_golden
from threedvc.coding.video.av1 import can_decode_av1
from threedvc.coding.video.ffv1 import can_decode_ffv1
from threedvc.config import RenderConfig

READABLE = {"room_color_video": can_decode_av1(), "paper_lossless": can_decode_ffv1()}


@pytest.mark.parametrize("stream", make_golden.streams(), ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_stream_decodes_as_before(stream: Path) -> None:
    expected = json.loads(stream.with_suffix(".json").read_text(encoding="utf-8"))
    if not READABLE.get(stream.stem, True):
        pytest.skip("this build of PyAV cannot read its color video")
    assert expected["complete"]
    assert make_golden.expectation(stream) == expected


def test_this_version_has_golden_streams() -> None:
    assert {path.stem for path in make_golden.streams() if path.parent.name == threedvc.__version__} == set(
        make_golden.CASES
    )


def test_pictures_do_not_depend_on_threads() -> None:
    stream = make_golden.FOLDER / threedvc.__version__ / "objects.3dvc"
    one, many = (threedvc.decode(stream, render=RenderConfig(threads=threads)) for threads in (1, 3))
    for first, second in zip(one, many, strict=True):
        assert first.color.tobytes() == second.color.tobytes()
        assert first.depth.tobytes() == second.depth.tobytes()
        assert first.labels.tobytes() == second.labels.tobytes()
