# SPDX-License-Identifier: MIT
"""A stream whose colors are a video: models without colors, poses, and what is left of the bytes for pictures."""

from __future__ import annotations

from collections.abc import Sequence

from threedvc.encoder.packetizer.captured.color_video_trials import ColorVideoTrials
from threedvc.encoder.pipeline.budget import stream_budget
from threedvc.encoder.pipeline.rate_search import depth_videos
from threedvc.encoder.pipeline.stream_builder import StreamBuilder, StreamChoices
from threedvc.encoder.rate.objective import ColorCost
from threedvc.encoder.rate.rate_control import stream_bytes
from threedvc.frames.sequence import FrameSequence
from threedvc.stream.packets import Packet

__all__ = ["color_video_stream"]

MIN_VIDEO_SHARE = 0.1
"""Share of a stream of given rate that colors get at least, however much models and a depth video take; by hand."""


def color_video_stream(
    builder: StreamBuilder, frames: FrameSequence, trials: ColorVideoTrials, cost: ColorCost
) -> list[Packet]:
    """Return all packets, with a video of colors, and one of depth where it is worth what it costs."""
    state = builder.state
    budget = stream_budget(state)
    bare = _built(builder, ())

    def colors(others: Sequence[Packet]) -> list[Packet]:
        if budget is None:
            return trials.writer.packets(trials.of_quality())
        left = max(budget - stream_bytes(others), MIN_VIDEO_SHARE * budget)
        return trials.writer.packets(trials.within(left))

    video = colors(bare)
    packets = _built(builder, video)
    depth = depth_videos(builder, packets, frames, cost.beside(stream_bytes(bare)))
    if not depth:
        return packets
    if budget is not None:
        video = colors(_built(builder, depth))
    captured = _built(builder, [*video, *depth])
    return captured if budget is None or stream_bytes(captured) <= budget else packets


def _built(builder: StreamBuilder, videos: Sequence[Packet]) -> list[Packet]:
    return builder.build(StreamChoices(config=builder.state.config, videos=videos))
