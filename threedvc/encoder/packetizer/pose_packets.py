# SPDX-License-Identifier: MIT
"""Packets of poses: where objects are, and how the camera moved between depth and color picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from threedvc.encoder.packetizer.frame_runs import runs_of
from threedvc.encoder.packetizer.scene_source import BatchFrames, SceneSource, frames_by_sensor
from threedvc.encoder.packetizer.sent_state import PoseSteps, SentObject, SentState
from threedvc.geometry.pose import Pose, compose, identity, inverse
from threedvc.stream.headers import PoseHeader, ShiftHeader
from threedvc.stream.packets import Packet

__all__ = ["pose_packets", "shift_packets", "stream_poses"]

MAX_STILL_GAP = 2
"""Rests of up to so many moments do not divide a run: to code them costs less than the header of another packet."""


def stream_poses(scene: SceneSource, number: int, frames: Sequence[int]) -> list[Pose]:
    """Return the poses that the stream carries: the background's before the rig, others' in the background."""
    poses = [scene.objects[number].poses[frame] for frame in frames]
    if not number:
        return poses
    world = [scene.objects[0].poses[frame] for frame in frames]
    return [compose(inverse(T_camera_world), pose) for T_camera_world, pose in zip(world, poses, strict=True)]


def pose_packets(sent: SentObject, steps: PoseSteps, poses: Sequence[Pose], batch: BatchFrames) -> Iterator[Packet]:
    """Yield a packet for every run of moments in which an object moves.

    Parameters
    ----------
    sent
        What the decoder has of the object.
    steps
        Quantization steps.
    poses
        Its poses as the stream carries them, one for each moment of the batch.
    batch
        The frames.
    """
    for start, end in runs_of(_moving(sent, steps, poses), MAX_STILL_GAP):
        if sent.next_moment != batch.moments_before + start:
            sent.pose_coder.reset_velocity()
        payload = sent.pose_coder.encode(poses[start:end])
        sent.last_pose, sent.next_moment = poses[end - 1], batch.moments_before + end
        yield PoseHeader(object_id=sent.number, frame=batch.moments[start], count=end - start).packet(payload)


def shift_packets(sent: SentState, scene: SceneSource, shifts: Sequence[Pose], batch: BatchFrames) -> Iterator[Packet]:
    """Yield the shifts of a batch, unless there are none at all; `shifts` are those of all frames, or empty."""
    if all(np.array_equal(shift, identity()) for shift in shifts):
        return
    for sensor, frames in frames_by_sensor(scene, batch):
        payload = sent.shift_coders[sensor].encode([shifts[frame] for frame in frames])
        yield ShiftHeader(frame=frames[0], count=len(frames), sensor=sensor).packet(payload)


def _moving(sent: SentObject, steps: PoseSteps, poses: Sequence[Pose]) -> list[bool]:
    """Tell in which moments an object's pose differs from the one last sent by a quantization step."""
    moving: list[bool] = []
    last = sent.last_pose
    for pose in poses:
        still = sent.pose_coder.repeats(pose) if last is None else _is_near(pose, last, steps)
        moving.append(not still)
        last = last if still else pose
    return moving


def _is_near(pose: Pose, other: Pose, steps: PoseSteps) -> bool:
    """Tell whether two poses differ by less than half a step of translation and a step of rotation."""
    displacement, rotation = pose[:3, 3] - other[:3, 3], pose[:3, :3] - other[:3, :3]
    return bool(2 * np.abs(displacement).max() < steps.translation_m and np.abs(rotation).max() < steps.rotation_rad)
