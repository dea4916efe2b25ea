# SPDX-License-Identifier: MIT
"""What an encoder that can read the frames again does after the first pass.

The finished model knows more than the model so far did when each frame was fused: the colour camera is
calibrated against it, every frame's poses are registered with it once more, and all frames are fused anew.
What the decoder will draw is fitted to the pictures afterwards (`threedvc.finishing`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from threedvc.calibration import calibrate, sighting
from threedvc.camera import CameraRig
from threedvc.evidence_view import FrameViews
from threedvc.frame import Frame, FrameSequence
from threedvc.motion import Located, refined
from threedvc.readout import read_surface
from threedvc.scene import Scene, SceneObject
from threedvc.segmentation import segment

__all__ = ["calibrated_rig", "refined_script"]

CALIBRATION_FRAMES = 40
CALIBRATION_POINTS = 5000


def calibrated_rig(scene: Scene, frames: FrameSequence) -> CameraRig | None:
    """Calibrate the colour camera on the background; None where the present rig is as good.

    Objects that move before a camera at rest change their shade as they turn, which would be taken for
    a wrong camera.
    """
    item = scene.objects[0]
    surface = read_surface(item.evidence, scene.config.threads)
    points = np.asarray((surface.cells + 0.5) * item.evidence.voxel_size_m, dtype=np.float64)
    chosen = np.random.default_rng(0).permutation(len(points))[:CALIBRATION_POINTS]
    step = max(1, len(frames) // CALIBRATION_FRAMES)
    sightings = []
    for frame in range(0, len(frames), step):
        at = item.found[frame]
        if at is not None and at.usable:
            sightings.append(
                sighting(points[chosen], scene.limited(frames[frame]), at.T_camera_object, scene.info.rig.depth)
            )
    return calibrate(scene.info.rig, sightings)


def refined_script(
    scene: Scene, frames: FrameSequence, on_frame: Callable[[Frame], None] | None = None
) -> dict[int, list[Located | None]]:
    """Register every object in every frame once more; one that rests in the script goes on resting."""
    script: dict[int, list[Located | None]] = {number: [] for number in scene.objects}
    for frame in map(scene.limited, frames):
        labels = segment(frame, scene.config.segmentation, scene.info)
        views = scene.views(frame)
        for number, item in scene.objects.items():
            script[number].append(_refined(scene, item, views, labels == number, script[number]))
        if on_frame is not None:
            on_frame(frame)
    return script


def _refined(
    scene: Scene,
    item: SceneObject,
    views: FrameViews,
    mask: np.ndarray[tuple[int, int], np.dtype[np.bool_]],
    before: list[Located | None],
) -> Located | None:
    at = item.found[views.frame.index]
    if at is None or not at.usable:
        return at
    if views.frame.index and before[-1] is not None:
        previous = item.found[views.frame.index - 1]
        if previous is not None and np.array_equal(previous.T_camera_object, at.T_camera_object):
            return replace(at, T_camera_object=before[-1].T_camera_object)
    if scene.is_given(item, at):
        return at
    return refined(at, views, mask, item.evidence, scene.sensor, scene.config.threads)
