# SPDX-License-Identifier: MIT
"""Smooth motion scripts: sums of harmonics of one period, with pauses.

Every script is a function of the frame's time alone, so a shorter sequence is the start of a longer
one, and a script repeats after its period.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.pose import Pose, make_pose

__all__ = ["harmonics", "look_at", "phases", "phases_with_pause"]

PAUSE_EASE_FRAMES = 8
"""In which motion stops and starts again, about a quarter of a second: as a hand does it, not at once."""


def phases(frames: int, period: int) -> NDArray[np.float64]:
    """Return the (frames,) phase of every frame, one per period, exactly equal one period later."""
    return np.arange(frames) % period / period


def phases_with_pause(frames: int, period: int, pause: range) -> NDArray[np.float64]:
    """Return phases that slow down to a stop, stay exactly the same during `pause`, and speed up again.

    Parameters
    ----------
    frames
        Length of the sequence.
    period
        Frames after which the script repeats.
    pause
        Frames within the first period that all get one phase.
    """
    cycle = np.arange(period)
    away = np.maximum(pause.start - cycle, cycle - (pause.stop - 1)).clip(0, PAUSE_EASE_FRAMES) / PAUSE_EASE_FRAMES
    speed = away * away * (3 - 2 * away)
    # The faster of both frames, so that only a step within the pause is zero.
    steps = np.maximum(speed, np.roll(speed, -1))
    reached = np.concatenate([[0.0], np.cumsum(steps)])
    return np.asarray((reached[:-1] / reached[-1])[np.arange(frames) % period], dtype=np.float64)


def harmonics(
    phase: NDArray[np.float64], amplitudes: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Sum sines of the period's multiples with seeded offsets.

    Parameters
    ----------
    phase
        (frames,) phases in periods.
    amplitudes
        (harmonics, axes) amplitude of the first, second, ... multiple along each axis.
    rng
        Draws where each sine starts.

    Returns
    -------
    (frames, axes) values; no axis exceeds the sum of its amplitudes.
    """
    starts = rng.random(amplitudes.shape)
    multiples = np.arange(1, len(amplitudes) + 1)
    angles = 2 * np.pi * (phase[:, None, None] * multiples[:, None] + starts)
    return np.asarray((amplitudes * np.sin(angles)).sum(axis=1), dtype=np.float64)


def look_at(eye: NDArray[np.float64], target: NDArray[np.float64], roll: float = 0.0) -> Pose:
    """Return T_world_camera of a camera at `eye` that looks at `target`, in a world with z up.

    Parameters
    ----------
    eye, target
        (3,) points in meters; the line between them must not be upright.
    roll
        Angle in radians by which the camera turns about its axis.
    """
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(roll), np.sin(roll)
    rotation = np.stack([cosine * right + sine * down, cosine * down - sine * right, forward], axis=1)
    return make_pose(rotation, eye)
