# SPDX-License-Identifier: MIT
"""Frames of a stream of one's own, ready to be drawn as a decoder will draw them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from threedvc.config import RenderConfig
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer
from threedvc.stream.packets import Packet

__all__ = ["Playable", "played"]


class Playable(NamedTuple):
    """A frame: where everything is in it, the renderer of its sensor, and the models so far, refreshed."""

    state: FrameState
    renderer: Renderer
    models: dict[int, RenderModel]


def played(packets: Sequence[Packet], threads: int, wanted: Callable[[FrameState], bool]) -> Iterator[Playable]:
    """Decode packets, without depth as filmed, and yield the frames that are wanted."""
    decoder, models = Decoder(filmed=False), dict[int, RenderModel]()
    renderers: dict[int, Renderer] = {}
    for state in decoder.frames(packets):
        if not wanted(state):
            continue
        if state.sensor not in renderers:
            renderers[state.sensor] = Renderer(decoder.rigs[state.sensor], RenderConfig(threads=threads))
        for number in state.T_camera_object:
            if number not in models:
                models[number] = RenderModel(decoder.models[number])
            models[number].refresh(threads)
        yield Playable(state, renderers[state.sensor], models)
