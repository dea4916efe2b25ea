# SPDX-License-Identifier: MIT
"""What bytes are worth to a color video, measured on videos of about the size that it will have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from threedvc.coding.video.av1 import decode_av1
from threedvc.coding.video.planes import VideoFormat, picture_of
from threedvc.config.stages import MAX_COARSENESS, MIN_CRF, VideoConfig
from threedvc.encoder.packetizer.captured.color_video import HALVING, ColorVideoWriter, video_bytes
from threedvc.encoder.rate.objective import MIN_SLOPE, ColorCost
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence, sampling_stride
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import Packet

__all__ = ["color_cost"]

SAMPLED_FRAMES = 40
"""Frames whose error is measured, spread over the sequence: as many as of a finished stream."""
LIKELY_SHARE = 0.75
"""Share of a budget that a video may have when the rest is shared out; the trials about it tell what more or less is
worth. Geometry and poses of hand-held recordings take a tenth to a half."""


def color_cost(
    writer: ColorVideoWriter, scene: Scene, frames: FrameSequence, video: VideoConfig, budget_bytes: float | None
) -> ColorCost:
    """Return what bytes cost that a color video does not get.

    Parameters
    ----------
    writer
        Of the video; what it codes is kept there.
    scene, frames
        Those of the writer.
    video
        Choices for it.
    budget_bytes
        What the stream may take, or None: the video has the coarseness of its choices.
    """
    if video.lossless:
        return ColorCost.of_slope(float(video_bytes(writer.packets(MIN_CRF))), MIN_SLOPE, fixed=False)
    if budget_bytes is None:
        asked = video.coarseness
    else:
        writer.packets_within(LIKELY_SHARE * budget_bytes)
        aim = np.log(LIKELY_SHARE * budget_bytes)
        asked = min(writer.coded, key=lambda each: abs(np.log(video_bytes(writer.coded[each])) - aim))
    tried = (asked, _coarser(asked))
    sizes = [float(video_bytes(writer.packets(each))) for each in tried]
    errors = [_error(writer.packets(each), scene, frames) for each in tried]
    if budget_bytes is None:
        return ColorCost(sizes, errors)
    order = sorted(range(len(tried)), key=sizes.__getitem__)
    coarsest = video_bytes(writer.coded[MAX_COARSENESS]) if MAX_COARSENESS in writer.coded else 0
    return ColorCost([sizes[k] for k in order], [errors[k] for k in order], budget_bytes, coarsest)


def _coarser(coarseness: float) -> float:
    """Return the coarseness of a video of half the bytes; next to the coarsest, of twice as many."""
    return coarseness + HALVING if coarseness + HALVING <= MAX_COARSENESS else max(coarseness - HALVING, MIN_CRF)


def _error(packets: Sequence[Packet], scene: Scene, frames: FrameSequence) -> float:
    """Return the mean logarithm of the squared error plus one of what packets show."""
    every = sampling_stride(len(frames), SAMPLED_FRAMES, frames.info)
    return float(np.mean([error for packet in packets for error in _frame_errors(packet, scene, frames, every)]))


def _frame_errors(packet: Packet, scene: Scene, frames: FrameSequence, every: int) -> Iterator[float]:
    header = ColorVideoHeader.from_map(packet.header)
    camera = scene.info.rigs[header.sensor].color
    own = [number for number in range(len(frames)) if scene.records[number].sensor == header.sensor]
    first = own.index(header.frame)
    video = VideoFormat(
        width=header.columns, height=header.rows, bits=header.bits, magnified=header.magnified, gray=scene.info.gray
    )
    pictures = decode_av1(packet.payload, header.count, video)
    for number, planes in zip(own[first : first + header.count], pictures, strict=True):
        if number % every == 0:
            shown = picture_of(planes, video, camera.width, camera.height, scene.config.threads)
            squares = np.square(shown.astype(np.float32) - frames[number].color)
            yield float(np.log(squares.mean() + 1))
