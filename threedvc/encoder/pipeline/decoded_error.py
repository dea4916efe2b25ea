# SPDX-License-Identifier: MIT
"""How far what a decoder shows of a stream is from the frames, in one number by which streams are compared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from threedvc.coding.gains import apply_gain
from threedvc.decoder.frame_state import FrameState
from threedvc.decoder.replay import replay
from threedvc.encoder.appearance.rate_distortion import weighed_misfit
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence, sampling_stride
from threedvc.metrics.depth_errors import geman_mcclure_error
from threedvc.stream.packets import Packet

__all__ = ["DecodedError", "decoded_error"]

SAMPLED_FRAMES = 40
"""Frames that are compared, spread over the sequence: as many as the fit of a filter draws."""
NOWHERE_M = np.float32(1e6)
"""Depth that stands for what is missing, further than any measurement: it fits not at all."""


class DecodedError(NamedTuple):
    """The error of a stream.

    Attributes
    ----------
    color
        Mean over frames of the logarithm of the mean squared error plus one.
    depth
        The depth's misfit as it counts beside that.
    """

    color: float
    depth: float

    @property
    def total(self) -> float:
        """Both together: a tenth less of the one is worth two tenths less of the other."""
        return self.color + self.depth


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
    depths = []

    def wanted(state: FrameState) -> bool:
        return state.index % every == 0

    for state, renderer, models in replay(packets, threads, wanted, as_captured=True):
        frame = scene.with_depth_limit(frames[state.index])
        picture = renderer.draw(
            models, state.T_camera_object, color=state.captured_color is None, gain=apply_gain(state.gain),
            T_shifted_camera=state.T_shifted_camera, backdrop=state.backdrop, lights=state.lights,
            filters=state.filters,
        )  # fmt: skip
        color, depth = picture.color, picture.depth
        if state.captured_color is not None:
            color = state.captured_color.shown(color.shape[1], color.shape[0], threads)
        if state.captured_depth is not None:
            depth = state.captured_depth.shown(depth, threads)
        squares = np.square(color.astype(np.float32) - frame.color)
        colors.append(float(np.log(squares.mean() + 1)))
        depths.append((np.where(depth > 0, depth, NOWHERE_M), frame.depth))
    return DecodedError(float(np.mean(colors)), weighed_misfit(geman_mcclure_error(depths)))
