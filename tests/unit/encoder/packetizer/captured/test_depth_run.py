# SPDX-License-Identifier: MIT
"""Runs of depth maps: what their values mean, and where they are shown."""

from __future__ import annotations

import numpy as np
import pytest

from threedvc.encoder.packetizer.captured.depth_run import is_everywhere
from threedvc.render.captured_depth import DepthLaw, depth_levels


def test_levels_rise_by_steps_of_their_inverse_root() -> None:
    levels = depth_levels(0.5, 1.0025, 10, DepthLaw.INVERSE_ROOT)
    np.testing.assert_allclose(levels[[0, -1]], depth_levels(0.5, 1.0025, 10)[[0, -1]], rtol=1e-12)
    np.testing.assert_allclose(np.diff(levels**-0.5), (levels[-1] ** -0.5 - levels[0] ** -0.5) / 1023, rtol=1e-9)


@pytest.mark.parametrize(("holes", "everywhere"), [(0.0, True), (0.2, True), (0.8, False)])
def test_a_run_is_shown_everywhere_where_models_miss_more_than_the_sensor(holes: float, everywhere: bool) -> None:
    measured = np.ones((10, 10), np.float32)
    drawn = measured.copy()
    drawn[:, :5] = 0
    measured[: int(10 * holes), :5] = 0
    assert is_everywhere([measured], [drawn]) == everywhere
