# SPDX-License-Identifier: MIT
"""How well measured depth agrees with the models."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from threedvc.config import Sensor
from threedvc.encoder.fusion.noise_meter import NoiseMeter
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.registration.model_view import predicted_and_measured_depth
from threedvc.frames.sequence import FrameSequence, sampling_stride
from threedvc.metrics.depth_errors import geman_mcclure_error

__all__ = ["background_depth_error", "reclassify_sensors", "sampled_frames"]

SAMPLED_FRAMES = 60
"""At most, spread over the sequence, as each takes a cast of the model (decision 0027)."""


def sampled_frames(frames: FrameSequence) -> range:
    """Return the frames on which a depth error is measured."""
    return range(0, len(frames), sampling_stride(len(frames), SAMPLED_FRAMES, frames.info))


def background_depth_error(scene: Scene, frames: FrameSequence) -> float:
    """Return the `geman_mcclure_error` of the background's evidence at its poses."""
    return geman_mcclure_error((shown, measured) for _, shown, measured in _background_depths(scene, frames))


def reclassify_sensors(scene: Scene, frames: FrameSequence) -> list[Sensor] | None:
    """Tell what sensors the frames come from, as their noise about the model shows; None if that is as was thought."""
    asked = [scene.config.sensor_of(sensor) for sensor in range(len(scene.info.rigs))]
    if Sensor.AUTO not in asked:
        return None
    meters = [NoiseMeter() for _ in asked]
    for index, shown, measured in _background_depths(scene, frames):
        meters[scene.records[index].sensor].add(shown, measured, scene.objects[0].evidence.voxel_size_m)
    found = [
        sensor if sensor is not Sensor.AUTO else meter.likelier_sensor(scene.sensor_of(number)) or Sensor.AUTO
        for number, (sensor, meter) in enumerate(zip(asked, meters, strict=True))
    ]
    return found if found != asked else None


def _background_depths(
    scene: Scene, frames: FrameSequence
) -> Iterator[tuple[int, NDArray[np.float32], NDArray[np.float32]]]:
    """Yield, for frames spread over the sequence, their number, the depth of the background's evidence and theirs."""
    item = scene.objects[0]
    for index in sampled_frames(frames):
        at = item.found[index]
        if at is None or not at.usable:
            continue
        frame = scene.with_depth_limit(frames[index])
        mask = scene.labels(frame) == 0
        views = scene.views(frame)
        there = views.rig.at_sensor(at.T_camera_object)
        yield index, *predicted_and_measured_depth(item.evidence, views, mask, there, scene.config.threads, exact=True)
