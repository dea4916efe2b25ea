# SPDX-License-Identifier: MIT
"""Whose colors a file carries: the models', or those of a video, whichever looks better for the bytes.

A model that is seen for long, from all sides or at rest, has its colors for a fraction of what a video takes; one of a
room before a camera in a hand never looks as sharp as its pictures. Nothing but a trial tells which it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from threedvc.coding.video.av1 import can_encode_av1
from threedvc.config import ColorVideo, DepthErrorKind
from threedvc.encoder.appearance.appearance_fit import FittedAppearance, fit_appearance, fit_geometry
from threedvc.encoder.appearance.rate_distortion import least_color_error
from threedvc.encoder.packetizer.captured.color_video_trials import ColorVideoTrials
from threedvc.encoder.packetizer.captured.depth_residual import residual_packets
from threedvc.encoder.pipeline.budget import bits_per_second, stream_budget
from threedvc.encoder.pipeline.cell_size_trials import may_be_coarse, with_coarse_cells
from threedvc.encoder.pipeline.color_video_stream import color_video_stream
from threedvc.encoder.pipeline.decoded_error import decoded_error
from threedvc.encoder.pipeline.fusion_pass import FusionPass, Reconstruction
from threedvc.encoder.pipeline.offline_passes import improve, improve_geometry
from threedvc.encoder.pipeline.rate_search import rated_stream
from threedvc.encoder.pipeline.stream_builder import StreamBuilder, StreamChoices, batch_length
from threedvc.encoder.rate.objective import objective
from threedvc.encoder.rate.rate_control import stream_bytes
from threedvc.stream.batch import unpack_batch
from threedvc.stream.packets import Packet, PacketType

__all__ = ["FileStream", "file_stream"]

HOPE = 0.6
"""By how much the logarithm of the squared error of models' colors may fall from a quick fit to the end, at most: 2.6
dB; aligned poses, a filter and narrower cells gave 0.5 to 2 (decision 0032)."""
MIN_GAIN = 0.05
"""What coarse cells must gain beside a color video: fine ones draw other viewpoints better."""
OVER_BUDGET = 1.05
"""Times the bytes of a rate that a stream may take: as far as `3dvc encode --bitrate` promises to come."""


@dataclass(frozen=True, eq=False)
class FileStream:
    """A whole stream, and the reconstruction that it was made of."""

    state: Reconstruction
    packets: list[Packet]


def file_stream(found: Reconstruction, fusion: FusionPass) -> FileStream:
    """Return the stream of a reconstruction whose objects and poses are found, with the better sort of colors."""
    mode = found.config.color_video
    if mode is ColorVideo.ON:
        return _with_video(found, fusion)[0]
    if mode is ColorVideo.OFF or not can_encode_av1():
        return _with_model_colors(found, fusion)
    filmed, fine = _with_video(found, fusion)
    budget = stream_budget(found)
    within = budget is None or stream_bytes(filmed.packets) <= OVER_BUDGET * budget
    error = decoded_error(filmed.packets, filmed.state.scene, fusion.frames)
    if within and least_color_error(fine.scene, fusion.frames) > error.color + HOPE:
        return filmed
    rate = found.config.bitrate_bps or bits_per_second(found, stream_bytes(filmed.packets))
    painted = _with_model_colors(replace(found, config=replace(found.config, bitrate_bps=rate)), fusion)
    if not within:
        return painted
    other = decoded_error(painted.packets, painted.state.scene, fusion.frames)
    good = budget is not None or other.psnr_db >= found.config.video.min_psnr_db
    return painted if good and other.total < error.total else filmed


def _with_video(found: Reconstruction, fusion: FusionPass) -> tuple[FileStream, Reconstruction]:
    """Let a video show the colors; return the reconstruction, too, with cells that are not widened in the end."""
    trials = ColorVideoTrials(found.scene, fusion.frames, batch_length(found.info, found.config, video=True))
    cost = trials.cost(stream_budget(found))

    def stream(state: Reconstruction) -> FileStream:
        fitted = fit_geometry(state.scene, fusion.frames)
        builder = _builder(state, fitted, fusion, video=True)
        return FileStream(state, color_video_stream(builder, fusion.frames, trials, cost))

    def error(made: FileStream) -> float:
        misfit = decoded_error(made.packets, made.state.scene, fusion.frames).misfit
        colors = sum(len(packet.payload) for packet in _members(made.packets, PacketType.COLOR_VIDEO))
        others = cost.at(stream_bytes(made.packets) - colors)
        return objective(others, misfit, found.config.depth_weight)

    fine = stream(improve_geometry(found, fusion, cost))
    if not may_be_coarse(found):
        return fine, fine.state
    coarse = stream(with_coarse_cells(fine.state, found.config.appearance.relief_bits, fusion))
    return coarse if error(coarse) < error(fine) - MIN_GAIN else fine, fine.state


def _members(packets: Sequence[Packet], kind: PacketType) -> list[Packet]:
    """Return the packets of a kind that lie in the BATCHes of a stream."""
    batches = (packet for packet in packets if packet.type == PacketType.BATCH)
    return [member for batch in batches for member in unpack_batch(batch) if member.type == kind]


def _with_model_colors(found: Reconstruction, fusion: FusionPass) -> FileStream:
    """Fit the models' colors to what the frames show of them."""
    state, shifts = improve(found, fusion)
    fitted = fit_appearance(state.scene, fusion.frames, shifts)
    builder = _builder(state, fitted, fusion, video=False)
    return FileStream(state, rated_stream(builder, fusion.frames))


def _builder(state: Reconstruction, fitted: FittedAppearance, fusion: FusionPass, *, video: bool) -> StreamBuilder:
    """Return what builds streams, with the measured depth that each has if it is wanted."""
    builder = StreamBuilder(state, fitted, batch_length(state.info, state.config, video=video))
    if state.config.depth_error.kind is DepthErrorKind.MODEL:
        return builder
    packets = builder.build(StreamChoices(config=state.config))
    return replace(builder, residuals=residual_packets(packets, state.scene, fusion.frames, builder.batch_frames))
