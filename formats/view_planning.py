# SPDX-License-Identifier: MIT
"""Where to record next, told by a stream: replay it, and report views that would tell most."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

from threedvc.config import ExplorationConfig
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState
from threedvc.errors import SequenceError, TruncatedStream
from threedvc.formats.container import open_input
from threedvc.formats.decoding import errors_named
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.view_planning.planner import Proposal, propose
from threedvc.view_planning.targets import Target, downsampled_frames, targets_of

__all__ = ["Exploration", "ExploredObject", "explore"]


@dataclass(frozen=True, kw_only=True)
class ExploredObject:
    """What is known of the space of one object.

    Attributes
    ----------
    id
        Number; 0 is the world, with all objects that rest in it.
    cells, cell_m
        Number of cells of its box, and edge of a cell in meters.
    free, occupied
        Parts of the cells that are known to be so; the rest is uncertain or was not seen.
    entropy_bits
        Entropy of all cells, among them those that cannot be seen, such as the inside of walls.
    in_sight_bits
        What all candidate views together are expected to take away.
    """

    id: int
    cells: int
    cell_m: float
    free: float
    occupied: float
    entropy_bits: float
    in_sight_bits: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Exploration:
    """The report of `explore`.

    Attributes
    ----------
    name
        Name of the encoded sequence.
    complete
        False when the stream ends too early; what is there was explored.
    frames
        Number of frames.
    candidates
        Number of views that the proposals were chosen from.
    objects
        What was explored.
    proposals
        Views to record next, the best one first.
    T_world_last_camera
        Where the camera was in the last frame.
    """

    name: str
    complete: bool
    frames: int
    candidates: int
    objects: Sequence[ExploredObject]
    proposals: Sequence[Proposal]
    T_world_last_camera: Pose

    def to_map(self) -> dict[str, Any]:
        """Return the report as plain values; a proposal for an object that moves also has its T_camera_object."""
        return {
            "name": self.name,
            "complete": self.complete,
            "frames": self.frames,
            "candidates": self.candidates,
            "objects": [vars(item) for item in self.objects],
            "T_world_last_camera": self.T_world_last_camera.tolist(),
            "proposals": [_proposal_map(rank, item) for rank, item in enumerate(self.proposals, 1)],
        }

    def to_json(self) -> str:
        """Return the report as JSON text."""
        return json.dumps(self.to_map(), indent=1)


def _proposal_map(rank: int, item: Proposal) -> dict[str, Any]:
    report = {
        "rank": rank,
        "object": item.number,
        "gain_bits": item.gain_bits,
        "share": item.share,
        "move_m": item.move_m,
        "turn_deg": float(np.degrees(item.turn_rad)),
        "T_world_camera": item.T_world_camera.tolist(),
    }
    if item.number:
        report["T_camera_object"] = inverse(item.T_field_camera).tolist()
    return report


def explore(
    source: str | os.PathLike[str] | BinaryIO,
    config: ExplorationConfig | None = None,
    *,
    on_frame: Callable[[int], None] | None = None,
) -> Exploration:
    """Propose views that would take away most of what a stream leaves uncertain.

    Parameters
    ----------
    source
        A .3dvc file, ``-`` for standard input, or a binary stream; it is read once.
    config
        Choices; None: defaults.
    on_frame
        Called with the number of each frame that was read.

    Raises
    ------
    FormatError
        If the stream cannot be read. One that merely ends too early is explored as far as it goes.
    SequenceError
        If no frame of it shows a surface.
    """
    config = config or ExplorationConfig()
    decoder = Decoder(captured_depth=False, captured_color=False)
    with open_input(source) as reader, errors_named(reader.name):
        states = downsampled_frames(_states(decoder, reader, on_frame))
        if decoder.header is None:
            raise TruncatedStream(f"{reader.name}: ends before its STREAM packet; nothing can be explored")
        name = reader.name
    try:
        targets = targets_of(decoder.models, decoder.rigs, states, config)
    except SequenceError as error:
        raise SequenceError(f"{name}: {error}") from None
    proposals, in_sight = propose(targets, config.best, config.threads)
    return Exploration(
        name=decoder.header.name,
        complete=decoder.complete,
        frames=decoder.frame_count,
        candidates=sum(len(target.candidates) for target in targets),
        objects=[_explored(target, bits) for target, bits in zip(targets, in_sight, strict=True)],
        proposals=proposals,
        T_world_last_camera=compose(states[-1].T_world_camera, decoder.rigs[states[-1].sensor].T_depth_rig),
    )


def _states(decoder: Decoder, reader: Any, on_frame: Callable[[int], None] | None) -> Iterator[FrameState]:
    """Yield the state of every frame that is there; that a stream is cut short is reported otherwise."""
    try:
        for state in decoder.frames(reader):
            if on_frame is not None:
                on_frame(state.index)
            yield state
    except TruncatedStream:
        pass


def _explored(target: Target, in_sight_bits: float) -> ExploredObject:
    field = target.field
    return ExploredObject(
        id=target.number,
        cells=field.log_odds.size,
        cell_m=field.cell_m,
        free=float(field.free.mean()),
        occupied=float(field.occupied.mean()),
        entropy_bits=field.bits,
        in_sight_bits=in_sight_bits,
    )
