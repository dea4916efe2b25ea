# SPDX-License-Identifier: MIT
"""The choices whose stream has the bytes that are wanted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from threedvc.config import DepthErrorKind, DepthVideo, EncoderConfig, with_step
from threedvc.encoder.appearance.rate_distortion import weighed_misfit
from threedvc.encoder.packetizer.captured.depth_video import choose_depth_video
from threedvc.encoder.packetizer.post_filter_fit import FILTER_BYTES, fit_post_filter
from threedvc.encoder.pipeline.budget import stream_budget
from threedvc.encoder.pipeline.stream_builder import StreamBuilder, StreamChoices
from threedvc.encoder.rate.objective import ColorCost, objective
from threedvc.encoder.rate.rate_control import (
    CLOSE,
    MAX_STEP_RATIO,
    MIN_STEP,
    SHARE_PER_BYTE,
    bisect_step,
    stream_bytes,
)
from threedvc.frames.sequence import FrameSequence
from threedvc.stream.packets import Packet

__all__ = ["depth_videos", "rated_choices", "rated_stream"]


def rated_choices(builder: StreamBuilder, filter_bytes: int = 0, videos: Sequence[Packet] = ()) -> StreamChoices:
    """Return the choices that, with a filter of some bytes, give the bytes wanted if there are any."""
    state, fitted = builder.state, builder.fitted
    budget = stream_budget(state)
    if budget is None:
        return StreamChoices(config=state.config, videos=videos)
    target = budget - filter_bytes

    def config(step: float) -> EncoderConfig:
        return replace(state.config, color=with_step(step))

    def size(step: float, background_step: float | None = None) -> int:
        choices = StreamChoices(config=config(step), background_step=background_step, videos=videos)
        return stream_bytes(builder.build(choices))

    step, closest = bisect_step(size, target)
    finest = max(step / MAX_STEP_RATIO, MIN_STEP)
    if closest < CLOSE * target and fitted is not None and fitted.backdrop is not None and finest < step:
        # Pictures come in leaps; cells fill what a leap leaves.
        for_cells, larger = bisect_step(lambda each: size(each, step), target, (finest, step))
        if closest < larger <= target:
            return StreamChoices(config=config(for_cells), background_step=step, videos=videos)
    return StreamChoices(config=config(step), videos=videos)


def rated_stream(builder: StreamBuilder, frames: FrameSequence) -> list[Packet]:
    """Return all packets, with a video of depth where it is worth it, and a filter fitted to what they draw."""
    choices = rated_choices(builder, FILTER_BYTES)
    packets = builder.build(choices)
    budget = stream_budget(builder.state)
    videos = depth_videos(builder, packets, frames)
    if videos:
        with_videos = rated_choices(builder, FILTER_BYTES, videos)
        captured = builder.build(with_videos)
        if budget is None or stream_bytes(captured) <= budget:
            choices, packets = with_videos, captured
    plain_bytes = stream_bytes(packets)
    post_filter = fit_post_filter(packets, frames, builder.state.config.threads)
    if post_filter is not None:
        packets = builder.build(replace(choices, post_filter=post_filter))
    filter_bytes = stream_bytes(packets) - plain_bytes
    if budget is None or plain_bytes > budget - FILTER_BYTES:
        return packets
    if filter_bytes > FILTER_BYTES or FILTER_BYTES - filter_bytes > (1 - CLOSE) * budget:
        choices = rated_choices(builder, filter_bytes, choices.videos)
        packets = builder.build(replace(choices, post_filter=post_filter))
    return packets


def depth_videos(
    builder: StreamBuilder, packets: Sequence[Packet], frames: FrameSequence, cost: ColorCost | None = None
) -> list[Packet]:
    """Return VIDEO packets of depth that the models do not tell, if it is worth it.

    `cost` is what bytes cost beside a video of colors; None: `packets` are those of a stream with model colors.
    """
    state = builder.state
    mode = state.config.depth_video if state.config.depth_error.kind is DepthErrorKind.MODEL else DepthVideo.OFF
    if mode is DepthVideo.OFF or (mode is DepthVideo.AUTO and not state.config.refine):
        return []
    wanted = mode is DepthVideo.ON
    weight = state.config.depth_weight
    misfit_cost: Callable[[float], float] = partial(objective, 0.0, depth_weight=weight)
    if cost is None:
        misfit_cost = partial(weighed_misfit, depth_weight=weight)
        budget = stream_budget(state)
        size = float(stream_bytes(packets)) if budget is None else budget
        cost = ColorCost.of_slope(size, SHARE_PER_BYTE, fixed=budget is not None)
    return choose_depth_video(state.scene, frames, packets, cost, misfit_cost, builder.batch_frames, sure=wanted)
