# SPDX-License-Identifier: MIT
"""Choice of a depth video: whether the stream gains more by it than it costs, how large and how fine.

A part of the frames is tried. What the models draw of them is held against what a video would show, in the same
measure by which cells are chosen: the logarithm of the depth's misfit against that of the stream's bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.coding.picture_sequence import (
    can_decode_sequences,
    can_encode_sequences,
    decode_sequence,
    encode_sequence,
)
from threedvc.config import RenderConfig
from threedvc.decoder import Decoder
from threedvc.depth_video import LEVELS, FilmedDepth, depth_levels
from threedvc.frame import FrameSequence
from threedvc.packets import Packet, VideoHeader
from threedvc.rate_control import DEPTH_SHARE, SHARE_PER_BYTE, stream_bytes
from threedvc.refinement import mean_misfit
from threedvc.rendering import Renderer, RenderModel, fill_unknown
from threedvc.scene import Scene

__all__ = ["VideoChoice", "worthwhile_videos"]

SCALES = (0.25, 0.375, 0.5)
MIDDLE_QUALITY, OTHER_QUALITIES = 65, (50, 80)
TRIAL_FRAMES, TRIAL_PICTURES = 60, 8
"""Frames in a row that are tried, and how many of them are drawn."""
HOPELESS = -0.15
"""A gain this low of the smallest and coarsest video speaks against all of them."""
WORTHWHILE = 0.05
MOST_OF_RATE = 0.6
"""Share of the bytes of a stream of given rate that a video may take."""
ENDS_PERCENT = 0.1
COMPLETE = 0.995
"""Where this part of the pixels is measured, the video shows something everywhere."""
LEAST_RATIO, GREATEST_RATIO = 1.0001, 1.1
LEAST_SIDE = 16
MOST_THOROUGH = 4_000_000
"""Samples of a run above which the most thorough coding takes too long."""
PACKET_BYTES = 40
FAR = np.float32(1e6)


class VideoChoice(NamedTuple):
    """How the depth of a sensor is filmed: size of the pictures, their quality, and whether they show all pixels."""

    columns: int
    rows: int
    quality: int
    complete: bool


class _Run(NamedTuple):
    """Frames filmed: the depths that values mean, and the coded pictures."""

    nearest_m: float
    ratio: float
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
    """Return VIDEO packets of all frames of those sensors whose depth is worth it.

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
        Whether a video is wanted in any case.
    """
    if not (can_encode_sequences() and can_decode_sequences()):
        return []
    total = float(stream_bytes(packets) if target_bytes is None else target_bytes)
    videos: list[Packet] = []
    for sensor in range(len(scene.info.rigs)):
        trial = _Trial(scene, frames, packets, sensor)
        if trial.misfit is None:
            continue
        choice = trial.best(total * scene.sensors.count(sensor) / len(frames), target_bytes is not None, sure)
        if choice is not None:
            videos += _packets(scene, frames, sensor, choice, group)
    return videos


class _Trial:
    """Frames in the middle of a sequence that one sensor took, and what the models draw of them."""

    def __init__(self, scene: Scene, frames: FrameSequence, packets: Sequence[Packet], sensor: int) -> None:
        self._scene, self._frames, self._threads = scene, frames, scene.config.threads
        own = [frame for frame in range(len(frames)) if scene.sensors[frame] == sensor]
        first = max(0, (len(own) - TRIAL_FRAMES) // 2)
        self._numbers = own[first : first + TRIAL_FRAMES]
        self._share = len(self._numbers) / max(len(own), 1)
        self._measured = [_measured(scene, frames, number) for number in self._numbers]
        some = self._numbers[:: max(1, len(self._numbers) // TRIAL_PICTURES)]
        self._drawn = dict(_drawn(packets, some, self._threads))
        self.misfit = self._misfit({}) if any(depth.any() for depth in self._measured) else None

    def best(self, stream: float, fixed: bool, sure: bool) -> VideoChoice | None:
        """Return the choice that gains most for a stream of a number of bytes, `fixed` or to be added to."""
        gains: dict[VideoChoice, float] = {}
        for scale in SCALES:
            choice = self._choice(scale, MIDDLE_QUALITY)
            gains[choice] = self._gain(choice, stream, fixed)
            if gains[choice] < HOPELESS and not sure:
                return None
        best = max(gains, key=lambda each: gains[each])
        for quality in OTHER_QUALITIES:
            choice = best._replace(quality=quality)
            gains[choice] = self._gain(choice, stream, fixed)
        best = max(gains, key=lambda each: gains[each])
        return best if sure or gains[best] > WORTHWHILE else None

    def _choice(self, scale: float, quality: int) -> VideoChoice:
        height, width = self._measured[0].shape
        return VideoChoice(
            columns=min(max(round(scale * width), LEAST_SIDE), width),
            rows=min(max(round(scale * height), LEAST_SIDE), height),
            quality=quality,
            complete=float(np.mean([np.mean(depth > 0) for depth in self._measured])) > COMPLETE,
        )

    def _gain(self, choice: VideoChoice, stream: float, fixed: bool) -> float:
        run = _filmed(self._measured, choice, thorough=False)
        taken = (len(run.payload) + PACKET_BYTES) / self._share
        if fixed and taken > MOST_OF_RATE * stream:
            return -inf
        dearer = -np.log(1 - taken / stream) if fixed else np.log(1 + taken / stream)
        pictures = decode_sequence(run.payload, len(self._measured), choice.columns, choice.rows)
        levels = depth_levels(run.nearest_m, run.ratio)
        films = {
            number: FilmedDepth(samples=samples, levels=levels, complete=choice.complete)
            for number, samples in zip(self._numbers, pictures, strict=True)
        }
        assert self.misfit is not None
        better = np.log((self.misfit + 1e-4) / (self._misfit(films) + 1e-4))
        return float(DEPTH_SHARE * better - SHARE_PER_BYTE * dearer)

    def _misfit(self, films: dict[int, FilmedDepth]) -> float:
        """Return the misfit of what is drawn, or filmed; what is missing fits not at all."""

        def pictures() -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
            for number, drawn in self._drawn.items():
                shown = films[number].shown(drawn, self._threads) if number in films else drawn
                yield np.where(shown > 0, shown, FAR), self._measured[self._numbers.index(number)]

        return mean_misfit(pictures())


def _drawn(
    packets: Sequence[Packet], numbers: Sequence[int], threads: int
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield the depth (h, w) that packets draw of some frames, with their numbers."""
    decoder, models = Decoder(), dict[int, RenderModel]()
    wanted = set(numbers)
    renderer: Renderer | None = None
    for state in decoder.frames(packets):
        if state.index not in wanted:
            continue
        renderer = renderer or Renderer(decoder.rigs[state.sensor], RenderConfig(threads=threads))
        for number in state.T_camera_object:
            if number not in models:
                models[number] = RenderModel(decoder.models[number])
            models[number].refresh(threads)
        yield state.index, renderer.draw(models, state.T_camera_object, color=False).depth
        wanted.remove(state.index)
        if not wanted:
            return


def _measured(scene: Scene, frames: FrameSequence, number: int) -> NDArray[np.float32]:
    return scene.limited(frames[number]).depth


def _filmed(measured: Sequence[NDArray[np.float32]], choice: VideoChoice, *, thorough: bool) -> _Run:
    """Return a run of depth maps, filmed; the depths that values mean reach over what all but a few pixels measure."""
    seen = (depth[depth > 0] for depth in measured)
    ends = [np.percentile(some, [ENDS_PERCENT, 100 - ENDS_PERCENT]) for some in seen if len(some)]
    nearest, furthest = (min(near for near, _ in ends), max(far for _, far in ends)) if ends else (1.0, 1.0)
    ratio = float(np.clip((furthest / nearest) ** (1 / (LEVELS - 1)), LEAST_RATIO, GREATEST_RATIO))
    samples = _samples(measured, choice, float(nearest), ratio)
    return _Run(
        float(nearest),
        ratio,
        encode_sequence(samples, choice.quality, thorough=thorough and samples.size < MOST_THOROUGH),
    )


def _samples(
    measured: Sequence[NDArray[np.float32]], choice: VideoChoice, nearest_m: float, ratio: float
) -> NDArray[np.uint8]:
    """Return the samples (frames, rows, columns) of depth maps; holes are filled from around."""
    size = choice.columns, choice.rows
    pictures = []
    for depth in measured:
        seen = depth > 0
        steps = np.log(np.where(seen, depth, nearest_m) / nearest_m) / np.log(ratio)
        weight = cv2.resize(seen.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        total = cv2.resize((steps * seen).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        mean = np.repeat((total / np.maximum(weight, np.float32(1e-6)))[..., None], 3, axis=2)
        fill_unknown(mean, (weight > 0).astype(np.uint8))
        pictures.append(np.clip(np.rint(mean[..., 0]), 0, LEVELS - 1).astype(np.uint8))
    return np.stack(pictures)


def _packets(scene: Scene, frames: FrameSequence, sensor: int, choice: VideoChoice, group: int) -> Iterator[Packet]:
    """Yield the packets of all frames of a sensor, one for each BATCH."""
    for first in range(0, len(frames), group):
        numbers = [n for n in range(first, min(first + group, len(frames))) if scene.sensors[n] == sensor]
        if numbers:
            run = _filmed([_measured(scene, frames, number) for number in numbers], choice, thorough=True)
            header = VideoHeader(
                frame=numbers[0],
                count=len(numbers),
                sensor=sensor,
                columns=choice.columns,
                rows=choice.rows,
                nearest_m=run.nearest_m,
                ratio=run.ratio,
                complete=choice.complete,
            )
            yield header.packet(run.payload, critical=False)
