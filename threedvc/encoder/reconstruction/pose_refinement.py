# SPDX-License-Identifier: MIT
"""What an encoder that can read the frames again does after the first pass.

The finished model knows more than the model so far did when each frame was fused: the color camera is
calibrated against it, every frame's poses are registered with it once more, and all frames are fused anew.
What the decoder will draw is fitted to the pictures afterwards (`threedvc.encoder.appearance.appearance_fit`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.reconstruction.scene_object import SceneObject
from threedvc.encoder.registration.frame_resolutions import ObjectView
from threedvc.encoder.registration.registration import RegistrationConfig
from threedvc.encoder.tracking.joint_registration import RegistrationSettings, relocalize_near, reregister
from threedvc.encoder.tracking.pose_track import PoseTracks, TrackedPose, pose_between
from threedvc.frames.sequence import FrameSequence, frame_sets
from threedvc.stream.pose_status import PoseStatus

__all__ = ["refine_poses"]


def refine_poses(scene: Scene, frames: FrameSequence, config: RegistrationConfig | None = None) -> PoseTracks:
    """Register every object in every frame once more; one that rests in the script goes on resting.

    One that was lost is looked for on the way between the frames before and after, and left there if it is not found.
    """
    script: PoseTracks = {number: [] for number in scene.objects}
    for frame_set in frame_sets(map(scene.with_depth_limit, frames), scene.info):
        prepared = [(scene.views(frame), scene.labels(frame)) for frame in frame_set]
        for number, item in scene.objects.items():
            seen = [ObjectView(views, labels == number) for views, labels in prepared]
            script[number] += [_refined(scene, item, seen, script[number], config)] * len(frame_set)
    return script


def _refined(
    scene: Scene,
    item: SceneObject,
    seen: Sequence[ObjectView],
    before: list[TrackedPose | None],
    config: RegistrationConfig | None,
) -> TrackedPose | None:
    frame = seen[0].views.frame
    at, default = item.found[frame.index], RegistrationConfig()
    settings = RegistrationSettings(sensor_of=scene.sensor_of, threads=scene.config.threads, config=config or default)
    if at is None or at.status is PoseStatus.UNSEEN:
        return at
    if not at.usable:
        between = pose_between(item.found, frame.index)
        return relocalize_near(at, between, seen, item.evidence, replace(settings, config=default))
    if frame.index and before[-1] is not None:
        previous = item.found[frame.index - 1]
        if previous is not None and np.array_equal(previous.T_camera_object, at.T_camera_object):
            return replace(at, T_camera_object=before[-1].T_camera_object)
    if item.is_given(at):
        return at
    return reregister(at, seen, item.evidence, settings)
