# SPDX-License-Identifier: MIT
"""Where sensors are mounted, corrected by what they see in common.

Extrinsics are measured by hand or by a calibration of long ago: an error of a degree draws every surface twice. The
frames of the first sensor make a model; those of another one are registered with it, each at its pose, and the motion
that all of them ask for, weighed by how surely each tells it, is the error of its mounting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from threedvc.arrays import Doubles
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import fuse, observe
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.registration.frame_resolutions import ObjectView
from threedvc.encoder.registration.icp import Alignment
from threedvc.encoder.registration.initial_poses import register_multi_start
from threedvc.encoder.registration.model_view import raycast_model
from threedvc.encoder.registration.registration import RegistrationConfig, RegistrationProblem
from threedvc.frames.frame import SequenceInfo
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import Pose, compose, exp_motion, inverse, log_motion, orthonormalized
from threedvc.metrics.depth_errors import geman_mcclure_error
from threedvc.stream.pose_status import PoseStatus

__all__ = ["calibrate_extrinsics"]

MODEL_FRAMES, COMPARED_FRAMES = 120, 30
"""Of the first sensor and of each other one, at most, spread over time: a model needs many views, and a correction that
is the same in all frames few."""
MIN_FRAMES = 4
"""Fewer may all be wrong alike."""
ROUNDS = 3
"""Registration from a corrected mounting finds better matches: it is done three times (decision 0018)."""
MIN_OVERLAP = 0.2
"""Part of a frame's samples that must meet what the first sensor has seen: the rest says nothing."""
OUTLIER = 3.0
"""Corrections that lie further from all than this many times their median distance do not count."""
WORTHWHILE = 0.97
"""Part of the depth error that another mounting must leave at most: 3 % off (decision 0018)."""
BY_DEPTH = RegistrationConfig(luma_weight=0.1)
"""Sensors see colors each in its own way, and calibration of the color cameras comes later."""


class _Correction(NamedTuple):
    """What one frame asks for: a motion of the mounting (rotation, translation) (6,), and its information (6, 6)."""

    twist: Doubles
    information: Doubles


def calibrate_extrinsics(scene: Scene, frames: FrameSequence) -> SequenceInfo | None:
    """Return the sequence with sensors mounted where their frames fit those of the first one; None: as they are.

    Only the background counts. A sensor that sees nothing that the first one has seen stays as it is.
    """
    info = scene.info
    if not info.sensors:
        return None
    model = _first_model(scene, frames)
    rigs = list(info.rigs)
    for sensor in range(1, len(rigs)):
        chosen = _chosen(scene, sensor, COMPARED_FRAMES)
        before = _depth_error(scene, frames, chosen, model, rigs[sensor].T_depth_rig)
        mount = rigs[sensor].T_depth_rig
        for _ in range(ROUNDS):
            mount = _corrected(scene, frames, chosen, model, mount)
        if _depth_error(scene, frames, chosen, model, mount) < WORTHWHILE * before:
            rigs[sensor] = replace(rigs[sensor], T_depth_rig=mount)
    same = all(one is other for one, other in zip(rigs, info.rigs, strict=True))
    return None if same else info.with_rigs(rigs)


def _chosen(scene: Scene, sensor: int, most: int) -> list[int]:
    """Return frames of a sensor in which the background was found, spread over time."""
    found = scene.objects[0].found
    usable = [
        frame
        for frame, at in enumerate(found)
        if at is not None and at.usable and scene.records[frame].sensor == sensor and not scene.records[frame].repeated
    ]
    return usable[:: max(1, -(-len(usable) // most))]


def _first_model(scene: Scene, frames: FrameSequence) -> EvidenceModel:
    """Return a model of the background as the first sensor has seen it."""
    item, rig, threads = scene.objects[0], scene.info.rig, scene.config.threads
    model, rays = EvidenceModel(item.evidence.voxel_size_m), rig.depth.rays()
    for number in _chosen(scene, 0, MODEL_FRAMES):
        frame, at = scene.with_depth_limit(frames[number]), item.found[number]
        assert at is not None
        mask, seen = scene.labels(frame) == 0, observe(frame, rig, rays)
        fuse(model, seen, mask, at.T_camera_object, scene.sensor_of(0), scene.config.fusion, threads)
    return model


def _corrected(scene: Scene, frames: FrameSequence, chosen: Sequence[int], model: EvidenceModel, mount: Pose) -> Pose:
    """Return a mounting corrected once by what frames of its sensor ask for."""
    corrections = [each for number in chosen if (each := _correction(scene, frames, number, model, mount)) is not None]
    if len(corrections) < MIN_FRAMES:
        return mount
    middle = np.median([each.twist for each in corrections], axis=0)
    away = np.array([float(np.linalg.norm(each.twist - middle)) for each in corrections])
    kept = [each for each, far in zip(corrections, away, strict=True) if far <= OUTLIER * np.median(away) + 1e-9]
    matrix = np.sum([each.information for each in kept], axis=0)
    side = np.sum([each.information @ each.twist for each in kept], axis=0)
    twist = np.linalg.solve(matrix + 1e-6 * np.trace(matrix) * np.eye(6), side).astype(np.float64)
    return orthonormalized(compose(exp_motion(twist), mount))


def _correction(
    scene: Scene, frames: FrameSequence, number: int, model: EvidenceModel, mount: Pose
) -> _Correction | None:
    """Register a frame with the model, and return how its sensor should be moved for it to fit; None if it is lost."""
    at = scene.objects[0].found[number]
    assert at is not None
    frame = scene.with_depth_limit(frames[number])
    seen = ObjectView(scene.views(frame), scene.labels(frame) == 0)
    threads, sigma_m = scene.config.threads, scene.sensor_of(frame.sensor).sigma_m
    guess = compose(mount, at.T_camera_object)
    view = raycast_model(model, seen.resolution, guess, threads, exact=True)
    problem = RegistrationProblem(sample=seen.sample, view=view, sigma_m=sigma_m, config=BY_DEPTH, threads=threads)
    found = register_multi_start(problem, guess)
    if found.status is PoseStatus.LOST or found.overlap < MIN_OVERLAP:
        return None
    information = Alignment(problem).information(found.T_camera_object)
    return None if information is None else _Correction(log_motion(found.T_camera_object @ inverse(guess)), information)


def _depth_error(
    scene: Scene, frames: FrameSequence, chosen: Sequence[int], model: EvidenceModel, mount: Pose
) -> float:
    """Return the `geman_mcclure_error` of frames of a sensor with the model, if the sensor were mounted so."""
    pictures = []
    for number in chosen:
        at = scene.objects[0].found[number]
        assert at is not None
        frame = scene.with_depth_limit(frames[number])
        seen = ObjectView(scene.views(frame), scene.labels(frame) == 0)
        guess = compose(mount, at.T_camera_object)
        view = raycast_model(model, seen.resolution, guess, scene.config.threads, exact=True)
        pictures.append((view.depth, seen.object_depth))
    return geman_mcclure_error(pictures)
