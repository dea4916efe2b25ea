# SPDX-License-Identifier: MIT
"""A color camera that is not where the recording says, as of most recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from helpers.recorded_room import depth_picture, wall_colors, wall_points
from threedvc.config import EncoderConfig, Preset, with_preset
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, compose, identity, inverse, make_pose, rotation_from_vector
from threedvc.units import MILLIMETERS

CAMERA = Camera(width=120, height=90, fx=110.0, fy=110.0, cx=59.5, cy=44.5)
LONGER = replace(CAMERA, fx=119.0, fy=119.0)
"""By 8 %, as of the kitchen among the recordings."""
ASIDE = make_pose(np.eye(3), np.array([0.03, 0.0, 0.0]))
FRAMES = 36
NOISE = 0.005
"""Of depth, relative: as of a Kinect at two meters."""
FINER = 8.0
"""Times as fine as they are drawn elsewhere are the patterns on the walls: of slopes that tell where they are."""


def path() -> list[Pose]:
    """Return T_world_camera of a camera that looks into a corner of the room and pans."""
    turns = (np.array([0.25 + 0.002 * k, -0.5 + 0.012 * k, 0.0]) for k in range(FRAMES))
    places = (np.array([0.2 - 0.01 * k, 0.1, -0.5]) for k in range(FRAMES))
    return [make_pose(rotation_from_vector(turn), place) for turn, place in zip(turns, places, strict=True)]


def drift_m(scene: Scene, poses: Sequence[Pose]) -> float:
    """Return how far from where it is the camera was found at last."""
    rng = np.random.default_rng(5)
    for index, pose in enumerate(poses):
        color = wall_colors(FINER * wall_points(LONGER, compose(pose, ASIDE))[0])
        exact = depth_picture(CAMERA, pose, MILLIMETERS) / MILLIMETERS
        depth = (exact * (1 + rng.normal(0, NOISE, exact.shape))).astype(np.float32)
        scene.add(Frame(index=index, timestamp_ns=index * 33_000_000, color=color, depth=depth))
    moved = compose(scene.objects[0].poses[0], inverse(scene.objects[0].poses[-1]))
    return float(np.linalg.norm(compose(inverse(moved), compose(inverse(poses[0]), poses[-1]))[:3, 3]))


def test_live_the_depth_tells_where_the_camera_is() -> None:
    rig = CameraRig(depth=CAMERA, color=CAMERA, T_color_depth=identity())
    info = SequenceInfo(name="unregistered", rig=rig, depth_scale=MILLIMETERS, fps=30.0, frame_count=FRAMES)
    live = with_preset(EncoderConfig(threads=1), Preset.LIVE)
    drift, with_full_luma = drift_m(Scene(info, live), path()), drift_m(Scene(info, live, luma_weight=1.0), path())
    assert drift < 0.5 * with_full_luma
    assert drift < 0.02
