# SPDX-License-Identifier: MIT
"""Decoded states made ready to be drawn: models laid out for ray casting, and frames of a whole stream."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

from threedvc.config import RenderConfig
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState
from threedvc.model.decoded_model import DecodedModel
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer
from threedvc.stream.packets import Packet

__all__ = ["DrawableModels", "ReplayedFrame", "replay"]


class DrawableModels:
    """Decoded models laid out for ray casting, from when each is first drawn.

    Parameters
    ----------
    threads
        On how many to lay them out.
    """

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._models: dict[int, RenderModel] = {}

    def refreshed(self, decoded: Mapping[int, DecodedModel], numbers: Iterable[int]) -> dict[int, RenderModel]:
        """Bring the models of some objects up to date, and return all that were drawn so far, by number.

        Parameters
        ----------
        decoded
            Decoded models by number, as of the frame to be drawn.
        numbers
            The objects that are drawn.
        """
        for number in numbers:
            if number not in self._models:
                self._models[number] = RenderModel(decoded[number])
            self._models[number].refresh(self._threads)
        return self._models


class ReplayedFrame(NamedTuple):
    """A frame: where everything is in it, the renderer of its sensor, and the models so far, up to date."""

    state: FrameState
    renderer: Renderer
    models: dict[int, RenderModel]


def replay(
    packets: Iterable[Packet],
    threads: int,
    wanted: Callable[[FrameState], bool] = lambda state: True,
    *,
    as_captured: bool = False,
) -> Iterator[ReplayedFrame]:
    """Decode packets and yield the frames that are wanted, as a decoder will draw their models.

    Videos are left out unless depth and colour `as_captured` are wanted.
    """
    decoder = Decoder(captured_depth=as_captured, captured_color=as_captured, threads=threads)
    drawable = DrawableModels(threads)
    renderers: dict[int, Renderer] = {}
    for state in decoder.frames(packets):
        if not wanted(state):
            continue
        if state.sensor not in renderers:
            renderers[state.sensor] = Renderer(decoder.rigs[state.sensor], RenderConfig(threads=threads))
        models = drawable.refreshed(decoder.models, state.T_camera_object)
        yield ReplayedFrame(state, renderers[state.sensor], models)
