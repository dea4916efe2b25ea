# SPDX-License-Identifier: MIT
"""Coding of poses: predicted with constant velocity, quantized in a closed loop, entropy coded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.entropy.range_coder import RangeReader, RangeWriter, new_counters
from threedvc.errors import CorruptStream
from threedvc.geometry.pose import Pose, make_pose, quaternion
from threedvc.kernels.coding.pose_coding import POSE_COUNTERS, RECENT_SIZE, code_residuals, follow_poses, repeats_last

__all__ = ["PoseCoder"]

MAX_TRANSLATION_M = 1e6
"""A pose further away is damage: a thousand kilometers."""
BYTES_PER_FRAME = 320
"""Room for one: the costliest takes 288, of six numbers of 30 bits."""


class PoseCoder:
    """The coder of one object's poses; encoder and decoder hold one each, in the same state.

    Parameters
    ----------
    translation_step_m, rotation_step_rad
        Quantization steps. A decoded pose is within half a step of the given one on every axis.

    Attributes
    ----------
    decoded
        (k, 4, 4) poses of the latest call of `encode` or `decode`, as the decoder sees them.
    """

    def __init__(self, translation_step_m: float, rotation_step_rad: float) -> None:
        self._steps = np.array([translation_step_m, rotation_step_rad], dtype=np.float64)
        self._state = np.zeros((2, 7))
        self._state[:, 0] = 1
        self._costs = np.zeros(2)
        self._counters = new_counters(POSE_COUNTERS)
        self._recent = np.zeros(RECENT_SIZE, dtype=np.int64)
        self.decoded: NDArray[np.float64] = np.empty((0, 4, 4))

    def reset_velocity(self) -> None:
        """Note that frames passed without motion: the velocity becomes zero."""
        self._state[1] = self._state[0]

    def repeats(self, pose: Pose) -> bool:
        """Tell whether `pose` would be decoded as exactly the last pose, so that it needs no packet."""
        residual = np.zeros(6, dtype=np.int64)
        return bool(repeats_last(_flattened([pose])[0], self._state[0], self._steps, residual))

    def encode(self, poses: Sequence[Pose] | NDArray[np.float64]) -> bytes:
        """Return the payload of poses (k, 4, 4) and leave them in `decoded` as the decoder sees them."""
        count = len(poses)
        still, residuals = np.zeros(count, dtype=np.int64), np.zeros((count, 6), dtype=np.int64)
        flat = np.empty((count, 7))
        follow_poses(True, _flattened(poses), still, residuals, self._state, self._costs, self._steps, flat)
        writer = RangeWriter()
        writer.reserve(BYTES_PER_FRAME * count)
        code_residuals(writer.coder, still, residuals, self._recent, self._counters)
        self.decoded = _matrices(flat)
        return writer.finish()

    def decode(self, payload: bytes, count: int) -> NDArray[np.float64]:
        """Return the (count, 4, 4) poses of a payload.

        Raises
        ------
        CorruptStream
            If the payload does not hold `count` poses.
        """
        reader = RangeReader(payload)
        still, residuals = np.zeros(count, dtype=np.int64), np.zeros((count, 6), dtype=np.int64)
        complete = code_residuals(reader.coder, still, residuals, self._recent, self._counters)
        if not complete:
            raise CorruptStream(f"pose payload of {len(payload)} bytes ends within {count} poses")
        reader.finish()
        flat = np.empty((count, 7))
        follow_poses(False, flat, still, residuals, self._state, self._costs, self._steps, flat)
        if not np.all(np.abs(flat) < MAX_TRANSLATION_M):
            raise CorruptStream(f"a decoded pose is more than {MAX_TRANSLATION_M:.0f} m away")
        self.decoded = _matrices(flat)
        return self.decoded


def _flattened(poses: Sequence[Pose] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (k, 7) quaternions ``w, x, y, z`` and translations of poses."""
    flat = np.empty((len(poses), 7))
    for row, pose in zip(flat, poses, strict=True):
        row[1:4], row[0] = (q := quaternion(pose[:3, :3]))[:3], q[3]
        row[4:] = pose[:3, 3]
    return flat


def _matrices(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (k, 4, 4) poses, with + - * alone."""
    poses = np.empty((len(flat), 4, 4))
    for pose, (w, x, y, z, *translation) in zip(poses, flat.tolist(), strict=True):
        rotation = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        pose[:] = make_pose(np.array(rotation), np.array(translation))
    return poses
