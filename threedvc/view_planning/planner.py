# SPDX-License-Identifier: MIT
"""Next best views: candidates that are worth most, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.geometry.pose import Pose, compose, inverse, rotation_angle
from threedvc.kernels.encoder.exploration import look_at_cells
from threedvc.parallel import for_ranges
from threedvc.view_planning.targets import Target

__all__ = ["Proposal", "propose"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal:
    """A view to record next.

    Attributes
    ----------
    number
        The object that it explores; 0 is the world.
    T_field_camera
        Pose of the camera in the frame of that object.
    T_world_camera
        The same in the world, if the object stays where it stood at last.
    gain_bits
        Entropy that the view is expected to take away beyond the ones before it.
    share
        Its part of what all candidates together could take away.
    move_m, turn_rad
        How far and by what angle the camera goes from where it was at last, as the object sees it.
    """

    number: int
    T_field_camera: Pose
    T_world_camera: Pose
    gain_bits: float
    share: float
    move_m: float
    turn_rad: float


def propose(targets: Sequence[Target], best: int, threads: int) -> tuple[list[Proposal], list[float]]:
    """Choose views one after the other, each for the most entropy that the ones before it leave.

    What is seen by chosen views does not count again for others, except as far as they see it better. So gains only
    fall, and a candidate has to be judged again only when its last gain is the largest of all.

    Returns
    -------
    proposals
        The best one first, at most `best`, none that gains nothing.
    in_sight
        Bits that all candidates together could take away, of each target.
    """
    gains = [CandidateGains(target, threads) for target in targets]
    proposals: list[Proposal] = []
    while len(proposals) < best:
        best_target = max(gains, key=lambda each: each.best_gain)
        if best_target.best_gain <= 0:
            break
        proposals.append(best_target.choose())
    return proposals, [each.in_sight_bits for each in gains]


class CandidateGains:
    """Entropy of a target, and what its candidates would take of it beyond what chosen ones do."""

    def __init__(self, target: Target, threads: int) -> None:
        self._target = target
        self._bits, self._opacity = target.field.entropy(), target.field.opacity()
        self._explained = np.zeros_like(self._bits)
        self._poses = np.stack([target.field.cells_from(view) for view in target.candidates])
        self._gains, seen = self._evaluate(slice(None), threads)
        self._current = np.ones(len(self._gains), dtype=bool)
        self.in_sight_bits = float(np.sum(self._bits * seen, dtype=np.float64))

    @property
    def best_gain(self) -> float:
        """Largest gain of a candidate in bits."""
        while not self._current[pick := int(np.argmax(self._gains))]:
            self._gains[pick] = self._evaluate(slice(pick, pick + 1), 1)[0][0]
            self._current[pick] = True
        return float(self._gains[pick])

    def choose(self) -> Proposal:
        """Return the best candidate and leave the others what it would not see."""
        target, gain, pick = self._target, self.best_gain, int(np.argmax(self._gains))
        _, visibility = self._evaluate(slice(pick, pick + 1), 1)
        np.maximum(self._explained, visibility, out=self._explained)
        self._current[:] = False
        view = target.candidates[pick]
        T_last_camera = compose(inverse(target.recorded[-1]), view)
        return Proposal(
            number=target.number,
            T_field_camera=view,
            T_world_camera=compose(target.T_world_field, view),
            gain_bits=gain,
            share=gain / self.in_sight_bits,
            move_m=float(np.linalg.norm(T_last_camera[:3, 3])),
            turn_rad=rotation_angle(T_last_camera),
        )

    def _evaluate(self, views: slice, threads: int) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return the gains (n,) of candidates in bits, and how well (nx, ny, nz) the best of them sees each cell."""
        poses, sampling, cell_m = self._poses[views], self._target.sampling, self._target.field.cell_m
        gains, noise = np.zeros(len(poses)), sampling.sensor.parameters()
        parts: list[NDArray[np.float32]] = []

        def view_range(start: int, stop: int) -> None:
            seen = np.zeros_like(self._bits)
            look_at_cells(
                start, stop, poses, sampling.slopes, cell_m, self._bits, self._explained, self._opacity, noise,
                sampling.reach_m, seen, gains,
            )  # fmt: skip
            parts.append(seen)

        for_ranges(view_range, len(poses), threads)
        return gains, np.maximum.reduce(parts)
