# SPDX-License-Identifier: MIT
"""Colors, light and gains, fitted in turn to samples of the frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.gains import NEUTRAL
from threedvc.encoder.appearance.color_solver import solve_colors, solve_gain, solve_light
from threedvc.encoder.appearance.fit_state import FitState
from threedvc.encoder.appearance.lighting import epoch_frames
from threedvc.encoder.appearance.pose_alignment import Alignment, take_samples
from threedvc.encoder.appearance.samples import joined

__all__ = ["FINAL_FITS", "fit_colors", "log_color_error", "steady_gains"]

COLOR_FITS = 3
"""Do for a start; colors and gains converge slowly, see `FINAL_FITS`."""
LIGHT_FITS = 8
"""Where light is fitted, too: for the first half of them it does not change."""
FINAL_FITS = 12
"""Measured on the kitchen: 20,968 bytes at 23.95 dB after 3, 20,759 at 24.07 after 9, 20,528 at 24.07 after 24."""
MIN_GAIN_SAVING = 0.01
"""Share of a frame's squared error that another gain than the last one's must save to be worth its bits."""


def fit_colors(state: FitState, *, fits: int | None = None, alignment: Alignment = Alignment.NONE) -> None:
    """Sample all frames, if wanted after aligning them, and fit colors, light and gains to the samples in turn.

    They are fitted `fits` times, or as often as does for a start.
    """
    take_samples(state, alignment)
    if fits is None:
        fits = LIGHT_FITS if state.turning else COLOR_FITS
    for fit in range(fits if state.samples else 0):
        solve_colors(state.colors, joined(state.colors, state.samples_and_gains()), state.threads)
        for number in state.turning:
            # Until colors are about right, a light that changes would make up for them.
            epoch = len(state.frames) if 2 * fit < fits else epoch_frames(len(state.frames))
            solve_light(state.colors, number, state.samples_and_gains(), epoch)
        if fit < fits - 1:
            for sample in state.samples:
                state.gains[sample.frame] = solve_gain(sample, sample.shown(state.colors), state.gray)


def log_color_error(state: FitState) -> float:
    """Return the logarithm of the squared error of the samples, on an average over the frames."""
    errors = [sample.squared_error(sample.shown(state.colors), gain) for sample, gain in state.samples_and_gains()]
    return float(np.mean(np.log(np.array(errors) + 1))) if errors else 0.0


def steady_gains(state: FitState) -> NDArray[np.int64]:
    """Return gains (frames, 3, 2); one that is hardly better than the sensor's one before is not worth its bits."""
    gains = np.repeat(NEUTRAL[None], len(state.frames), axis=0)
    kept = {sample.frame: sample for sample in state.samples}
    last_of: dict[int, NDArray[np.int64]] = {}
    for frame in range(len(state.frames)):
        sensor = state.sensor_of(frame)
        last = gains[frame] = last_of.get(sensor, NEUTRAL)
        if not state.poses_in(frame) or state.is_repeated(frame) or state.draws_lost_object(frame):
            continue
        sample = kept.get(frame) or state.sample(state.measured(frame))
        shown = sample.shown(state.colors)
        found = solve_gain(sample, shown, state.gray)
        if sample.squared_error(shown, found) < (1 - MIN_GAIN_SAVING) * sample.squared_error(shown, last):
            gains[frame] = last_of[sensor] = found
    return gains
