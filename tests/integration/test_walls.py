# SPDX-License-Identifier: MIT
"""A camera at rest before a wall that tells nothing of motion along it must not slide on what noise makes of that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from threedvc.config import EncoderConfig, Motion
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import rotation_angle

SIZE = WIDTH, HEIGHT = 120, 90
RIG = CameraRig.registered_to(Camera(width=WIDTH, height=HEIGHT, fx=110, fy=110, cx=59.5, cy=44.5))
INFO = SequenceInfo(name="wall", rig=RIG, depth_scale=1000.0, fps=30.0, frame_count=None)
DISTANCE_M, DEPTH_NOISE_M, LUMA_NOISE = 1.5, 0.004, 3.0


def seen(index: int, shades: np.ndarray, rng: np.random.Generator) -> Frame:
    depth = DISTANCE_M + rng.normal(scale=DEPTH_NOISE_M, size=(HEIGHT, WIDTH))
    gray = shades + rng.normal(scale=LUMA_NOISE, size=(HEIGHT, WIDTH))
    color = np.repeat(np.clip(gray, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
    return Frame(index=index, timestamp_ns=index * 33_333_333, color=color, depth=depth.astype(np.float32))


@pytest.mark.parametrize(
    "shades", [np.full((1, WIDTH), 150.0), np.linspace(60, 200, WIDTH)[None]], ids=["gray", "shaded"]
)
@pytest.mark.parametrize("flicker", [0.0, 40.0])
def test_the_camera_rests(shades: np.ndarray, flicker: float, rng: np.random.Generator) -> None:
    scene = Scene(INFO, replace(EncoderConfig(), motion=Motion.TRACK))
    for index in range(12):
        scene.add(seen(index, shades + flicker * (index % 2), rng))
    ways = [float(np.linalg.norm(pose[:3, 3])) for pose in scene.objects[0].poses]
    assert max(ways) < 0.003
    assert max(map(rotation_angle, scene.objects[0].poses)) < 0.002
