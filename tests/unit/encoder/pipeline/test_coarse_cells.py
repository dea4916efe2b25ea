# SPDX-License-Identifier: MIT
"""Cells that are widened beside videos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from threedvc.config import DepthErrorConfig, DepthErrorKind, DepthVideo, EncoderConfig
from threedvc.encoder.pipeline.cell_size_trials import may_be_coarse

CONFIG = EncoderConfig()


def state(config: EncoderConfig = CONFIG, numbers: Sequence[int] = (0,)) -> Any:
    return SimpleNamespace(config=config, scene=SimpleNamespace(objects=dict.fromkeys(numbers)))


def test_a_lone_background_may_have_coarse_cells() -> None:
    assert may_be_coarse(state())
    assert not may_be_coarse(state(numbers=(0, 1)))


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
