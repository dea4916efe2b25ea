# SPDX-License-Identifier: MIT
"""Packets of a scene: what the decoder lacks, batch by batch.

The packetizer keeps what the decoder has been sent, and asks one writer for each kind of packet. A model update is the
difference between what is to be seen and that state; a batch without difference has no packet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from threedvc.coding.filters import encode_filter
from threedvc.coding.video.still import STILL_BITS
from threedvc.config import EncoderConfig
from threedvc.encoder.appearance.appearance_fit import FittedAppearance
from threedvc.encoder.packetizer.background_choice import COLORED_CELLS, BackgroundChoice
from threedvc.encoder.packetizer.batch_budget import BatchBudget, packed_bytes
from threedvc.encoder.packetizer.captured.live_color_video import LIVE_VIDEO_SHARE, LiveColorVideo
from threedvc.encoder.packetizer.model_packets import ModelPackets
from threedvc.encoder.packetizer.pose_packets import pose_packets, shift_packets, stream_poses
from threedvc.encoder.packetizer.scene_source import BatchFrames, SceneSource
from threedvc.encoder.packetizer.sensor_packets import clock_packets, color_time_packets, gain_packets, order_packets
from threedvc.encoder.packetizer.sent_state import SentObject, SentState, pose_steps
from threedvc.encoder.packetizer.stream_head import stream_head
from threedvc.geometry.pose import Pose, identity
from threedvc.limits import MAX_COUNT
from threedvc.model.post_filter import PostFilter
from threedvc.stream.batch import pack_batch
from threedvc.stream.headers import BackgroundHeader, BatchHeader, EndHeader, FilterHeader
from threedvc.stream.notes.frame_report import FrameReport, report_packet
from threedvc.stream.packets import Packet

__all__ = ["Packetizer"]

MAX_IDLE_FRAMES = MAX_COUNT // 2
"""After so many frames without a batch an empty one tells that they are there: readers let `MAX_COUNT` pass at
most, and the frames of the next batch are among them."""
MAX_LIVE_IDLE_S = 60
"""A live stream lets nothing be heard for so long where nothing changes: its reader shall know that it lives."""


class _ObjectEntry(NamedTuple):
    """An object in a batch: what the decoder has of it, its poses included, and the packets before its model update."""

    sent: SentObject
    packets: list[Packet]


class Packetizer:
    """Turns a scene into packets.

    Parameters
    ----------
    scene
        The scene; a live encoder adds frames to it between batches.
    config
        Choices.
    fitted
        Colors and gains fitted to the pictures; None: the mean colors of the evidence, and no gains.
    background
        How the stream shows the background, see `threedvc.encoder.packetizer.background_choice`.
    filters
        Filter of the pictures, or None.
    videos
        VIDEO, COLOR_VIDEO and RESIDUAL packets, those of each sort and sensor in the order of their frames.
    live_video
        Codes the pictures of each batch when it is sent, in place of the models' colors; None: nothing does.
    """

    def __init__(
        self,
        scene: SceneSource,
        config: EncoderConfig,
        fitted: FittedAppearance | None = None,
        background: BackgroundChoice = COLORED_CELLS,
        filters: PostFilter | None = None,
        videos: Sequence[Packet] = (),
        live_video: LiveColorVideo | None = None,
    ) -> None:
        self._scene, self._fitted, self._live_video = scene, fitted, live_video
        self._background, self._filters, self._videos = background, filters, videos
        self._sent = SentState(scene, pose_steps(scene, config.pose))
        self._models = ModelPackets(scene, config, fitted, background, colored=live_video is None)
        self._budget = BatchBudget(config, scene.info.fps, self.stream_headers())
        self._max_idle = MAX_IDLE_FRAMES
        if config.causal:
            self._max_idle = min(round(MAX_LIVE_IDLE_S * scene.info.fps), MAX_IDLE_FRAMES)
        self._batched = 0
        self._untold: list[FrameReport] = []

    def stream_headers(self) -> list[Packet]:
        """Return the STREAM packet, SENSOR packets of further sensors, and how the recordings were read if told."""
        return stream_head(self._scene.info, self._sent)

    def batch(self, first: int, stop: int, reports: Sequence[FrameReport], *, last: bool) -> Packet | None:
        """Return the BATCH of frames ``first..stop``, or None if nothing changes in them and none is due.

        Parameters
        ----------
        first, stop
            Frames of the batch; the scene has taken in all of them.
        reports
            What to tell about them; empty: nothing. It waits for a batch in which something changes.
        last
            Whether no frame follows: the batch then holds every cell that is still due.
        """
        batch = BatchFrames.of(self._scene, first, stop)
        self._untold += reports
        entries = self._object_entries(batch)
        others = [*self._sensor_members(batch), *self._picture_members(batch)]
        told = [report_packet(self._untold[at : at + MAX_COUNT]) for at in range(0, len(self._untold), MAX_COUNT)]
        needed = [packet for entry in entries for packet in entry.packets]
        budget_bytes = self._budget.open_batch(batch.count, [*others, *told, *needed], last=last)
        for_models = budget_bytes if self._live_video is None else (1 - LIVE_VIDEO_SHARE) * budget_bytes
        members = [*self._object_members(entries, batch, for_models, last=last), *others]
        if self._live_video is not None:
            spent = packed_bytes(members) - packed_bytes([*others, *needed])
            members += self._live_video.packets(batch, budget_bytes - spent)
        if not members and not (last and told) and stop - self._batched <= self._max_idle:
            return None
        packet = pack_batch(BatchHeader(frame=first, count=batch.count), [*members, *told])
        self._batched, self._untold = stop, []
        self._budget.close_batch(packet)
        return packet

    def end(self) -> Packet:
        """Return the END packet."""
        return EndHeader(frames=len(self._scene.records), digest=self._sent.digest).packet()

    def _object_entries(self, batch: BatchFrames) -> list[_ObjectEntry]:
        """Return the entries of all objects that have appeared, by number: the background's poses come first."""
        entries = (self._object_entry(number, batch) for number in self._models.numbers())
        return [entry for entry in entries if entry is not None]

    def _object_entry(self, number: int, batch: BatchFrames) -> _ObjectEntry | None:
        """Return what a batch holds of an object besides its model update; None before it appears."""
        packets, new = [], number not in self._sent.objects
        if new:
            born = self._models.born(number)
            if born is None or born >= batch.stop:
                return None
            packets.append(self._models.introduction(self._sent.introduce(number, self._models.new_model(number))))
        sent = self._sent.objects[number]
        packets += self._models.lights(number, batch, new=new)
        packets += pose_packets(sent, self._sent.steps, self._poses(sent, batch), batch)
        return _ObjectEntry(sent, packets)

    def _poses(self, sent: SentObject, batch: BatchFrames) -> list[Pose]:
        """Return an object's poses in the moments of a batch; completed surfaces rest in the background."""
        if sent.model.guessed:
            return [identity()] * len(batch.moments)
        return stream_poses(self._scene, sent.number, batch.moments)

    def _object_members(
        self, entries: Sequence[_ObjectEntry], batch: BatchFrames, budget_bytes: float, *, last: bool
    ) -> Iterator[Packet]:
        """Yield the packets of objects, with the model updates that a budget allows: first come, first served."""
        for entry in entries:
            update = list(self._models.update(entry.sent, batch, budget_bytes, last=last))
            budget_bytes -= packed_bytes(update)
            # What a picture shows depends on where the camera stands, so poses come first.
            yield from entry.packets
            yield from update

    def _sensor_members(self, batch: BatchFrames) -> Iterator[Packet]:
        """Yield what changes of sensors: their order, clocks, shifts and gains."""
        fitted, scene = self._fitted, self._scene
        yield from order_packets(self._sent, scene, batch)
        yield from clock_packets(self._sent, scene, batch)
        yield from shift_packets(self._sent, scene, () if fitted is None else fitted.shifts, batch)
        if self._live_video is None:
            gains = np.stack([record.gain for record in scene.records]) if fitted is None else fitted.gains
            yield from gain_packets(self._sent, scene, gains, batch)

    def _picture_members(self, batch: BatchFrames) -> Iterator[Packet]:
        """Yield what belongs to pictures: the background's image and the filter with the first frame, videos, times."""
        if not batch.first and self._background.image is not None:
            image = self._background.image
            header = BackgroundHeader(frame=batch.first, bits=STILL_BITS, magnified=image.magnified)
            yield header.packet(image.payload)
        if not batch.first and self._filters is not None:
            payload = encode_filter(self._filters, self._scene.info.gray)
            yield FilterHeader(frame=batch.first).packet(payload, critical=False)
        yield from (video for video in self._videos if video.header["f"] in batch)
        yield from color_time_packets(self._scene, batch)
