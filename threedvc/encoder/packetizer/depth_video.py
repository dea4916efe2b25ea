# SPDX-License-Identifier: MIT
"""Choice of a depth video: whether the stream gains more by it than it costs, how large and how fine.

A part of the frames is tried. What the models draw of them is held against what a video would show, in the same
measure by which cells are chosen: the logarithm of the depth's misfit against that of the stream's bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil, inf
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.coding.picture_sequence import can_encode_sequences, decode_sequence, encode_sequence
from threedvc.decoder.replay import played
from threedvc.encoder.rate.rate_control import DEPTH_SHARE, SHARE_PER_BYTE, stream_bytes
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence
from threedvc.limits import MAX_SEQUENCE_SAMPLES, MAX_VIDEO_SIDE
from threedvc.metrics.depth_errors import mean_misfit
from threedvc.render.captured_depth import LEVELS, FilmedDepth, depth_levels
from threedvc.render.hole_filling import fill_unknown
from threedvc.stream.headers import VideoHeader
from threedvc.stream.packets import Packet

__all__ = ["worthwhile_videos"]

SCALES = (0.25, 0.375, 0.5)
MIDDLE_QUALITY, OTHER_QUALITIES = 65, (50, 80)
TRIAL_FRAMES, TRIAL_PICTURES = 60, 8
"""Frames in a row that are tried, and how many of them are drawn."""
HOPELESS = -0.15
"""A gain this low of the smallest video speaks against all of them."""
WORTHWHILE = 0.05
ALIKE = 0.01
"""Of choices whose gains differ by no more, the finest is taken: trials are coded less thoroughly."""
MOST_OF_RATE = 0.6
"""Share of the bytes of a stream of given rate that a video may take."""
ENDS_PERCENT = 0.1
COMPLETE = 0.995
"""Where this part of the pixels of every frame is measured, a run shows something everywhere."""
LEAST_RATIO, GREATEST_RATIO = 1.0001, 1.1
LEAST_SIDE = 16
MOST_THOROUGH = 4_000_000
"""Samples of a run above which the most thorough coding takes too long."""
PACKET_BYTES = 40
FAR = np.float32(1e6)
Depths = list[NDArray[np.float32]]
"""Depth maps (h, w) in metres, 0 = nothing."""


class _Choice(NamedTuple):
    """Size of the pictures, and their quality."""

    columns: int
    rows: int
    quality: int


class _Film(NamedTuple):
    """A run of depth maps, coded: the depths that values mean, and whether the run shows something everywhere."""

    nearest_m: float
    ratio: float
    complete: bool
    payload: bytes


def worthwhile_videos(
    scene: Scene,
    frames: FrameSequence,
    packets: Sequence[Packet],
    target_bytes: float | None,
    group: int,
    *,
    sure: bool,
) -> list[Packet]:
    """Return VIDEO packets of the frames of those sensors whose depth is worth it; frames without depth have none.

    Parameters
    ----------
    scene
        The finished scene.
    frames
        Its frames.
    packets
        The stream without a video.
    target_bytes
        What the stream shall take with it, or None: the video is added to its bytes.
    group
        Frames of a BATCH, no run of pictures crosses its end.
    sure
        Whether a video is wanted wherever the target leaves room for it.
    """
    if not can_encode_sequences():
        return []
    total = float(stream_bytes(packets) if target_bytes is None else target_bytes)
    seeing = [frame for frame, blind in enumerate(scene.blind) if not blind]
    videos: list[Packet] = []
    for sensor in range(len(scene.info.rigs)):
        own = [frame for frame in seeing if scene.sensors[frame] == sensor]
        if not own:
            continue
        stream = total * scene.sensors.count(sensor) / len(frames)
        choice = _Trial(scene, frames, packets, own, group).best(stream, target_bytes is not None, sure)
        if choice is not None:
            videos += _Filming(scene, frames, packets, own, group).packets(sensor, choice)
    most = inf if target_bytes is None else MOST_OF_RATE * total
    return videos if sum(len(video.payload) for video in videos) <= most else []


class _Trial:
    """Frames in the middle of those that one sensor took, and what the models draw of some of them."""

    def __init__(
        self, scene: Scene, frames: FrameSequence, packets: Sequence[Packet], own: Sequence[int], group: int
    ) -> None:
        self._threads = scene.config.threads
        first = max(0, (len(own) - TRIAL_FRAMES) // 2)
        numbers = own[first : first + TRIAL_FRAMES]
        self._share = len(numbers) / len(own)
        self._measured = [_measured(scene, frames, number) for number in numbers]
        some = numbers[:: ceil(len(numbers) / TRIAL_PICTURES)]
        self._drawn = {numbers.index(number): depth for number, depth in _drawn(packets, some, self._threads)}
        height, width = self._measured[0].shape
        most = MAX_SEQUENCE_SAMPLES / (max(group, TRIAL_FRAMES) * len(scene.info.rigs) * width * height)
        self._most_scale = min(0.99 * most**0.5, MAX_VIDEO_SIDE / max(width, height))
        self._misfit = self._misfit_with({})

    def best(self, stream: float, fixed: bool, sure: bool) -> _Choice | None:
        """Return the choice that gains most for a stream of a number of bytes, `fixed` or to be added to."""
        gains: dict[_Choice, float] = {}
        for scale in SCALES:
            choice = self._choice(scale)
            if choice not in gains:
                gains[choice] = self._gain(choice, stream, fixed)
            if gains[choice] < HOPELESS and not sure:
                return None
        middle = max(gains, key=lambda each: gains[each])
        for quality in OTHER_QUALITIES:
            choice = middle._replace(quality=quality)
            gains[choice] = self._gain(choice, stream, fixed)
        most = max(gains.values())
        if most == -inf or not (sure or most > WORTHWHILE):
            return None
        alike = [choice for choice in gains if gains[choice] >= most - ALIKE]
        return max(alike, key=lambda each: (each.columns * each.rows, each.quality))

    def _choice(self, scale: float) -> _Choice:
        height, width = self._measured[0].shape
        scale = min(scale, self._most_scale)
        rows, columns = (min(max(int(scale * side), LEAST_SIDE), side) for side in (height, width))
        return _Choice(columns, rows, MIDDLE_QUALITY)

    def _gain(self, choice: _Choice, stream: float, fixed: bool) -> float:
        film = _filmed(self._measured, self._measured, choice, thorough=False)
        taken = (len(film.payload) + PACKET_BYTES) / self._share
        if fixed and taken > MOST_OF_RATE * stream:
            return -inf
        dearer = -np.log(1 - taken / stream) if fixed else np.log(1 + taken / stream)
        pictures = decode_sequence(film.payload, len(self._measured), choice.columns, choice.rows)
        levels = depth_levels(film.nearest_m, film.ratio)
        shown = {
            at: FilmedDepth(samples=pictures[at], levels=levels, complete=film.complete).shown(drawn, self._threads)
            for at, drawn in self._drawn.items()
        }
        better = np.log((self._misfit + 1e-4) / (self._misfit_with(shown) + 1e-4))
        return float(DEPTH_SHARE * better - SHARE_PER_BYTE * dearer)

    def _misfit_with(self, shown: dict[int, NDArray[np.float32]]) -> float:
        """Return the misfit of what is drawn, or shown instead; what is missing fits not at all."""
        pictures = ((shown.get(at, drawn), self._measured[at]) for at, drawn in self._drawn.items())
        return mean_misfit((np.where(depth > 0, depth, FAR), measured) for depth, measured in pictures)


class _Filming:
    """Writes the video of one sensor."""

    def __init__(
        self, scene: Scene, frames: FrameSequence, packets: Sequence[Packet], own: Sequence[int], group: int
    ) -> None:
        self._scene, self._frames, self._own, self._group = scene, frames, own, group
        self._drawn = _drawn(packets, own, scene.config.threads)

    def packets(self, sensor: int, choice: _Choice) -> Iterator[Packet]:
        """Yield a packet for each run of frames with depth in a BATCH."""
        for numbers in self._runs(sensor):
            measured = [_measured(self._scene, self._frames, number) for number in numbers]
            film = _filmed(measured, self._filled(measured), choice, thorough=True)
            header = VideoHeader(
                frame=numbers[0],
                count=len(numbers),
                sensor=sensor,
                columns=choice.columns,
                rows=choice.rows,
                nearest_m=film.nearest_m,
                ratio=film.ratio,
                complete=film.complete,
            )
            yield header.packet(film.payload, critical=False)

    def _runs(self, sensor: int) -> Iterator[list[int]]:
        seeing = set(self._own)
        for first in range(0, len(self._frames), self._group):
            run: list[int] = []
            for frame in range(first, min(first + self._group, len(self._frames))):
                if self._scene.sensors[frame] != sensor:
                    continue
                if frame in seeing:
                    run.append(frame)
                elif run:
                    yield run
                    run = []
            if run:
                yield run

    def _filled(self, measured: Depths) -> Depths:
        """Return depth maps with what the models draw where nothing was measured: there it shall stay."""
        filled = []
        for depth in measured:
            _, drawn = next(self._drawn)
            filled.append(np.where(depth > 0, depth, drawn))
        return filled


def _drawn(
    packets: Sequence[Packet], numbers: Sequence[int], threads: int
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield the depth (h, w) that packets draw of some frames of one sensor, with their numbers, which rise."""
    wanted = set(numbers)
    for state, renderer, models in played(packets, threads, lambda state: state.index in wanted):
        yield state.index, renderer.draw(models, state.T_camera_object, color=False).depth
        if state.index == numbers[-1]:
            return


def _measured(scene: Scene, frames: FrameSequence, number: int) -> NDArray[np.float32]:
    return scene.limited(frames[number]).depth


def _filmed(measured: Depths, filled: Depths, choice: _Choice, *, thorough: bool) -> _Film:
    """Code depth maps, `filled` where nothing was `measured`; values reach over the depths of all but a few pixels."""
    ends = [np.percentile(depth[depth > 0], [ENDS_PERCENT, 100 - ENDS_PERCENT]) for depth in filled]
    nearest, furthest = float(min(near for near, _ in ends)), float(max(far for _, far in ends))
    ratio = float(np.clip((furthest / nearest) ** (1 / (LEVELS - 1)), LEAST_RATIO, GREATEST_RATIO))
    samples = _samples(filled, choice, nearest, ratio)
    return _Film(
        nearest_m=nearest,
        ratio=ratio,
        complete=min(float(np.mean(depth > 0)) for depth in measured) > COMPLETE,
        payload=encode_sequence(samples, choice.quality, thorough=thorough and samples.size < MOST_THOROUGH),
    )


def _samples(depths: Depths, choice: _Choice, nearest_m: float, ratio: float) -> NDArray[np.uint8]:
    """Return the samples (frames, rows, columns) of depth maps; what is missing is filled from around."""
    size = choice.columns, choice.rows
    pictures = []
    for depth in depths:
        seen = depth > 0
        steps = np.log(np.where(seen, depth, nearest_m) / nearest_m) / np.log(ratio)
        weight = cv2.resize(seen.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        total = cv2.resize((steps * seen).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        mean = np.repeat((total / np.maximum(weight, np.float32(1e-6)))[..., None], 3, axis=2)
        fill_unknown(mean, (weight > 0).astype(np.uint8))
        pictures.append(np.clip(np.rint(mean[..., 0]), 0, LEVELS - 1).astype(np.uint8))
    return np.stack(pictures)
