# SPDX-License-Identifier: MIT
"""Pictures that stand for a background at rest before the only camera, at rest as well: of colors, and of depth."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats
from threedvc.coding.gains import apply_gain
from threedvc.config import ColorConfig
from threedvc.encoder.appearance.background.background_depth import (
    CodedDepthMap,
    averaged_inverse_depth,
    cheapest_depth_map,
)
from threedvc.encoder.appearance.background.background_image import BackgroundImageCandidates, averaged_background
from threedvc.encoder.appearance.fit_state import FitState
from threedvc.encoder.appearance.rate_distortion import weighed_misfit
from threedvc.encoder.rate.trial_coding import coded_size, color_settings
from threedvc.encoder.reconstruction.depth_consistency import sampled_frames
from threedvc.errors import FormatError
from threedvc.metrics.depth_errors import geman_mcclure_error
from threedvc.render.render_model import RenderModel

__all__ = ["background_depth_map", "background_image"]

MAX_FRAMES = 80
"""That are averaged: more would take memory and hardly lessen the noise."""
GEOMETRY_SHARE = 0.1
"""What the cells of a background at rest take of a usual stream, once a picture colors them."""
MISFIT_TOLERANCE = 1.005
"""How much more than the cells' the misfit may be that counts as no worse."""
WRONG = 0.01
"""Share of the depth beyond which a measurement is missed: the 1 % by which depth is judged."""
WRONG_TOLERANCE = 0.0003
"""How many more of all measurements than by the cells may be missed."""
NOWHERE_M = np.float32(1e6)
"""Depth of what is not drawn: quite wrong, whatever was measured."""


def background_image(state: FitState, gains: NDArray[np.int64]) -> BackgroundImageCandidates | None:
    """Return the picture of the background, frames freed of gains (frames, 3, 2); None where it has to be cells."""
    scene = state.scene
    if not _at_rest(state):
        return None
    seen = (
        (state.measured(frame), state.poses_in(frame), *apply_gain(gains[frame])) for frame in _averaged_frames(state)
    )
    return BackgroundImageCandidates(averaged_background(scene.info.rig, seen, state.colors, state.threads), state.gray)


def background_depth_map(state: FitState) -> CodedDepthMap | None:
    """Return the depth picture of the background; None where it has to be cells, or these are as good.

    It must take fewer bytes than the background's cells and meet the measurements no worse. Bytes are weighed
    as the share that they have of a usual stream.
    """
    scene = state.scene
    if not _at_rest(state) or not len(state.surfaces[0].cells):
        return None
    measured = (state.measured(frame) for frame in _averaged_frames(state))
    seen = ((frame.depth, scene.labels(frame) > 0) for frame in measured)
    trial = _DepthMapTrial(state)
    return cheapest_depth_map(averaged_inverse_depth(seen), scene.info.rig.depth, trial.cost, scene.config.voxel_size_m)


def _at_rest(state: FitState) -> bool:
    """Tell whether the background and the camera, the only one, are at rest."""
    return not state.scene.info.sensors and state.scene.objects[0].at_rest


def _averaged_frames(state: FitState) -> range:
    count = len(state.frames)
    return range(0, count, -(-count // MAX_FRAMES))


class _DepthMapTrial:
    """What frames measure of the background, and its cells, which a depth picture has to be better than."""

    def __init__(self, state: FitState) -> None:
        self._threads, self._pose = state.threads, state.scene.objects[0].poses[0]
        self._camera, self._caster = state.scene.info.rig.depth, state.depth_caster(0)
        self._cell_bytes, self._depth_weight = _cell_bytes(state), state.scene.config.depth_weight
        self._measured = [self._background_depth(state, frame) for frame in sampled_frames(state.frames)]
        self._misfit, self._wrong = self._misfit_and_wrong(state.colors.models[0])

    def cost(self, depth_map: CodedDepthMap) -> float:
        """Return its misfit and bytes, weighed against each other; infinity where the cells are better."""
        size = len(depth_map.payload)
        if size >= self._cell_bytes:
            return inf
        try:
            model = RenderModel(depth_map.model(self._camera, self._pose))
        except FormatError:
            return inf
        model.refresh(self._threads)
        misfit, wrong = self._misfit_and_wrong(model)
        if misfit > MISFIT_TOLERANCE * self._misfit or wrong > self._wrong + WRONG_TOLERANCE:
            return inf
        return GEOMETRY_SHARE * size / self._cell_bytes + weighed_misfit(misfit, self._depth_weight)

    def _background_depth(self, state: FitState, frame: int) -> Floats:
        """Return what a frame measures (n,) where no object is drawn, 0 elsewhere."""
        _, labels = self._caster.cast(state.colors.models, state.poses_in(frame))
        return np.where(labels == 0, self._caster.measured(state.measured(frame)), np.float32(0))

    def _misfit_and_wrong(self, model: RenderModel) -> tuple[float, float]:
        """Return the `geman_mcclure_error` of a background, and the share of measurements that are `WRONG`."""
        depth, _ = self._caster.cast({0: model}, {0: self._pose})
        drawn = np.where(depth > 0, depth, NOWHERE_M)
        wrong = sum(np.count_nonzero((np.abs(drawn - each) > WRONG * each) & (each > 0)) for each in self._measured)
        count = sum(map(np.count_nonzero, self._measured))
        return geman_mcclure_error((drawn, each) for each in self._measured), wrong / max(count, 1)


def _cell_bytes(state: FitState) -> int:
    """Return how many bytes the cells of the background take without colors."""
    surface, model = state.surfaces[0], state.colors.models[0].model
    flat = replace(surface, colors=np.zeros_like(surface.colors))
    return coded_size(flat, model.voxel_size_m, model.relief_bits, color_settings(ColorConfig(), state.gray))[0]
