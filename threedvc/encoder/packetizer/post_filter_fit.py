# SPDX-License-Identifier: MIT
"""The filter of drawn pictures that mends most of a stream's colour error, by least squares."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.filters import MAX_FACTOR
from threedvc.coding.gains import apply_gain
from threedvc.decoder.frame_state import FrameState
from threedvc.decoder.replay import played
from threedvc.encoder.rate.rate_control import SHARE_PER_BYTE
from threedvc.frames.sequence import FrameSequence, spread_step
from threedvc.kernels.render.picture_filter import add_filter_equations
from threedvc.model.post_filter import KINDS, PAIRS, PictureFilter, planes_of
from threedvc.parallel import for_ranges
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer
from threedvc.stream.headers import StreamHeader
from threedvc.stream.packets import Packet

__all__ = ["FILTER_BYTES", "fitted_filter"]

FILTER_BYTES = 60
"""About what a filter takes in a file."""
KIND_BYTES = {False: 9.0, True: 5.0}
"""About what the factors of one kind of pixels take, by whether the stream is grey."""
FILTER_FRAMES = 40
DAMPING = 1e-4
FACTORS = 2 * PAIRS
UNIT = 1 / 64


def fitted_filter(packets: Sequence[Packet], frames: FrameSequence, threads: int) -> PictureFilter | None:
    """Fit a filter to what a decoder draws of packets.

    Parameters
    ----------
    packets
        All packets of a stream without a filter.
    frames
        The frames that it shows.
    threads
        Number of threads.

    Returns
    -------
    PictureFilter or None
        With filters for the kinds of pixels where they save more than they take; None: for none.
    """
    equations = _Equations(threads)
    every = spread_step(len(frames), FILTER_FRAMES, frames.info)

    def wanted(state: FrameState) -> bool:
        return state.index % every == 0 and bool(state.T_camera_object)

    for state, renderer, models in played(packets, threads, wanted):
        equations.add(renderer, models, state, frames[state.index].color)
    total = sum(len(packet.payload) for packet in packets)
    return equations.solved(SHARE_PER_BYTE / total, StreamHeader.from_map(packets[0].header).grey)


class _Equations:
    """Normal equations of the factors for each kind of pixels, every frame scaled to a squared error of one."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._matrix, self._side = np.zeros((KINDS, FACTORS, FACTORS)), np.zeros((KINDS, FACTORS))
        self._frames = 0

    def add(
        self, renderer: Renderer, models: dict[int, RenderModel], state: FrameState, wanted: NDArray[np.uint8]
    ) -> None:
        """Add the equations of a frame."""
        picture = renderer.draw(
            models, state.T_camera_object, gain=apply_gain(state.gain), T_shifted_camera=state.T_shifted_camera,
            backdrop=state.backdrop, lights=state.lights, filters=PictureFilter.none(),
        )  # fmt: skip
        assert picture.kinds is not None
        planes, kinds, height = planes_of(picture.color), picture.kinds, len(wanted)
        starts = range(0, height, -(-height // self._threads))
        matrices = np.zeros((len(starts), KINDS, FACTORS, FACTORS))
        sides, squares = np.zeros((len(starts), KINDS, FACTORS)), np.zeros((len(starts), KINDS))

        def part_range(first: int, last: int) -> None:
            for part in range(first, last):
                rows = starts[part], min(starts[part] + starts.step, height)
                add_filter_equations(*rows, planes, kinds, wanted, matrices[part], sides[part], squares[part])

        for_ranges(part_range, len(starts), self._threads)
        scale = 1 / max(float(squares.sum()), 1.0)
        self._matrix += scale * matrices.sum(axis=0)
        self._side += scale * sides.sum(axis=0)
        self._frames += 1

    def solved(self, share_per_byte: float, grey: bool) -> PictureFilter | None:
        """Return the filters that save more of the squared error than their bytes are worth, or None."""
        factors = np.zeros((KINDS, FACTORS), dtype=np.int32)
        for kind in range(KINDS):
            found = self._factors(kind, PAIRS if grey else FACTORS)
            saved = found @ (2 * self._side[kind] - self._symmetric(kind) @ found)
            if saved > KIND_BYTES[grey] * share_per_byte * self._frames:
                factors[kind] = np.rint(found / UNIT)
        luma, chroma = factors[:, :PAIRS], factors[:, PAIRS:]
        if not factors.any():
            return None
        return PictureFilter(luma=np.ascontiguousarray(luma), chroma=np.ascontiguousarray(chroma))

    def _symmetric(self, kind: int) -> NDArray[np.float64]:
        upper = self._matrix[kind]
        return np.asarray(upper + np.triu(upper, 1).T)

    def _factors(self, kind: int, count: int) -> NDArray[np.float64]:
        """Return the best factors (12,) that are multiples of a unit, rounded one by one while the rest follow."""
        matrix, side = self._symmetric(kind)[:count, :count], self._side[kind, :count]
        matrix = matrix + np.diag(DAMPING * np.diag(matrix) + np.finfo(float).tiny)
        factors, free = np.zeros(FACTORS), np.arange(count)
        while len(free):
            known = side[free] - matrix[free] @ factors[:count]
            best = np.linalg.solve(matrix[np.ix_(free, free)], known)
            factors[free[0]] = np.clip(np.rint(best[0] / UNIT), -MAX_FACTOR, MAX_FACTOR) * UNIT
            free = free[1:]
        return factors
