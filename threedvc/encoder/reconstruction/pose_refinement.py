# SPDX-License-Identifier: MIT
"""What an encoder that can read the frames again does after the first pass.

The finished model knows more than the model so far did when each frame was fused: the colour camera is
calibrated against it, every frame's poses are registered with it once more, and all frames are fused anew.
What the decoder will draw is fitted to the pictures afterwards (`threedvc.encoder.appearance.appearance_fit`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from threedvc.config import Sensor
from threedvc.encoder.fusion.surface_extraction import read_surface
from threedvc.encoder.reconstruction.color_calibration import calibrate, sighting
from threedvc.encoder.reconstruction.scene import Scene, SceneObject
from threedvc.encoder.tracking.model_view import shown_and_measured
from threedvc.encoder.tracking.registration import RegistrationConfig
from threedvc.encoder.tracking.tracker import UNSEEN, Located, Script, Sight, pose_between, refined, refound
from threedvc.frames.frame import FrameSequence, SequenceInfo, moments, spread_step
from threedvc.frames.sensor_model import NoiseMeter

__all__ = ["calibrated_info", "depth_misfit", "mean_misfit", "misfit_frames", "noisier_sensors", "refined_script"]

MISFIT_FRAMES = 60
MISFIT_SCALE = 0.01
CALIBRATION_FRAMES = 40
CALIBRATION_POINTS = 5000


def calibrated_info(scene: Scene, frames: FrameSequence) -> SequenceInfo | None:
    """Calibrate the colour cameras on the background; None where all present ones are as good.

    Objects that move before a camera at rest change their shade as they turn, which would be taken for
    a wrong camera.
    """
    item = scene.objects[0]
    surface = read_surface(item.evidence, scene.config.threads)
    points = np.asarray((surface.cells + 0.5) * item.evidence.voxel_size_m, dtype=np.float64)
    chosen = np.random.default_rng(0).permutation(len(points))[:CALIBRATION_POINTS]
    found, rigs = [], scene.info.rigs
    for sensor, rig in enumerate(rigs):
        taken = [frame for frame in range(len(frames)) if scene.sensors[frame] == sensor]
        sightings = []
        for frame in taken[:: max(1, len(taken) // CALIBRATION_FRAMES)]:
            at = item.found[frame]
            if at is not None and at.usable:
                T_camera_object = rig.at_sensor(at.T_camera_object)
                sightings.append(sighting(points[chosen], scene.limited(frames[frame]), T_camera_object, rig.depth))
        found.append(calibrate(rig, sightings))
    if not any(found):
        return None
    return scene.info.with_rigs([better or rig for better, rig in zip(found, rigs, strict=True)])


def refined_script(scene: Scene, frames: FrameSequence, config: RegistrationConfig | None = None) -> Script:
    """Register every object in every frame once more; one that rests in the script goes on resting.

    One that was lost is looked for on the way between the frames before and after, and left there if it is not found.
    """
    script: Script = {number: [] for number in scene.objects}
    for moment in moments(map(scene.limited, frames), scene.info):
        looks = [(scene.views(frame), scene.labels(frame)) for frame in moment]
        for number, item in scene.objects.items():
            sights = [Sight(views, labels == number) for views, labels in looks]
            script[number] += [_refined(scene, item, sights, script[number], config)] * len(moment)
    return script


def misfit_frames(frames: FrameSequence) -> range:
    """Return the frames on which a misfit is measured."""
    return range(0, len(frames), spread_step(len(frames), MISFIT_FRAMES, frames.info))


def mean_misfit(pictures: Iterable[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> float:
    """Return how badly depths meet measurements, from 0 for exactly to 1, on an average over pairs of pictures.

    One per cent off counts a half. Pixels (n,) without the one or the other, 0, do not count.
    """
    misfits = []
    for found, measured in pictures:
        seen = (found > 0) & (measured > 0)
        if seen.any():
            squares = (found[seen] / measured[seen] - 1) ** 2
            misfits.append(float(np.mean(squares / (squares + MISFIT_SCALE**2))))
    return float(np.mean(misfits)) if misfits else 0.0


def depth_misfit(scene: Scene, frames: FrameSequence) -> float:
    """Return the `mean_misfit` of the background's evidence at its poses."""
    return mean_misfit((shown, measured) for _, shown, measured in _background_depths(scene, frames))


def noisier_sensors(scene: Scene, frames: FrameSequence) -> list[Sensor] | None:
    """Tell what sensors the frames come from, as their noise about the model shows; None if that is as was thought."""
    asked = [scene.config.sensor_of(sensor) for sensor in range(len(scene.info.rigs))]
    if Sensor.AUTO not in asked:
        return None
    meters = [NoiseMeter() for _ in asked]
    for index, shown, measured in _background_depths(scene, frames):
        meters[scene.sensors[index]].add(shown, measured, scene.objects[0].evidence.voxel_size_m)
    found = [
        sensor if sensor is not Sensor.AUTO else meter.better_than(scene.sensor_of(number)) or Sensor.AUTO
        for number, (sensor, meter) in enumerate(zip(asked, meters, strict=True))
    ]
    return found if found != asked else None


def _background_depths(
    scene: Scene, frames: FrameSequence
) -> Iterator[tuple[int, NDArray[np.float32], NDArray[np.float32]]]:
    """Yield, for frames spread over the sequence, their number, the depth of the background's evidence and theirs."""
    item = scene.objects[0]
    for index in misfit_frames(frames):
        at = item.found[index]
        if at is None or not at.usable:
            continue
        frame = scene.limited(frames[index])
        mask = scene.labels(frame) == 0
        views = scene.views(frame)
        there = views.rig.at_sensor(at.T_camera_object)
        yield index, *shown_and_measured(item.evidence, views, mask, there, scene.config.threads, exact=True)


def _refined(
    scene: Scene,
    item: SceneObject,
    sights: Sequence[Sight],
    before: list[Located | None],
    config: RegistrationConfig | None,
) -> Located | None:
    frame = sights[0].views.frame
    at, sensors = item.found[frame.index], [scene.sensor_of(sight.views.frame.sensor) for sight in sights]
    if at is None or at.status == UNSEEN:
        return at
    if not at.usable:
        between = pose_between(item.found, frame.index)
        return refound(at, between, sights, item.evidence, sensors, scene.config.threads)
    if frame.index and before[-1] is not None:
        previous = item.found[frame.index - 1]
        if previous is not None and np.array_equal(previous.T_camera_object, at.T_camera_object):
            return replace(at, T_camera_object=before[-1].T_camera_object)
    if scene.is_given(item, at):
        return at
    return refined(at, sights, item.evidence, sensors, scene.config.threads, config)
