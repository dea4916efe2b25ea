# SPDX-License-Identifier: MIT
"""Decoded states made ready to be drawn: models laid out for ray casting, and frames of a whole stream."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.gains import apply_gain
from threedvc.config import RenderConfig
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.post_filter import PostFilter
from threedvc.render.picture import Picture
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

    def drawn(self, filters: PostFilter | None, *, color: bool = True) -> Picture:
        """Draw the models from where the frame was taken, with a filter; without color its rays are saved."""
        state = self.state
        return self.renderer.draw(
            self.models,
            state.T_camera_object,
            color=color,
            gain=apply_gain(state.gain),
            T_shifted_camera=state.T_shifted_camera,
            backdrop=state.backdrop,
            lights=state.lights,
            filters=filters,
        )

    def shown(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return color (h, w, 3) and depth (h, w) in meters as a viewer sees them: as captured, if they are there."""
        state, threads = self.state, self.renderer.config.threads
        picture = self.drawn(state.filters, color=state.captured_color is None)
        color, depth = picture.color, picture.depth
        if state.captured_color is not None:
            color = state.captured_color.shown(color.shape[1], color.shape[0], threads)
        if state.captured_depth is not None:
            depth = state.captured_depth.shown(depth, threads)
        return color, depth


def replay(
    packets: Iterable[Packet],
    threads: int,
    wanted: Callable[[FrameState], bool] = lambda state: True,
    *,
    as_captured: bool = False,
) -> Iterator[ReplayedFrame]:
    """Decode packets and yield the frames that are wanted, as a decoder will draw their models.

    Videos are left out unless depth and color `as_captured` are wanted.
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
