# SPDX-License-Identifier: MIT
"""Which size of cells, and how fine a relief, a rate affords."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf

import numpy as np

from threedvc.config import DepthErrorKind, DepthVideo, EncoderConfig, with_step
from threedvc.encoder.appearance.rate_distortion import depth_misfit, rate_distortion_at
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.surface_extraction import Surface, extract_surface
from threedvc.encoder.pipeline.budget import stream_budget, surface_budget
from threedvc.encoder.pipeline.fusion_pass import FusionPass, Reconstruction
from threedvc.encoder.rate.objective import ColorCost, objective
from threedvc.encoder.rate.rate_control import MIDDLE_STEP, besides_surfaces, best_cells, cell_factor
from threedvc.encoder.rate.trial_coding import coded_size, color_settings
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import DownsampledSequence, FrameSequence, sampling_stride
from threedvc.geometry.pose import Pose

__all__ = [
    "may_be_coarse",
    "surface_bytes",
    "with_affordable_cells",
    "with_affordable_geometry",
    "with_best_cells",
    "with_best_geometry",
    "with_coarse_cells",
    "with_relief_chosen",
]

GEOMETRY_SHARE = 0.35
"""Share of the bytes of surfaces that those without colors take at most to begin with, if a video shows the colors:
cameras are calibrated and poses refined with such cells, before the best ones are sought."""
CHEAP = 0.1
"""Share of the bytes of surfaces that one bit of relief may add."""
TRIAL_FRAMES = 100
"""Frames that a size of cells is tried on: more hardly change which size draws best."""
GEOMETRY_TRIAL_FRAMES = 60
"""The same where depth alone is drawn: as many as its misfit is measured on."""
MIN_CELL_FACTOR, MIN_SHIFTED_CELL_FACTOR = 0.45, 0.65
"""Cells narrower than about two pixels are not tried, or three where color and depth have rays of their own: a decoder
would draw them slowly."""
MAX_WIDENINGS = 4
"""Cells without colors are tried so often wider by a quarter: 2.4 times as wide take a sixth of the bytes."""
COARSER = 3.0
"""By how much cells are widened where a depth video may show all that they did: they take a ninth of the bytes, and
still draw other viewpoints."""
MAX_CELL_FACTOR = 16
"""Cells wider or narrower than this many times the default tell nothing of a scene."""


def surface_bytes(scene: Scene, luma_step: float, relief_bits: int | None = None, *, colored: bool = True) -> int:
    """Return how many bytes the surfaces of a scene take, each sent at once with colors of a luma step.

    Without `relief_bits` they have as many as the scene's choices say, and unless `colored` no colors.
    """
    settings = color_settings(with_step(luma_step), scene.info.gray)
    bits = scene.config.appearance.relief_bits or 0 if relief_bits is None else relief_bits
    threads = scene.config.threads
    sizes = (
        coded_size(_surface(item.evidence, threads, colored), item.evidence.voxel_size_m, bits, settings)
        for item in scene.objects.values()
    )
    return sum(size for size, _ in sizes)


def _surface(evidence: EvidenceModel, threads: int, colored: bool) -> Surface:
    surface = extract_surface(evidence, threads, smooth=True)
    return surface if colored else replace(surface, colors=np.zeros_like(surface.colors))


def with_affordable_geometry(state: Reconstruction, fusion: FusionPass) -> Reconstruction:
    """Take wider cells if, without colors, they would take more of a bit rate than a video of these leaves."""
    budget = surface_budget(state)
    if budget is None:
        return state
    factor = cell_factor(surface_bytes(state.scene, MIDDLE_STEP, colored=False), GEOMETRY_SHARE * budget)
    return state if factor <= 1 else _with_cells(state, fusion, factor)


def with_affordable_cells(state: Reconstruction, fusion: FusionPass) -> Reconstruction:
    """Take wider or narrower cells if the bit rate asks for them."""
    budget = surface_budget(state)
    if budget is None:
        return state
    factor = cell_factor(surface_bytes(state.scene, MIDDLE_STEP), budget)
    return state if factor == 1 else _with_cells(state, fusion, factor)


def with_best_cells(state: Reconstruction, fusion: FusionPass, shifts: Sequence[Pose] | None) -> Reconstruction:
    """Take those cells that draw the best pictures at the bit rate, of some tried or between them."""
    budget = surface_budget(state)
    if budget is None:
        return state
    least = MIN_CELL_FACTOR if shifts is None else MIN_SHIFTED_CELL_FACTOR
    step = sampling_stride(len(fusion.frames), TRIAL_FRAMES, state.info)

    def error(scene: Scene, some: FrameSequence) -> float:
        return rate_distortion_at(scene, some, shifts and shifts[::step], budget)

    return _with_cells_of_least_error(state, fusion, error, step, least)


def with_best_geometry(state: Reconstruction, fusion: FusionPass, cost: ColorCost) -> Reconstruction:
    """Take those cells whose depth is worth their bytes most beside a video of colors, of some tried or between them.

    `cost` is what bytes cost that the video does not get. Those of objects before a background at rest stay as they
    are: such a background may be a depth picture, and then tells nothing of cells.
    """
    objects = state.scene.objects
    exact = state.config.depth_error.kind is not DepthErrorKind.MODEL
    if exact or state.config.voxel_size_m is not None or (objects[0].at_rest and set(objects) != {0}):
        return state
    step = sampling_stride(len(fusion.frames), GEOMETRY_TRIAL_FRAMES, state.info)
    others = besides_surfaces(len(state.reports))

    def error(scene: Scene, some: FrameSequence) -> float:
        spent = others + surface_bytes(scene, MIDDLE_STEP, colored=False)
        return objective(cost.at(spent), depth_misfit(scene, some), scene.config.depth_weight)

    return _with_cells_of_least_error(
        state, fusion, error, step, MIN_CELL_FACTOR, max_widenings=MAX_WIDENINGS, in_color=False
    )


def may_be_coarse(state: Reconstruction) -> bool:
    """Tell whether cells may be widened beside a color video.

    They may if a depth video may show what they do not, and there is a background alone, in cells that nobody has
    chosen.
    """
    config = state.config
    has_video = config.refine and config.depth_video is not DepthVideo.OFF
    modeled = config.depth_error.kind is DepthErrorKind.MODEL and config.voxel_size_m is None
    return has_video and modeled and set(state.scene.objects) == {0}


def with_coarse_cells(state: Reconstruction, relief_bits: int | None, fusion: FusionPass) -> Reconstruction:
    """Take cells for which little is spent: where a depth video shows all depth, they serve other viewpoints alone.

    `relief_bits` are those asked for, or None: they are chosen anew.
    """
    config = replace(state.config, appearance=replace(state.config.appearance, relief_bits=relief_bits))
    return with_relief_chosen(_with_cells(replace(state, config=config), fusion, COARSER))


def with_relief_chosen(state: Reconstruction) -> Reconstruction:
    """Settle whether the stream tells where in their cells surfaces pass."""
    appearance = state.config.appearance
    if appearance.relief_bits is not None:
        return state
    step = state.config.color.luma_step if stream_budget(state) is None else MIDDLE_STEP
    chosen = replace(appearance, relief_bits=_affordable_relief(state.scene, step))
    config = replace(state.config, appearance=chosen)
    return replace(state, config=config, scene=state.scene.with_config(config))


def _affordable_relief(scene: Scene, luma_step: float) -> int:
    """Return 1 if one bit of relief costs little beside the surfaces, else 0.

    On smooth surfaces it does, and there it is needed most: cells lie in wide steps, whose height the decoder cannot
    tell from their neighbors. Noise makes it dear, and stands in for it.
    """
    plain, fine = (surface_bytes(scene, luma_step, bits) for bits in (0, 1))
    return 1 if fine < (1 + CHEAP) * plain else 0


def _wider(config: EncoderConfig, factor: float) -> EncoderConfig:
    """Return the choices with cells wider by a factor."""
    wider = np.clip(config.cell_factor * factor, 1 / MAX_CELL_FACTOR, MAX_CELL_FACTOR)
    return replace(config, cell_factor=float(wider))


def _with_cells_of_least_error(
    state: Reconstruction,
    fusion: FusionPass,
    error: Callable[[Scene, FrameSequence], float],
    step: int,
    min_cell_factor: float,
    *,
    max_widenings: int = 1,
    in_color: bool = True,
) -> Reconstruction:
    """Take those cells with which every `step`-th frame has the least error, of some tried or between them."""
    some = DownsampledSequence(fusion.frames, step)
    poses = {number: found[::step] for number, found in state.poses.items()}

    def tried(factor: float) -> float:
        config = _wider(state.config, factor)
        if factor < 1 and config.cell_factor < min_cell_factor:
            return inf
        scene = Scene(state.info, config, poses, state.scene.sequence_labels, in_color=in_color)
        for frame in some:
            scene.add(frame)
        return error(scene, some)

    factor = best_cells(tried, max_widenings=max_widenings)
    return state if factor == 1 else _with_cells(state, fusion, factor)


def _with_cells(state: Reconstruction, fusion: FusionPass, factor: float) -> Reconstruction:
    """Fuse all frames again into cells wider by a factor."""
    return fusion.fuse_at(replace(state, config=_wider(state.config, factor)), state.poses)
