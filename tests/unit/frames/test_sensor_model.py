# SPDX-License-Identifier: MIT
"""Sensor models: deviations, presets, and telling a clean depth map from a noisy one."""

from __future__ import annotations

import numpy as np
import pytest

from threedvc.config import Sensor
from threedvc.errors import ConfigError
from threedvc.frames.sensor_model import SENSORS, SensorModel, chosen_sensor, guess_sensor
from threedvc.kernels.encoder.fusion import sensor_sigma
from threedvc.synthesis import SyntheticSequence, make_scene


def test_deviation_by_hand() -> None:
    model = SensorModel(s0_m=0.001, s1=0.002, s2_per_m=0.003, quantum_per_m=0.004)
    expected = np.sqrt((0.001 + 0.002 * 2 + 0.003 * 4) ** 2 + (0.004 * 4) ** 2 / 12)
    assert model.sigma_m(2.0) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("sensor", SENSORS)
def test_kernels_use_the_same_deviation(sensor: Sensor) -> None:
    model, depths = SENSORS[sensor], np.linspace(0.2, 8, 20)
    np.testing.assert_allclose([sensor_sigma(z, model.parameters()) for z in depths], model.sigma_m(depths), rtol=1e-12)


def test_every_sensor_but_auto_has_a_model() -> None:
    assert set(SENSORS) == set(Sensor) - {Sensor.AUTO}


def test_presets_say_what_is_known_of_the_sensors() -> None:
    z = np.linspace(0.5, 5, 30)
    for sensor in (Sensor.KINECT1, Sensor.REALSENSE, Sensor.LIDAR):
        assert np.all(SENSORS[sensor].sigma_m(z) > SENSORS[Sensor.IDEAL].sigma_m(z))
    assert SENSORS[Sensor.IDEAL].sigma_m(3.0) < 0.001
    assert SENSORS[Sensor.KINECT1].sigma_m(1.0) == pytest.approx(np.hypot(0.0012, 0.0029 / np.sqrt(12)))
    # The error of a disparity sensor grows with the square of the distance, that of a LiDAR hardly.
    assert SENSORS[Sensor.KINECT1].sigma_m(4.0) == pytest.approx(16 * SENSORS[Sensor.KINECT1].sigma_m(1.0))
    assert SENSORS[Sensor.LIDAR].sigma_m(8.0) < 0.5 * SENSORS[Sensor.KINECT1].sigma_m(8.0)


@pytest.mark.parametrize(
    "changes",
    [{"s0_m": -1e-6}, {"s1": -1.0}, {"s2_per_m": -1.0}, {"quantum_per_m": -1.0}, {"outlier": 0.0}, {"outlier": 1.0}],
)
def test_impossible_models(changes: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=r"sensor model .* must have non-negative deviations and an outlier weight"):
        SensorModel(**changes)


@pytest.mark.parametrize("size", [(80, 60), (160, 120)])
@pytest.mark.parametrize("scene", ["room", "paper", "objects"])
def test_guesses_the_sensor_from_one_frame(scene: str, size: tuple[int, int]) -> None:
    still = make_scene(scene, frames=1, size=size)
    assert guess_sensor(SyntheticSequence(still)[0].depth) is Sensor.IDEAL
    assert guess_sensor(SyntheticSequence(still, "kinect", seed=3)[0].depth) is Sensor.KINECT1


@pytest.mark.parametrize("shape", [(4, 4), (1, 1), (3, 2), (200, 200)])
def test_without_enough_depth_it_assumes_noise(shape: tuple[int, int]) -> None:
    assert guess_sensor(np.zeros(shape, dtype=np.float32)) is Sensor.KINECT1


def test_one_hole_does_not_make_a_depth_map_noisy() -> None:
    depth = np.tile(np.linspace(1, 2, 60, dtype=np.float32), (40, 1))
    depth[10:20, 10:30] = 0
    depth[:, 40:] += 1
    assert guess_sensor(depth) is Sensor.IDEAL


def test_a_sensor_reaches_as_far_as_it_is_good_to_a_tenth_of_a_meter() -> None:
    kinect = SENSORS[Sensor.KINECT1]
    reach = kinect.reach_m
    assert 8 < reach < 9
    assert kinect.sigma_m(np.array(reach)) <= 0.1 < kinect.sigma_m(np.array(reach + 0.2))


def test_the_sensor_asked_for_is_taken_and_else_the_one_it_looks_like() -> None:
    rough = np.random.default_rng(0).uniform(1.0, 1.04, (40, 40)).astype(np.float32)
    assert chosen_sensor(Sensor.LIDAR, rough) is SENSORS[Sensor.LIDAR]
    assert chosen_sensor(Sensor.AUTO, rough) is SENSORS[guess_sensor(rough)]
