# SPDX-License-Identifier: MIT
"""Packets of a scene: what the decoder lacks, group by group.

The emitter holds a decoder's state: models as decoded, poses as quantised. A model update is the
difference between what is to be seen and that state; a group without difference has no packet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction

import numpy as np

from threedvc.camera import Camera
from threedvc.coding.color import ColorSettings
from threedvc.coding.poses import PoseCoder
from threedvc.coding.update import encode_update_with_result
from threedvc.config import EncoderConfig
from threedvc.decoder import models_digest, nearest_multiple
from threedvc.frame import NANOSECONDS, SequenceInfo
from threedvc.limits import MAX_COUNT
from threedvc.model_update import ModelUpdate
from threedvc.object_model import DecodedModel
from threedvc.packets import (
    BatchHeader,
    ClockHeader,
    EndHeader,
    ModelHeader,
    ObjectHeader,
    Packet,
    PoseHeader,
    StreamHeader,
    pack_batch,
)
from threedvc.pose import Pose, compose, inverse
from threedvc.readout import Surface, changes, first_sights, in_regions, read_surface
from threedvc.report import FrameReport, report_packet
from threedvc.scene import Scene, SceneObject
from threedvc.wire import pack_signed_varint

__all__ = ["Emitter"]

MAX_STILL_GAP = 2
MIN_LIVE_CELLS = 4
"""A live encoder lets fewer changed cells than these wait for more: their framing would outweigh them."""
MAX_REST = MAX_COUNT // 2


class _Sent:
    """What the decoder has of one object, and what it would have if colours were not quantised."""

    def __init__(self, item: SceneObject, config: EncoderConfig) -> None:
        self.item = item
        self.model = DecodedModel(item.evidence.voxel_size_m)
        self.wanted = DecodedModel(item.evidence.voxel_size_m)
        self.coder = PoseCoder(config.pose.translation_step_m, config.pose.rotation_step_rad)
        self.given: Pose | None = None
        self.next_coded: int | None = None
        self.final: Surface | None = None


class Emitter:
    """Turns a scene into packets.

    Parameters
    ----------
    scene
        The scene; a live encoder adds frames to it between groups.
    config
        Choices.
    """

    def __init__(self, scene: Scene, config: EncoderConfig) -> None:
        self._scene, self._config, self._info = scene, config, scene.info
        self._sent: dict[int, _Sent] = {}
        self._color = ColorSettings(
            luma_step=config.color.luma_step, chroma_step=config.color.chroma_step, grey=scene.info.grey
        )
        self._clock = _clock(scene.info)
        self._batched = 0

    @property
    def digest(self) -> bytes:
        """Digest of the decoded models so far."""
        return models_digest({number: sent.model for number, sent in self._sent.items()})

    def stream(self) -> Packet:
        """Return the STREAM packet."""
        info, rig = self._info, self._info.rig
        return StreamHeader(
            color_camera=_camera_record(rig.color),
            depth_camera=() if rig.depth == rig.color else _camera_record(rig.depth),
            T_color_depth=()
            if np.array_equal(rig.T_color_depth, np.eye(4))
            else tuple(rig.T_color_depth[:3].ravel().tolist()),
            depth_scale=info.depth_scale,
            start_ns=self._scene.timestamps[0],
            period_num=self._clock[0],
            period_den=self._clock[1],
            translation_step_m=self._config.pose.translation_step_m,
            rotation_step_rad=self._config.pose.rotation_step_rad,
            grey=info.grey,
            given_world=info.has_camera_poses,
            name=info.name,
        ).packet()

    def group(self, first: int, stop: int, reports: Sequence[FrameReport], *, last: bool) -> Packet | None:
        """Return the BATCH of frames ``first..stop``, or None if nothing changes in them and none is due.

        Parameters
        ----------
        first, stop
            Frames of the group; the scene has taken in all of them.
        reports
            What to tell about them; empty: nothing.
        last
            Whether no frame follows: the batch then holds every cell that is still due.
        """
        members = list(self._clock_packets(first, stop))
        for number in sorted(self._scene.objects):
            members += self._object(number, first, stop, last)
        members += [report_packet(reports[start : start + MAX_COUNT]) for start in range(0, len(reports), MAX_COUNT)]
        if not members and stop - self._batched <= MAX_REST:
            return None
        self._batched = stop
        return pack_batch(BatchHeader(frame=first, count=stop - first), members)

    def end(self) -> Packet:
        """Return the END packet."""
        return EndHeader(frames=len(self._scene.timestamps), digest=self.digest).packet()

    def _object(self, number: int, first: int, stop: int, last: bool) -> Iterator[Packet]:
        item = self._scene.objects[number]
        if number not in self._sent:
            if item.born is None or item.born >= stop:
                return
            self._sent[number] = _Sent(item, self._config)
            yield ObjectHeader(object_id=number, voxel_size_m=item.evidence.voxel_size_m).packet()
        sent = self._sent[number]
        update = self._update(sent, None if last else stop)
        if update.size >= (MIN_LIVE_CELLS if self._config.causal and not last else 1):
            payload, decoded = encode_update_with_result(update, *sent.model.cells(), self._color)
            sent.model.apply(decoded)
            sent.wanted.apply(update)
            yield ModelHeader(object_id=number, frame=first).packet(payload)
        yield from self._poses(sent, first, stop)

    def _update(self, sent: _Sent, until_frame: int | None) -> ModelUpdate:
        if self._config.causal:
            return changes(sent.item.evidence, sent.wanted, self._config.threads)
        if sent.final is None:
            sent.final = in_regions(read_surface(sent.item.evidence, self._config.threads))
        return first_sights(sent.final, sent.model, until_frame)

    def _poses(self, sent: _Sent, first: int, stop: int) -> Iterator[Packet]:
        """Yield a packet for every run of frames in which the object moves."""
        script = self._script(sent.item, first, stop)
        for start, end in _runs(self._moving(sent, script)):
            if sent.next_coded != first + start:
                sent.coder.hold()
            payload = sent.coder.encode(script[start:end])
            sent.given, sent.next_coded = script[end - 1], first + end
            yield PoseHeader(object_id=sent.item.number, frame=first + start, count=end - start).packet(payload)

    def _script(self, item: SceneObject, first: int, stop: int) -> list[Pose]:
        """Return the poses that the stream carries: the background's before the camera, others' in the background."""
        poses = item.poses[first:stop]
        if not item.number:
            return poses
        world = self._scene.objects[0].poses[first:stop]
        return [compose(inverse(T_camera_world), pose) for T_camera_world, pose in zip(world, poses, strict=True)]

    def _moving(self, sent: _Sent, script: Sequence[Pose]) -> list[bool]:
        """Tell in which frames an object's pose differs from the one last sent by a quantisation step."""
        steps = self._config.pose
        moving: list[bool] = []
        last = sent.given
        for pose in script:
            if last is None:
                still = sent.coder.repeats(pose)
            else:
                shift, turn = pose[:3, 3] - last[:3, 3], pose[:3, :3] - last[:3, :3]
                still = (
                    2 * np.abs(shift).max() < steps.translation_step_m and np.abs(turn).max() < steps.rotation_step_rad
                )
            moving.append(not still)
            last = last if still else pose
        return moving

    def _clock_packets(self, first: int, stop: int) -> Iterator[Packet]:
        start = self._scene.timestamps[0]
        nominal = [start + nearest_multiple(frame, *self._clock) for frame in range(first, stop)]
        off = [stamp - due for stamp, due in zip(self._scene.timestamps[first:stop], nominal, strict=True)]
        if any(off):
            yield ClockHeader(frame=first, count=stop - first).packet(b"".join(map(pack_signed_varint, off)))


def _runs(moving: Sequence[bool]) -> list[tuple[int, int]]:
    """Return the ranges of moving frames; rests of up to two frames do not divide them."""
    runs: list[tuple[int, int]] = []
    for frame, moves in enumerate(moving):
        if not moves:
            continue
        if runs and frame - runs[-1][1] <= MAX_STILL_GAP:
            runs[-1] = (runs[-1][0], frame + 1)
        else:
            runs.append((frame, frame + 1))
    return runs


def _camera_record(camera: Camera) -> tuple[float, ...]:
    return (camera.width, camera.height, *camera.parameters().tolist())


def _clock(info: SequenceInfo) -> tuple[int, int]:
    """Return the frame period in nanoseconds as a fraction."""
    period = NANOSECONDS / Fraction(info.fps).limit_denominator(100_000)
    return period.numerator, period.denominator
