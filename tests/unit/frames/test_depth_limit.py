# SPDX-License-Identifier: MIT
"""Which measurements of depth are used."""

from __future__ import annotations

import numpy as np

from threedvc.config import Sensor
from threedvc.frames.depth_limit import limited_depth
from threedvc.frames.sensor_model import SENSORS

DEPTH = np.array([[np.nan, -1.0, 0.0, 0.5], [2.0, 2.1, np.inf, -np.inf]], dtype=np.float32)


def test_depth_that_is_no_number_or_too_far_is_left_out() -> None:
    np.testing.assert_array_equal(limited_depth(DEPTH, 2.0), [[0, 0, 0, 0.5], [2.0, 0, 0, 0]])


def test_the_limit_asked_for_goes_before_that_of_the_sensor() -> None:
    sensor = SENSORS[Sensor.KINECT1]
    far = np.array([[sensor.reach_m - 0.1, sensor.reach_m + 0.1]], dtype=np.float32)
    np.testing.assert_array_equal(limited_depth(far, None, sensor), far * [1, 0])
    np.testing.assert_array_equal(limited_depth(far, 100.0, sensor), far)


def test_nothing_that_can_be_measured_is_too_far_for_an_unknown_sensor() -> None:
    np.testing.assert_array_equal(limited_depth(DEPTH, None), [[0, 0, 0, 0.5], [2.0, np.float32(2.1), 0, 0]])
