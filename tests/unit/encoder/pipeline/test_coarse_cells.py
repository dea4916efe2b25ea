# SPDX-License-Identifier: MIT
"""Cells that are widened beside videos."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from threedvc.config import DepthErrorConfig, DepthErrorKind, DepthVideo, EncoderConfig
from threedvc.encoder.pipeline.cell_size_trials import may_be_coarse

CONFIG = EncoderConfig()


def state(config: EncoderConfig = CONFIG, **at_rest: bool) -> Any:
    objects = {int(name[1:]): SimpleNamespace(at_rest=rests) for name, rests in (at_rest or {"o0": False}).items()}
    return SimpleNamespace(config=config, scene=SimpleNamespace(objects=objects))


def test_a_lone_moving_background_may_have_coarse_cells() -> None:
    assert may_be_coarse(state())
    assert not may_be_coarse(state(o0=True))
    assert not may_be_coarse(state(o0=False, o1=False))


@pytest.mark.parametrize(
    "choices",
    [
        {"voxel_size_m": 0.01},
        {"refine": False},
        {"depth_video": DepthVideo.OFF},
        {"depth_error": DepthErrorConfig(kind=DepthErrorKind.LOSSLESS)},
    ],
)
def test_choices_of_cells_and_depth_stand(choices: dict[str, Any]) -> None:
    assert not may_be_coarse(state(replace(CONFIG, **choices)))
