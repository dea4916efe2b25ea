# SPDX-License-Identifier: MIT
"""What the packetizer asks of a scene, and the frames of a batch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.reconstruction.frame_intake import FrameRecord
from threedvc.frames.frame import SequenceInfo
from threedvc.geometry.pose import Pose

__all__ = ["BatchFrames", "ObjectSource", "SceneSource", "frames_by_sensor"]


class ObjectSource(Protocol):
    """What is asked of an object; `threedvc.encoder.reconstruction.scene_object.SceneObject` has it."""

    @property
    def born(self) -> int | None:
        """First frame in which it was found."""

    @property
    def passing(self) -> bool:
        """Whether it stands for things that are there for a moment."""

    @property
    def poses(self) -> Sequence[Pose]:
        """T_camera_object before the rig in every frame so far."""

    @property
    def evidence(self) -> EvidenceModel:
        """Its model."""

    @property
    def in_sight(self) -> NDArray[np.bool_]:
        """Which blocks (n,) of the evidence were in the field of view in the last few frames."""


class SceneSource(Protocol):
    """What is asked of a scene; `threedvc.encoder.reconstruction.scene.Scene` has it. A live one grows by frames."""

    @property
    def info(self) -> SequenceInfo:
        """The sequence."""

    @property
    def distance_m(self) -> float:
        """Median depth of the first frame that has any."""

    @property
    def objects(self) -> Mapping[int, ObjectSource]:
        """Objects by number; 0 is the background."""

    @property
    def records(self) -> Sequence[FrameRecord]:
        """What is kept of every frame so far."""


@dataclass(frozen=True)
class BatchFrames:
    """The frames of a batch.

    Attributes
    ----------
    first, stop
        The frames ``first..stop``.
    moments
        Those of them that begin a moment; the others were taken together with the frame before.
    moments_before
        How many moments the stream had before.
    """

    first: int
    stop: int
    moments: list[int]
    moments_before: int

    @classmethod
    def of(cls, scene: SceneSource, first: int, stop: int) -> BatchFrames:
        """Return the frames ``first..stop`` of a scene."""
        records = scene.records
        moments = [frame for frame in range(first, stop) if not records[frame].synchronized]
        return cls(first, stop, moments, first - sum(record.synchronized for record in records[:first]))

    @property
    def count(self) -> int:
        """Number of frames."""
        return self.stop - self.first

    def __contains__(self, frame: int) -> bool:
        return self.first <= frame < self.stop


def frames_by_sensor(scene: SceneSource, batch: BatchFrames) -> Iterator[tuple[int, list[int]]]:
    """Yield the sensors that took frames of a batch, and these frames."""
    for sensor in range(len(scene.info.rigs)):
        frames = [frame for frame in range(batch.first, batch.stop) if scene.records[frame].sensor == sensor]
        if frames:
            yield sensor, frames
