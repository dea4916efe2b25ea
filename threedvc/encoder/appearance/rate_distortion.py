# SPDX-License-Identifier: MIT
"""How good pictures of a scene would be at a number of bytes, as far as a quick fit can tell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from threedvc.arrays import Floats
from threedvc.config import with_step
from threedvc.encoder.appearance.color_fit import fit_colors, log_color_error
from threedvc.encoder.appearance.fit_state import FitState
from threedvc.encoder.appearance.fitted_surfaces import fitted_surfaces
from threedvc.encoder.rate.rate_control import DEPTH_SHARE, error_at
from threedvc.encoder.rate.trial_coding import coded_size, color_settings
from threedvc.encoder.reconstruction.depth_consistency import sampled_frames
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import Pose
from threedvc.metrics.depth_errors import geman_mcclure_error, shown_depth_error

__all__ = ["depth_misfit", "least_color_error", "rate_distortion_at", "weighed_misfit"]

TRIAL_SAMPLES = 500_000
"""A quarter of those of the fit that counts: only one error is held against another."""
TRIAL_STEPS = (40.0, 24.0, 14.0, 8.0)
"""Steps of luma between which the error is interpolated, each about 0.6 of the one before."""
MIN_MISFIT = 1e-4
"""Added before the logarithm is taken, so that no misfit at all is not infinitely good."""


def rate_distortion_at(
    scene: Scene, frames: FrameSequence, shifts: Sequence[Pose] | None, budget_bytes: float
) -> float:
    """Return about how large the error of pictures would be if surfaces took a number of bytes.

    Returns
    -------
    float
        Logarithm of the squared error of colors, plus `DEPTH_SHARE` of that of the depth's `geman_mcclure_error`.
    """
    state = FitState(scene, frames, shifts, TRIAL_SAMPLES)
    fit_colors(state)
    sizes, errors = zip(*(_coded(state, step) for step in TRIAL_STEPS), strict=True)
    return error_at(budget_bytes, sizes, errors) + _weighed_depth_misfit(state)


def least_color_error(scene: Scene, frames: FrameSequence) -> float:
    """Return the logarithm of the squared error of a quick fit of colors that cost nothing."""
    state = FitState(scene, frames, None, TRIAL_SAMPLES)
    fit_colors(state)
    return log_color_error(state)


def _weighed_depth_misfit(state: FitState) -> float:
    return weighed_misfit(geman_mcclure_error(_drawn_and_measured(state)), state.scene.config.depth_weight)


def depth_misfit(scene: Scene, frames: FrameSequence) -> float:
    """Return the `shown_depth_error` of what is drawn of a scene's frames."""
    return shown_depth_error(_drawn_and_measured(FitState(scene, frames, None, TRIAL_SAMPLES)))


def weighed_misfit(misfit: float, depth_weight: float) -> float:
    """Return a depth's misfit as it counts beside the logarithm of the squared error of models' colors."""
    return depth_weight * DEPTH_SHARE * float(np.log(misfit + MIN_MISFIT))


def _coded(state: FitState, luma_step: float) -> tuple[int, float]:
    """Return how many bytes the surfaces take with colors of a luma step, and `log_color_error` with these."""
    settings = color_settings(with_step(luma_step), state.gray)
    fitted, total = state.colors.values.copy(), 0
    for number, surface in fitted_surfaces(state).items():
        model = state.colors.models[number].model
        size, decoded = coded_size(surface, model.voxel_size_m, model.relief_bits, settings)
        state.colors.recolor(number, *decoded.cells())
        total += size
    error = log_color_error(state)
    state.colors.values = fitted
    return total, error


def _drawn_and_measured(state: FitState) -> Iterator[tuple[Floats, Floats]]:
    """Yield the depth that is drawn and that is measured (n,), of frames spread over the sequence."""
    for frame in sampled_frames(state.frames):
        caster = state.depth_caster(frame)
        depth, _ = caster.cast(state.colors.models, state.poses_in(frame))
        yield depth, caster.measured(state.measured(frame))
