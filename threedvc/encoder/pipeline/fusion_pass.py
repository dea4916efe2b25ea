# SPDX-License-Identifier: MIT
"""A pass over the frames of a sequence: each is taken into a scene, and told of."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from threedvc.config import EncoderConfig
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.tracking.pose_track import PoseTracks, TrackedPose, carry_resting_objects
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sequence import FrameSequence, frame_sets
from threedvc.stream.notes.frame_report import FrameReport, OnFrame
from threedvc.stream.pose_status import PoseStatus

__all__ = ["FrameReporter", "FusionPass", "Reconstruction", "fuse_frames"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Reconstruction:
    """What a pass over the frames found.

    Attributes
    ----------
    config
        Choices for the passes to come.
    scene
        Objects, evidence and poses.
    reports
        One for every frame.
    """

    config: EncoderConfig
    scene: Scene
    reports: list[FrameReport]

    @property
    def info(self) -> SequenceInfo:
        """The sequence, with the cameras as they are known now."""
        return self.scene.info

    @property
    def poses(self) -> PoseTracks:
        """Where every object was found in every frame."""
        return {number: item.found for number, item in self.scene.objects.items()}

    @property
    def has_depth(self) -> bool:
        """Whether any frame had a measurement that was fused."""
        return any(item.evidence.index.count for item in self.scene.objects.values())

    @property
    def tracked(self) -> bool:
        """Whether the poses of anything were found by tracking."""
        return any(item.tracker is not None for item in self.scene.objects.values())


class FrameReporter:
    """Makes the report of each frame, and tells the caller of it.

    Parameters
    ----------
    on_frame
        Called with each report.
    """

    def __init__(self, on_frame: OnFrame | None = None) -> None:
        self._on_frame = on_frame
        self._began = time.perf_counter()

    def report(self, frame: Frame, status: PoseStatus, entropy_bits: float) -> FrameReport:
        """Return the report of a frame that was just fused."""
        report = FrameReport(
            index=frame.index,
            timestamp_ns=frame.timestamp_ns,
            status=status,
            entropy_bits=entropy_bits,
            seconds=time.perf_counter() - self._began,
        )
        if self._on_frame is not None:
            self._on_frame(report)
        return report

    def fuse(self, scene: Scene, frame_set: Sequence[Frame]) -> list[FrameReport]:
        """Take the frames of one moment into a scene."""
        status = scene.add(*frame_set)
        return [self.report(frame, status, scene.entropy_bits) for frame in frame_set]


def fuse_frames(
    frames: Iterable[Frame], scene: Scene, reporter: FrameReporter, config: EncoderConfig | None = None
) -> Reconstruction:
    """Take all frames into a scene; `config` are the choices for later passes where they differ from the scene's."""
    reports: list[FrameReport] = []
    for frame_set in frame_sets(frames, scene.info):
        reports += reporter.fuse(scene, frame_set)
    return Reconstruction(config=config or scene.config, scene=scene, reports=reports)


@dataclass(frozen=True, eq=False)
class FusionPass:
    """Fuses frames that can be read again, as often as it is asked to.

    Attributes
    ----------
    frames
        The sequence.
    reporter
        Is told of every frame in every pass.
    """

    frames: FrameSequence
    reporter: FrameReporter

    def fuse(self, scene: Scene, config: EncoderConfig | None = None) -> Reconstruction:
        """Take all frames into a scene, see `fuse_frames`."""
        return fuse_frames(self.frames, scene, self.reporter, config)

    def fuse_at(self, state: Reconstruction, poses: Mapping[int, Sequence[TrackedPose | None]]) -> Reconstruction:
        """Fuse all frames anew at given poses; what rests in the background is carried along with it."""
        carried = carry_resting_objects(poses, state.poses)
        return self.fuse(Scene(state.info, state.config, carried, state.scene.sequence_labels))
