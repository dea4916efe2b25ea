# SPDX-License-Identifier: MIT
"""Cameras that stand still, told by their pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from helpers.hand_scene import pushing
from helpers.streams import ListSequence
from threedvc.config import EncoderConfig, Motion, SegmentationConfig, SegmentationMode
from threedvc.encoder.pipeline.fusion_pass import FrameReporter, FusionPass
from threedvc.encoder.pipeline.offline_passes import find_objects
from threedvc.encoder.tracking.resting_camera import camera_rests
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import identity

CAMERA = Camera(width=160, height=120, fx=150, fy=150, cx=79.5, cy=59.5)
RIG = CameraRig(color=CAMERA, depth=CAMERA, T_color_depth=identity())
INFO = SequenceInfo(name="room", rig=RIG, depth_scale=1000, fps=30, frame_count=20)
RNG = np.random.default_rng(1)
PICTURE = np.kron(RNG.integers(40, 200, (24, 40, 3)), np.ones((10, 8, 1))).astype(np.uint8)


def sequence(change: Callable[[int], np.ndarray], count: int = 20, approach: float = 0) -> ListSequence:
    frames = []
    for index in range(count):
        depth = np.full((120, 160), 2 - approach * index, np.float32)
        noisy = change(index) + RNG.normal(0, 2, (120, 160, 3))
        color = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        frames.append(Frame(index=index, timestamp_ns=index * 33_000_000, color=color, depth=depth))
    return ListSequence(frames, replace(INFO, frame_count=count))


def view(across: float = 0) -> np.ndarray:
    whole = int(np.floor(across))
    part = across - whole
    left, right = PICTURE[:120, whole : whole + 160], PICTURE[:120, whole + 1 : whole + 161]
    return (1 - part) * left + part * right


def test_a_camera_rests_in_noise_and_with_other_exposures() -> None:
    assert camera_rests(sequence(lambda _: view()))
    assert camera_rests(sequence(lambda index: view() * (1 - 0.02 * index)))


def test_it_rests_while_something_fills_a_third_of_the_picture() -> None:
    def change(index: int) -> np.ndarray:
        picture = view()
        picture[:, 2 * index : 2 * index + 53] = PICTURE[100:220, 90:143]
        return picture

    assert camera_rests(sequence(change))


@pytest.mark.parametrize("step", [0.1, 1.0, 6.0])
def test_a_camera_that_moves_does_not_rest(step: float) -> None:
    assert not camera_rests(sequence(lambda index: view(step * index)))


def test_one_that_moves_in_the_end_does_not_rest() -> None:
    assert not camera_rests(sequence(lambda index: view(5.0 * (index > 16))))


def test_a_camera_does_not_rest_where_all_that_stays_is_carried_along() -> None:
    assert camera_rests(sequence(lambda _: view(), approach=0.001))
    assert not camera_rests(sequence(lambda _: view(), approach=0.02))


def test_nothing_is_told_without_edges_or_of_a_single_frame() -> None:
    assert not camera_rests(sequence(lambda _: np.full((120, 160, 3), 90.0)))
    assert not camera_rests(sequence(lambda _: view(), 1))


@pytest.mark.parametrize("held", [False, True])
def test_a_camera_at_rest_is_not_tracked(held: bool) -> None:
    frames = pushing(8, (96, 72), held=held)
    config = EncoderConfig(
        motion=Motion.TRACK, segmentation=SegmentationConfig(mode=SegmentationMode.NONE), refine=False, threads=1
    )
    background = find_objects(frames.info, config, FusionPass(frames, FrameReporter(None))).scene.objects[0]
    assert (background.tracker is None) is not held
    assert background.at_rest is not held
