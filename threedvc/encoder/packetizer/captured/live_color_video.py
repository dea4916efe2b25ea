# SPDX-License-Identifier: MIT
"""The color video of a live stream: one run of pictures for each batch, in the bytes that its models leave."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import isinf

import numpy as np

from threedvc.coding.video.color_runs import decode_color, halving_error, video_format
from threedvc.coding.video.planes import picture_of
from threedvc.config.stages import MAX_COARSENESS, MIN_CRF
from threedvc.encoder.packetizer.batch_budget import packed_bytes
from threedvc.encoder.packetizer.captured.color_video import QUARTERS, ColorVideoWriter, FrameSource, VideoChoice
from threedvc.encoder.packetizer.captured.color_video_trials import DB_PER_COARSENESS, MAX_CHROMA_SHARE
from threedvc.encoder.packetizer.scene_source import BatchFrames
from threedvc.frames.frame import Frame
from threedvc.metrics.picture_quality import psnr
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import Packet

__all__ = ["LIVE_VIDEO_SHARE", "LiveColorVideo"]

LIVE_VIDEO_SHARE = 0.6
"""Share of the bytes of a batch that models leave to the video, however much there is to send of them; what they do not
take it gets, too. Measured on the kitchen at 48 kbit/s, see decision 0035."""
AIM = 0.95
"""Share of its bytes that a video aims at: sizes of the next pictures are guessed by those of the last."""
MAX_TRIALS, ENOUGH = 3, 0.85
"""Videos of a batch that are coded on the way to its bytes, as frames do not wait; more, where none has this share of
them: sizes leap where pictures get another scale. If none fits, the coarsest is coded."""
FIRST_COARSENESS, FIRST_BYTES_PER_PIXEL, COARSENESS_PER_OCTAVE = 72.0, 4.5e-4, 3.5
"""A coarseness, what it takes about, and by how much it falls for twice the bytes a pixel: kitchen300 and two_toys at
640x480, and room_orbit, 320x240, at 48 kbit/s. A fine first trial would take longer than all others."""
MIN_KNOWN = 2
"""Sizes by which that of another coarseness is guessed."""
COARSEST = VideoChoice(MAX_COARSENESS)
"""What is sent where hardly anything fits: a blurred picture tells more than a gray one."""


class LiveColorVideo:
    """Codes the pictures of a batch when it is sent.

    Parameters
    ----------
    scene
        The scene that takes in the frames; of it sensors and choices count.
    """

    def __init__(self, scene: FrameSource) -> None:
        self._scene = scene
        self._frames: dict[int, Frame] = {}
        self._choice = VideoChoice(scene.config.video.coarseness)
        self._sizes = _LikelySizes()

    def keep(self, frames: Iterable[Frame]) -> None:
        """Keep frames until their batch is sent."""
        self._frames |= {frame.index: frame for frame in frames}

    def fits(self, batch: BatchFrames, budget_bytes: float) -> bool:
        """Tell whether the coarsest video of a batch leaves models their share of a budget."""
        if isinf(budget_bytes):
            return True
        return packed_bytes(self._writer(batch).packets(COARSEST)) <= LIVE_VIDEO_SHARE * budget_bytes

    def packets(self, batch: BatchFrames, budget_bytes: float) -> list[Packet]:
        """Return the COLOR_VIDEO packets of a batch of at most so many bytes, none if that is not enough.

        The frames of the batch are forgotten.
        """
        writer = self._writer(batch)
        packets: list[Packet] = []
        if isinf(budget_bytes):
            packets = writer.packets(self._choice)
        elif budget_bytes > 0:
            packets = self._within(writer, budget_bytes)
        if packets:
            self._learn(packets[0], coarser=isinf(budget_bytes))
        for number in range(batch.first, batch.stop):
            self._frames.pop(number, None)
        return packets

    def _within(self, writer: ColorVideoWriter, budget_bytes: float) -> list[Packet]:
        aim = AIM * budget_bytes
        otherwise = self._choice.coarseness if self._sizes else _first_coarseness(aim / writer.pixels)
        first = self._choice._replace(coarseness=self._sizes.coarseness_of(aim, otherwise))
        self._choice = writer.choice_within(aim, first, MAX_TRIALS, ENOUGH)
        self._sizes.learn({choice.coarseness: size for choice, size in writer.sizes.items()})
        for choice in (self._choice, COARSEST):
            packets = writer.packets(choice)
            if packed_bytes(packets) <= budget_bytes:
                return packets
        return []

    def _learn(self, packet: Packet, *, coarser: bool) -> None:
        """Choose chroma for the next batch by the first picture of a video, and without a rate the coarseness."""
        header, config = ColorVideoHeader.from_map(packet.header), self._scene.config
        sensor, picture = self._scene.info.each_sensor[header.sensor], self._frames[header.frame].color
        height, width, _ = picture.shape
        video = video_format(header, gray=sensor.gray)
        planes = next(decode_color(packet.payload, header.count, video))
        shown = picture_of(planes, video, width, height, config.threads)
        full = False
        if not video.gray and (video.width, video.height) == (width, height):
            halved = halving_error(picture, config.threads)
            error = float(np.square(shown.astype(np.float32) - picture).mean())
            full = halved > MAX_CHROMA_SHARE * (error + halved * video.full_chroma)
        coarseness = self._choice.coarseness
        if coarser:
            spare = (psnr(picture, shown) - config.video.min_psnr_db) / DB_PER_COARSENESS
            aim = min(coarseness + spare, config.video.coarseness)
            coarseness = float(np.clip(np.floor(QUARTERS * aim) / QUARTERS, MIN_CRF, MAX_COARSENESS))
        self._choice = VideoChoice(coarseness, full)

    def _writer(self, batch: BatchFrames) -> ColorVideoWriter:
        return ColorVideoWriter(self._scene, dict(self._frames), [range(batch.first, batch.stop)])


def _first_coarseness(bytes_per_pixel: float) -> float:
    """Return a coarseness, in quarters, to begin with, of which pictures may take about so many bytes a pixel."""
    coarseness = FIRST_COARSENESS - COARSENESS_PER_OCTAVE * np.log2(bytes_per_pixel / FIRST_BYTES_PER_PIXEL)
    return float(np.clip(np.round(QUARTERS * coarseness) / QUARTERS, MIN_CRF, MAX_COARSENESS))


class _LikelySizes:
    """What batches take at a coarseness, as far as the last ones tell."""

    def __init__(self) -> None:
        self._sizes: dict[float, int] = {}

    def __len__(self) -> int:
        return len(self._sizes)

    def learn(self, sizes: Mapping[float, int]) -> None:
        """Take in sizes of a batch by coarseness; older ones stay that do not contradict them."""
        older = {
            coarseness: size
            for coarseness, size in self._sizes.items()
            if all((coarseness - other) * (size - taken) < 0 for other, taken in sizes.items())
        }
        self._sizes = dict(sorted((older | dict(sizes)).items()))

    def coarseness_of(self, size: float, otherwise: float) -> float:
        """Return the coarseness, in quarters, at which a batch probably has a size; `otherwise` if nothing tells."""
        if len(self._sizes) < MIN_KNOWN:
            return otherwise
        known = np.log([*self._sizes.values()])
        aim = float(np.interp(-np.log(size), -known, [*self._sizes]))
        return float(np.ceil(QUARTERS * aim) / QUARTERS)
