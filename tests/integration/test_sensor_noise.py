# SPDX-License-Identifier: MIT
"""Telling a sensor by what its frames measure of the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.nonrigid_scene import nonrigid_sequence
from helpers.streams import ListSequence
from threedvc.config import ColorVideo, EncoderConfig, Motion, Sensor
from threedvc.encoder.fusion.noise_meter import MIN_METERED_FRAMES, NoiseMeter
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.reconstruction.frame_intake import METERED_FRAMES
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sensor_model import SENSORS
from threedvc.synthesis import SyntheticSequence, make_scene

FRAMES = METERED_FRAMES + 3
FAST = EncoderConfig(color_video=ColorVideo.OFF, motion=Motion.KNOWN, refine=False, threads=1)
pytestmark = pytest.mark.usefixtures("quick_av1")


def metered(depth_m: float, sigma_m: float, rng: np.random.Generator, voxel_size_m: float = 0.001) -> NoiseMeter:
    meter = NoiseMeter()
    shown = np.full((60, 80), depth_m, dtype=np.float32)
    for _ in range(MIN_METERED_FRAMES):
        measured = (shown + rng.normal(scale=sigma_m, size=shown.shape)).astype(np.float32)
        measured[::7] = 0
        meter.add(shown, measured, voxel_size_m)
    return meter


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("depth_m", [0.3, 1.0, 3.0])
def test_noise_as_expected_speaks_for_no_other_sensor(sensor: Sensor, depth_m: float, rng: np.random.Generator) -> None:
    model = SENSORS[sensor]
    assert metered(depth_m, float(model.sigma_m(np.array(depth_m))), rng).likelier_sensor(model) is None


def test_much_more_noise_than_expected_speaks_for_another(rng: np.random.Generator) -> None:
    meter = metered(0.3, 0.0045, rng)
    assert meter.likelier_sensor(SENSORS[Sensor.KINECT1]) is Sensor.LIDAR
    assert meter.likelier_sensor(SENSORS[Sensor.IDEAL]) is Sensor.LIDAR
    assert meter.likelier_sensor(SENSORS[Sensor.LIDAR]) is None


def test_wide_cells_explain_noise(rng: np.random.Generator) -> None:
    assert metered(0.3, 0.0045, rng, voxel_size_m=0.02).likelier_sensor(SENSORS[Sensor.KINECT1]) is None


def test_less_noise_than_expected_speaks_for_none(rng: np.random.Generator) -> None:
    assert metered(1.0, 0.0003, rng).likelier_sensor(SENSORS[Sensor.LIDAR]) is None


@pytest.mark.parametrize(("side", "frames"), [(16, 50), (60, MIN_METERED_FRAMES - 1)])
def test_a_few_pixels_or_frames_tell_nothing(side: int, frames: int) -> None:
    meter = NoiseMeter()
    for _ in range(frames):
        meter.add(np.full((side, side), 1.0, dtype=np.float32), np.full((side, side), 1.05, dtype=np.float32), 0.001)
    assert meter.likelier_sensor(SENSORS[Sensor.IDEAL]) is None
    assert meter.frames == (frames if side == 60 else 0)


def test_frames_that_tell_nothing_do_not_count(rng: np.random.Generator) -> None:
    meter = metered(0.3, 0.0045, rng)
    for _ in range(20):
        meter.add(np.zeros((60, 80), dtype=np.float32), np.ones((60, 80), dtype=np.float32), 0.001)
    assert meter.frames == MIN_METERED_FRAMES
    assert meter.likelier_sensor(SENSORS[Sensor.KINECT1]) is Sensor.LIDAR


@pytest.mark.long
@pytest.mark.parametrize("refine", [False, True])
def test_a_file_is_begun_anew_with_the_sensor_that_it_shows(refine: bool) -> None:
    sequence = nonrigid_sequence(FRAMES)
    encoder = Encoder(sequence.info, replace(FAST, refine=refine))
    assert encoder.scene.sensor_of(0) is not SENSORS[Sensor.LIDAR]
    list(encoder.packets(sequence))
    assert encoder.scene.sensor_of(0) is SENSORS[Sensor.LIDAR]
    assert len(encoder.reports) == FRAMES


def test_a_live_encoder_learns_the_sensor_from_its_first_frames() -> None:
    sequence = nonrigid_sequence(FRAMES)
    scene = Scene(sequence.info, replace(FAST, causal=True))
    known = []
    for frame in sequence:
        scene.add(frame)
        known.append(scene.sensor_of(0))
    assert known[METERED_FRAMES - 1] is known[0] is not SENSORS[Sensor.LIDAR]  # the first frame meets no model
    assert known[METERED_FRAMES + 1 :] == [SENSORS[Sensor.LIDAR]] * (FRAMES - METERED_FRAMES - 1)


@pytest.mark.parametrize("causal", [False, True])
def test_a_sensor_that_was_named_is_believed(causal: bool) -> None:
    sequence = nonrigid_sequence(FRAMES, (64, 48))
    encoder = Encoder(sequence.info, replace(FAST, sensor=Sensor.KINECT1, causal=causal))
    list(encoder.packets(sequence))
    assert encoder.scene.sensor_of(0) is SENSORS[Sensor.KINECT1]


@pytest.mark.parametrize("noise", ["ideal", "kinect"])
def test_depth_as_guessed_stays_so(noise: str) -> None:
    source = SyntheticSequence(make_scene("room", frames=8, size=(80, 60)), noise, seed=3, threads=1)
    sequence = ListSequence(list(source), source.info)
    encoder = Encoder(sequence.info, FAST)
    list(encoder.packets(sequence))
    assert encoder.config.sensor is Sensor.AUTO


@pytest.mark.long
@pytest.mark.parametrize("voxel_size_m", [0.006])
def test_one_frame_speaks_for_no_other_sensor(voxel_size_m: float) -> None:
    source = SyntheticSequence(make_scene("room", frames=1, size=(96, 72)), "kinect", seed=3)
    encoder = Encoder(source.info, replace(FAST, voxel_size_m=voxel_size_m))
    list(encoder.packets(ListSequence(list(source), source.info)))
    assert encoder.config.sensor is Sensor.AUTO
