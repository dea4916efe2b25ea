# SPDX-License-Identifier: MIT
"""How far what a decoder shows of a stream is from the frames, in one number by which streams are compared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from threedvc.decoder.frame_state import FrameState
from threedvc.decoder.replay import replay
from threedvc.encoder.rate.objective import objective
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence, sampling_stride
from threedvc.metrics.depth_errors import shown_depth_error
from threedvc.metrics.picture_quality import psnr
from threedvc.stream.packets import Packet

__all__ = ["DecodedError", "decoded_error"]

SAMPLED_FRAMES = 40
"""Frames that are compared, spread over the sequence: as many as the fit of a filter draws."""


class DecodedError(NamedTuple):
    """The error of a stream.

    Attributes
    ----------
    color
        Mean over frames of the logarithm of the mean squared error plus one.
    misfit
        Of the depth.
    total
        The objective of both.
    psnr_db
        Mean over frames of the PSNR of colors.
    """

    color: float
    misfit: float
    total: float
    psnr_db: float


def decoded_error(packets: Sequence[Packet], scene: Scene, frames: FrameSequence) -> DecodedError:
    """Return the error of what a decoder shows of packets.

    Parameters
    ----------
    packets
        A whole stream.
    scene
        The scene that it was made of; its limit of depth and its threads count.
    frames
        The frames that it shows.
    """
    threads = scene.config.threads
    every = sampling_stride(len(frames), SAMPLED_FRAMES, frames.info)
    colors: list[float] = []
    decibels: list[float] = []
    depths = []

    def wanted(state: FrameState) -> bool:
        return state.index % every == 0

    for replayed in replay(packets, threads, wanted, as_captured=True):
        frame = scene.with_depth_limit(frames[replayed.state.index])
        color, depth = replayed.shown()
        squares = np.square(color.astype(np.float32) - frame.color)
        colors.append(float(np.log(squares.mean() + 1)))
        decibels.append(psnr(frame.color, color))
        depths.append((depth, frame.depth))
    color_error = float(np.mean(colors))
    misfit = shown_depth_error(depths)
    total = objective(color_error, misfit, scene.config.depth_weight)
    return DecodedError(color_error, misfit, total, float(np.mean(decibels)))
