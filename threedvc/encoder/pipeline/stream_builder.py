# SPDX-License-Identifier: MIT
"""The packets of a stream, out of a reconstruction and what was fitted to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import floor

from threedvc.config import EncoderConfig
from threedvc.encoder.appearance.appearance_fit import FittedAppearance
from threedvc.encoder.packetizer.background_choice import choose_background
from threedvc.encoder.packetizer.captured.live_color_video import LiveColorVideo
from threedvc.encoder.packetizer.packetizer import Packetizer
from threedvc.encoder.pipeline.fusion_pass import Reconstruction
from threedvc.errors import SequenceError
from threedvc.frames.frame import SequenceInfo
from threedvc.limits import MAX_PAYLOAD_BYTES
from threedvc.model.post_filter import PostFilter
from threedvc.stream.packets import Packet

__all__ = ["StreamBuilder", "StreamChoices", "batch_length", "batches", "new_packetizer"]

FILE_BATCH_S = 2.0
"""Seconds of a batch of a file: longer ones pack better, and seeking stays quick."""
VIDEO_BATCH_S = 10
"""Seconds of a batch with a color video: a picture that is not predicted takes as much as twenty others. Against two
seconds, 10 % fewer bytes on the kitchen (decision 0030)."""
MAX_VIDEO_BATCH_PIXELS, MAX_FINE_BATCH_PIXELS = 1 << 27, 1 << 25
"""Pixels of such a batch: of 4 bits each, and of fine ones 16, they do not exceed a payload (`MAX_PAYLOAD_BYTES`)."""
FINE_COARSENESS = 30.0
"""Coarseness below which pictures may have more than 4 bits a pixel; at it a noisy camera has 2 with full chroma."""
EXACT_FRAMES = 1e-6
"""Part of a frame that rounding may take off a latency of whole frames."""
MAX_BATCH_BYTES = MAX_PAYLOAD_BYTES // 2
"""Of a batch at a rate; some take more than others."""
MAX_LOSSLESS_BATCH_PIXELS = 1 << 24
"""Pixels of a batch with a lossless video: of 32 bits each they do not exceed a payload, and noise takes 27."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StreamChoices:
    """What is chosen for a stream when its scene and appearance are done.

    Attributes
    ----------
    config
        Choices, with the steps of colors.
    background_step
        Step of the picture of a background at rest, if it is not that of the colors.
    post_filter
        Filter of the drawn pictures, if there is one.
    videos
        VIDEO packets of depth as captured.
    """

    config: EncoderConfig
    background_step: float | None = None
    post_filter: PostFilter | None = None
    videos: Sequence[Packet] = ()


def new_packetizer(
    state: Reconstruction,
    choices: StreamChoices,
    fitted: FittedAppearance | None = None,
    live_video: LiveColorVideo | None = None,
) -> Packetizer:
    """Return what writes the packets of the frames taken in.

    Raises
    ------
    SequenceError
        If there is no frame, or for a file no depth that was fused.
    """
    if not state.reports:
        raise SequenceError(f"{state.info.name} has no frames")
    if not state.config.causal and not state.has_depth:
        raise SequenceError(
            f"{state.info.name}: no frame has a depth measurement that could be used; all may lie beyond the reach "
            "of its sensor: give --sensor lidar, or --max-depth"
        )
    config = choices.config
    background = choose_background(state.scene, config, fitted, choices.background_step or config.color.luma_step)
    return Packetizer(state.scene, config, fitted, background, choices.post_filter, choices.videos, live_video)


def batch_length(info: SequenceInfo, config: EncoderConfig, *, video: bool = False) -> int:
    """Return the frames of a batch; `video` tells whether colors are a video, as those of a live stream may be."""
    if config.batch_frames is not None:
        return config.batch_frames
    if config.causal:
        wanted = floor(config.latency_s * info.fps + EXACT_FRAMES)
    elif video:
        wanted = round(VIDEO_BATCH_S * info.fps)
    else:
        return max(1, round(FILE_BATCH_S * info.fps))
    return max(1, min(wanted, _max_video_frames(info, config)))


def _max_video_frames(info: SequenceInfo, config: EncoderConfig) -> int:
    """Return how many frames of a video a payload surely holds."""
    pixels = max(rig.color.width * rig.color.height for rig in info.rigs)
    most: float = MAX_FINE_BATCH_PIXELS if config.video.coarseness < FINE_COARSENESS else MAX_VIDEO_BATCH_PIXELS
    if config.video.lossless:
        most = MAX_LOSSLESS_BATCH_PIXELS
    most = most // pixels
    if config.bitrate_bps is not None:
        most = min(MAX_VIDEO_BATCH_PIXELS // pixels, 8 * MAX_BATCH_BYTES * info.fps / config.bitrate_bps)
    return int(most)


def batches(
    packetizer: Packetizer, state: Reconstruction, first: int, batch_frames: int, *, last: bool
) -> Iterator[Packet]:
    """Yield the batches of the frames from `first` on; `last`: no others will follow."""
    stop = len(state.reports)
    for start in range(first, stop, batch_frames):
        end = min(start + batch_frames, stop)
        final = last and end == stop
        told = state.reports[start:end] if state.config.causal else state.reports if final else []
        batch = packetizer.batch(start, end, told, last=final)
        if batch is not None:
            yield batch


@dataclass(frozen=True, eq=False)
class StreamBuilder:
    """Builds whole streams of one reconstruction, for different choices.

    Attributes
    ----------
    state
        The reconstruction.
    fitted
        What was fitted to its pictures; None where frames cannot be read again.
    batch_frames
        Frames of a batch.
    residuals
        RESIDUAL packets, which every stream has.
    """

    state: Reconstruction
    fitted: FittedAppearance | None
    batch_frames: int
    residuals: Sequence[Packet] = ()

    def build(self, choices: StreamChoices) -> list[Packet]:
        """Return all packets; raises SequenceError as `new_packetizer` does."""
        choices = replace(choices, videos=[*choices.videos, *self.residuals])
        packetizer = new_packetizer(self.state, choices, self.fitted)
        body = batches(packetizer, self.state, 0, self.batch_frames, last=True)
        return [*packetizer.stream_headers(), *body, packetizer.end()]
