# SPDX-License-Identifier: MIT
"""Choice of a depth video: whether the stream gains more by it than it costs, how large and how fine.

A part of the frames is tried. What the models draw of them is held against what a video would show, in the same
measure by which cells are chosen: the logarithm of the depth's misfit against that of the stream's bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil, inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.video.av1 import can_encode_av1, decode_av1
from threedvc.coding.video.planes import VideoFormat
from threedvc.decoder.replay import replay
from threedvc.encoder.packetizer.captured.depth_run import (
    DEPTH_BITS,
    LAW,
    DepthMaps,
    EncodedDepthRun,
    PictureFormat,
    encode_depth_run,
    is_everywhere,
)
from threedvc.encoder.packetizer.captured.depth_tiles import are_measured, tile_misfits
from threedvc.encoder.packetizer.frame_runs import runs_of
from threedvc.encoder.rate.objective import ColorCost
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence
from threedvc.limits import MAX_SEQUENCE_SAMPLES, MAX_TILE_BYTES, MAX_VIDEO_SIDE
from threedvc.metrics.depth_errors import shown_depth_error
from threedvc.render.captured_depth import CapturedDepth, depth_levels, pack_tiles
from threedvc.stream.captured_headers import DepthVideoHeader
from threedvc.stream.framing_sizes import DEPTH_VIDEO_FRAMING_BYTES
from threedvc.stream.packets import Packet

__all__ = ["choose_depth_video"]

SCALES, LARGE_SCALES = (0.25, 0.375, 0.5), (0.75, 1.0)
"""Sizes that are tried, in sides of the depth map, the least first: its bytes usually tell that none is worth it. Large
ones are tried while each gains more than the one before: high rates want them."""
MIDDLE_CRF, CRF_STEPS, FINE_CRF_STEPS = 22, (8, -7), (4, -3)
"""Sizes are tried with a middling quality of AV1, then the best size with coarser and finer ones while they gain,
in large steps and then in small ones."""
TRADED_CRF = 12
"""By how much coarser quality is with the next larger size, which then takes about as many bytes (cereal_box)."""
MIN_CRF, MAX_CRF = 12, 60
"""The finest quality that is tried, beyond which depth without loss takes no more bytes (fr1_rpy), and the coarsest."""
COARSE_CRFS = 35, 48
"""Tried where the middling one exceeds what a video may take."""
TRIAL_FRAMES, TRIAL_PICTURES = 60, 8
"""Frames in a row that are tried, two seconds at 30 frames/s, and how many of them are drawn, which takes longest."""
HOPELESS_GAIN = -0.15
"""A gain this low of a video speaks against larger ones, too; by hand."""
HOPED_SHARE = 0.25
"""Share of the misfit that larger pictures may leave; by hand. If that is not worth the bytes, nothing is."""
MIN_GAIN = 0.05
"""What a video must gain beyond its price (decision 0019): trials are small, and a stream without one is simpler."""
ALIKE = 0.01
"""Of choices whose gains differ by no more, that of most bytes is taken: trials are coded less thoroughly."""
MAX_RATE_SHARE = 0.8
"""Share of the bytes of colors of a stream of given rate that a video may take: these need the rest; by hand."""
MAX_PART = 1.0
"""Times the bytes of colors, or of a stream with the models' own, that a video may take without a rate: more for depth
than for all else is out of balance, however far the misfit falls."""
TILE_SHARES = (0.9, 0.75, 0.5)
"""Shares of the misfit that the tiles hold together which are tried alone."""
MAX_HALF_SHARE = 0.25
"""Share of the tiles that may hold half of the misfit for that to be tried: what bends does, noise is everywhere."""
MIN_MISFIT = 1e-9
"""Keeps shares of no misfit at all finite."""
MAX_SCALE_SHARE = 0.99
"""Of the greatest scale within the limit of samples: sides are rounded."""
MIN_SIDE = 16
"""No side of a picture is smaller, unless the depth map's is; by hand."""


class DepthVideoChoice(NamedTuple):
    """How depth is coded, and where.

    Attributes
    ----------
    pictures
        Format of the pictures.
    least_misfit
        The misfit of what is drawn from which on a tile of a run is shown instead; 0: all are.
    """

    pictures: PictureFormat
    least_misfit: float = 0.0

    def magnified(self, pictures: PictureFormat) -> DepthVideoChoice:
        """Return the choice of about the same places in larger pictures, whose tiles are smaller."""
        smaller = self.pictures.columns * self.pictures.rows / (pictures.columns * pictures.rows)
        return DepthVideoChoice(pictures, _rounded(self.least_misfit * smaller))

    def coarser(self, crf: int) -> DepthVideoChoice:
        """Return the choice with pictures coarser by some steps, or finer, within the limits."""
        pictures = self.pictures
        return self._replace(pictures=pictures._replace(crf=int(np.clip(pictures.crf + crf, MIN_CRF, MAX_CRF))))

    def traded(self, sizes: Sequence[tuple[int, int]], crf: int) -> DepthVideoChoice:
        """Return the choice of the next of some sizes (columns, rows) in pictures coarser by some steps, if any."""
        following = sizes[sizes.index(self.pictures[:2]) + 1 :]
        return self.magnified(PictureFormat(*following[0], self.pictures.crf)).coarser(crf) if following else self

    def tiles(self, misfits: NDArray[np.float64], measured: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
        """Return which tiles are shown, None for all: also where too many would have to be told.

        They are those whose `tile_misfits` are large enough and that `are_measured`: models know more of the others.
        """
        if misfits.size > 8 * MAX_TILE_BYTES:
            return None
        shown = (misfits >= self.least_misfit) & measured
        return None if shown.all() else np.asarray(shown)


@dataclass(frozen=True, kw_only=True, eq=False)
class _SensorFrames:
    """The frames of one sensor of a finished scene.

    Attributes
    ----------
    scene, frames
        The scene and all its frames.
    packets
        The stream without a video.
    sensor
        Number of the sensor.
    seeing
        Those of its frames that have depth.
    batch_frames
        Frames of a BATCH, no run of pictures crosses its end.
    """

    scene: Scene
    frames: FrameSequence
    packets: Sequence[Packet]
    sensor: int
    seeing: list[int]
    batch_frames: int

    def measured(self, number: int) -> NDArray[np.float32]:
        """Return the depth (h, w) that was measured in a frame."""
        return self.scene.with_depth_limit(self.frames[number]).depth

    def drawn(self, numbers: Sequence[int]) -> Iterator[NDArray[np.float32]]:
        """Yield the depth (h, w) that packets draw of some frames, whose numbers rise."""
        wanted = set(numbers)
        for state, renderer, models in replay(
            self.packets, self.scene.config.threads, lambda state: state.index in wanted
        ):
            yield renderer.draw(models, state.T_camera_object, color=False).depth
            if state.index == numbers[-1]:
                return

    def runs(self) -> Iterator[list[int]]:
        """Yield the frames with depth in a row of this sensor's, batch by batch."""
        seeing = set(self.seeing)
        for first in range(0, len(self.frames), self.batch_frames):
            stop = min(first + self.batch_frames, len(self.frames))
            own = [frame for frame in range(first, stop) if self.scene.records[frame].sensor == self.sensor]
            for start, end in runs_of(frame in seeing for frame in own):
                yield own[start:end]


def choose_depth_video(
    scene: Scene,
    frames: FrameSequence,
    packets: Sequence[Packet],
    cost: ColorCost,
    misfit_cost: Callable[[float], float],
    group: int,
    *,
    sure: bool,
) -> list[Packet]:
    """Return DEPTH_VIDEO packets of those sensors whose depth is worth it; frames without depth have no picture.

    Parameters
    ----------
    scene
        The finished scene.
    frames
        Its frames.
    packets
        The stream without a video.
    cost
        What bytes cost that a video takes.
    misfit_cost
        What a misfit of depth costs beside that.
    group
        Frames of a BATCH, no run of pictures crosses its end.
    sure
        Whether a video is wanted wherever the target leaves room for it.
    """
    if not can_encode_av1():
        return []
    videos: list[Packet] = []
    for sensor in range(len(scene.info.rigs)):
        taken = [frame for frame, record in enumerate(scene.records) if record.sensor == sensor]
        seeing = [frame for frame in taken if not scene.records[frame].blind]
        if not seeing:
            continue
        own = _SensorFrames(
            scene=scene, frames=frames, packets=packets, sensor=sensor, seeing=seeing, batch_frames=group
        )
        choice = DepthVideoTrial(own, cost, misfit_cost).best(sure=sure)
        if choice is not None:
            videos += DepthVideoWriter(own).packets(choice)
    max_bytes = inf if cost.budget_bytes is None else MAX_RATE_SHARE * cost.budget_bytes
    return videos if sum(len(video.payload) for video in videos) <= max_bytes else []


class DepthVideoTrial:
    """Frames in the middle of those that one sensor took, and what the models draw of some of them.

    Parameters
    ----------
    own
        The sensor's frames.
    cost, misfit_cost
        What bytes and a misfit of depth cost.
    """

    def __init__(self, own: _SensorFrames, cost: ColorCost, misfit_cost: Callable[[float], float]) -> None:
        self._threads = own.scene.config.threads
        self._cost, self._misfit_cost = cost, misfit_cost
        taken = sum(record.sensor == own.sensor for record in own.scene.records)
        self._part = taken / len(own.scene.records)
        first = max(0, (len(own.seeing) - TRIAL_FRAMES) // 2)
        numbers = own.seeing[first : first + TRIAL_FRAMES]
        self._share = len(numbers) / len(own.seeing)
        self._measured: DepthMaps = [own.measured(number) for number in numbers]
        together = max(1, round(own.batch_frames * self._part))
        self._run_maps = [self._measured[k : k + together] for k in range(0, len(numbers), together)]
        some = numbers[:: ceil(len(numbers) / TRIAL_PICTURES)]
        self._drawn = dict(zip(map(numbers.index, some), own.drawn(some), strict=True))
        budget = cost.budget_bytes
        self._max_bytes = MAX_PART * cost.sizes[0] if budget is None else MAX_RATE_SHARE * budget
        self._everywhere = is_everywhere([self._measured[place] for place in self._drawn], list(self._drawn.values()))
        height, width = self._measured[0].shape
        frames = min(max(own.batch_frames, TRIAL_FRAMES), len(own.scene.records))
        samples = frames * len(own.scene.info.rigs) * width * height
        max_share = MAX_SEQUENCE_SAMPLES / samples
        self._max_scale = min(MAX_SCALE_SHARE * max_share**0.5, MAX_VIDEO_SIDE / max(width, height))
        self._misfit = self._misfit_with({})
        self._gains: dict[DepthVideoChoice, float] = {}
        self._hopes: dict[DepthVideoChoice, float] = {}
        self._sizes: dict[DepthVideoChoice, float] = {}

    def best(self, *, sure: bool) -> DepthVideoChoice | None:
        """Return the choice that gains most; None if none gains enough, unless a video is wanted for sure."""
        self._try_sizes(sure=sure)
        if not sure:
            for misfit in self._tile_misfits(self._most().pictures):
                self._try(self._most()._replace(least_misfit=misfit))
        if self._most().least_misfit:
            for scale in SCALES[1:]:
                self._try(self._most().magnified(self._format(scale)))
        hope = self._gains[self._most()]
        if hope == -inf or (hope < HOPELESS_GAIN and not sure):
            return None
        self._try_qualities(CRF_STEPS)
        self._try_trades()
        self._try_qualities(FINE_CRF_STEPS)
        best = self._gains[self._most()]
        if not (sure or best > MIN_GAIN):
            return None
        alike = [choice for choice, gain in self._gains.items() if gain >= best - ALIKE]
        return max(alike, key=self._sizes.__getitem__)

    def _try(self, choice: DepthVideoChoice) -> float:
        """Return what a choice gains, which is tried once."""
        if choice not in self._gains:
            self._gains[choice] = self._gain(choice)
        return self._gains[choice]

    def _most(self) -> DepthVideoChoice:
        """Return the choice so far that gains most."""
        return max(self._gains, key=self._gains.__getitem__)

    def _try_sizes(self, *, sure: bool) -> None:
        """Try larger and larger pictures of the whole until they are hopeless."""
        before = -inf
        for scale in (*SCALES, *LARGE_SCALES):
            whole = DepthVideoChoice(self._format(scale))
            found = self._try(whole)
            for crf in COARSE_CRFS if found == -inf else ():
                found = self._try(whole._replace(pictures=whole.pictures._replace(crf=crf)))
                if found > -inf:
                    break
            falls = found <= before and (found < HOPELESS_GAIN or scale >= SCALES[-1])
            if found == -inf or (not sure and (falls or self._hopes[whole] < MIN_GAIN)):
                return
            before = found

    def _try_qualities(self, steps: Sequence[int]) -> None:
        """Try coarser and finer qualities of the best choice while they gain."""
        for step in steps:
            self._climb(partial(DepthVideoChoice.coarser, crf=step))

    def _try_trades(self) -> None:
        """Try larger coarser pictures in place of the best choice, or smaller finer ones, while they gain."""
        sizes = list(dict.fromkeys(self._format(scale)[:2] for scale in (*SCALES, *LARGE_SCALES)))
        self._climb(partial(DepthVideoChoice.traded, sizes=sizes, crf=TRADED_CRF))
        self._climb(partial(DepthVideoChoice.traded, sizes=sizes[::-1], crf=-TRADED_CRF))

    def _climb(self, step: Callable[[DepthVideoChoice], DepthVideoChoice]) -> None:
        """Step from the best choice for as long as the step becomes the best."""
        before = None
        while self._most() != before:
            before = self._most()
            self._try(step(before))

    def _tile_misfits(self, pictures: PictureFormat) -> list[float]:
        """Return misfits of tiles from which on these hold some shares of all, if few hold the half."""
        misfits = self._misfits(pictures)
        rising = np.sort(misfits.reshape(-1))[::-1]
        held = np.cumsum(rising) / max(rising.sum(), MIN_MISFIT)
        few = np.searchsorted(held, 0.5) + 1 <= MAX_HALF_SHARE * len(rising)
        return [_rounded(rising[np.searchsorted(held, share)]) for share in TILE_SHARES] if few else []

    def _misfits(self, pictures: PictureFormat) -> NDArray[np.float64]:
        """Return the `tile_misfits` of what is drawn."""
        return tile_misfits(((drawn, self._measured[place]) for place, drawn in self._drawn.items()), pictures)

    def _format(self, scale: float) -> PictureFormat:
        height, width = self._measured[0].shape
        scale = min(scale, self._max_scale)
        rows, columns = (min(max(int(scale * side), MIN_SIDE), side) for side in (height, width))
        return PictureFormat(columns, rows, MIDDLE_CRF)

    def _gain(self, choice: DepthVideoChoice) -> float:
        """Return what a video of all sensors gains: what it takes off the misfit less the price of its bytes."""
        tiles = choice.tiles(self._misfits(choice.pictures), are_measured(self._measured, choice.pictures))
        runs = [
            encode_depth_run(each, choice.pictures, tiles, thorough=False, threads=self._threads)
            for each in self._run_maps
        ]
        told = 0 if tiles is None else len(pack_tiles(tiles))
        size = sum(len(run.payload) + told + DEPTH_VIDEO_FRAMING_BYTES for run in runs)
        video_bytes = size / (self._share * self._part)
        self._sizes[choice] = video_bytes
        if video_bytes > self._max_bytes:
            self._hopes[choice] = -inf
            return -inf
        dearer = self._cost.at(video_bytes) - self._cost.at(0)
        self._hopes[choice] = self._misfit_cost(self._misfit) - self._misfit_cost(HOPED_SHARE * self._misfit) - dearer
        shown = self._misfit_with(dict(self._shown(runs, choice.pictures)))
        return self._misfit_cost(self._misfit) - self._misfit_cost(shown) - dearer

    def _shown(
        self, runs: Sequence[EncodedDepthRun], choice: PictureFormat
    ) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """Yield places of some frames, and what a decoder shows there by runs in place of what is drawn."""
        video = VideoFormat(width=choice.columns, height=choice.rows, bits=DEPTH_BITS, gray=True)
        first = 0
        for run, maps in zip(runs, self._run_maps, strict=True):
            levels = depth_levels(run.nearest_m, run.ratio, DEPTH_BITS, LAW)
            for place, planes in enumerate(decode_av1(run.payload, len(maps), video), first):
                if place in self._drawn:
                    captured = CapturedDepth(
                        samples=planes.luma, levels=levels, complete=self._everywhere, tiles=run.tiles
                    )
                    yield place, captured.shown(self._drawn[place], self._threads)
            first += len(maps)

    def _misfit_with(self, shown: Mapping[int, NDArray[np.float32]]) -> float:
        """Return the misfit of what is drawn, or shown instead."""
        return shown_depth_error(
            (shown.get(place, drawn), self._measured[place]) for place, drawn in self._drawn.items()
        )


def _rounded(misfit: float) -> float:
    """Return a misfit with as many digits as survive a multiplication and a division."""
    return float(f"{misfit:.9g}")


class DepthVideoWriter:
    """Writes the video of one sensor."""

    def __init__(self, own: _SensorFrames) -> None:
        self._own = own
        self._drawn = own.drawn(own.seeing)

    def packets(self, choice: DepthVideoChoice) -> Iterator[Packet]:
        """Yield a packet for each run of frames with depth in a BATCH, but where no tile is worth it."""
        pictures, threads = choice.pictures, self._own.scene.config.threads
        for numbers in self._own.runs():
            measured = [self._own.measured(number) for number in numbers]
            drawn = [next(self._drawn) for _ in numbers]
            misfits = tile_misfits(zip(drawn, measured, strict=True), pictures)
            tiles = choice.tiles(misfits, are_measured(measured, pictures))
            if tiles is not None and not tiles.any():
                continue
            run = encode_depth_run(measured, pictures, tiles, thorough=True, threads=threads)
            header = DepthVideoHeader(
                frame=numbers[0],
                count=len(numbers),
                sensor=self._own.sensor,
                columns=pictures.columns,
                rows=pictures.rows,
                bits=DEPTH_BITS,
                nearest_m=run.nearest_m,
                ratio=run.ratio,
                complete=is_everywhere(measured, drawn),
                law=LAW,
                tiles=b"" if tiles is None else pack_tiles(tiles),
            )
            yield header.packet(run.payload, critical=False)
