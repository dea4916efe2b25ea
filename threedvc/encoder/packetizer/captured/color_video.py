# SPDX-License-Identifier: MIT
"""The color pictures of a scene's frames as video, in place of the models' colors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil, log2
from typing import NamedTuple, Protocol

import numpy as np

from threedvc.coding.video.av1 import Av1Settings
from threedvc.coding.video.color_runs import encode_color, video_format
from threedvc.coding.video.ffv1 import EXACT_BITS, encode_ffv1
from threedvc.coding.video.jpeg import encode_jpeg_files
from threedvc.coding.video.planes import Planes, VideoFormat, planes_of, spare_magnification
from threedvc.config import EncoderConfig
from threedvc.config.stages import MAX_COARSENESS, MIN_CRF
from threedvc.encoder.reconstruction.frame_intake import FrameRecord
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.framing_sizes import COLOR_VIDEO_FRAMING_BYTES
from threedvc.stream.packets import Packet, VideoCodec

__all__ = [
    "EXACT",
    "MAX_SCALED_CRF",
    "QUARTERS",
    "SCALES",
    "ColorVideoWriter",
    "FrameSource",
    "PictureCoding",
    "PictureSource",
    "VideoChoice",
    "picture_coding",
    "video_bytes",
]

BITS = 10
"""Of a sample, whatever the input has: sums are rounded less, for 2 % fewer bytes (decision 0030)."""
SCALES = (0.25, 0.375, 0.5, 0.75, 1.0)
"""Of pictures, in sides of the camera's."""
SHRINKING = ((61.0, 1.0, 0.0), (63.5, 0.75, 3.0), (71.0, 0.5, 7.0), (74.0, 0.375, 9.25), (MAX_COARSENESS, 0.25, 12.75))
"""Up to which coarseness pictures have which scale, and by how much finer these are quantized than it says: coarse
quantization loses up to 1.1 dB against a smaller picture of as many bytes (decision 0036)."""
MAX_SCALED_CRF = 67.0
"""Quantization beyond which a scale is not tried by itself: a smaller one is better. From 62.75 on SVT-AV1 leaps, and
loses .3 dB and more where the camera moves, but none where it rests (hands_table)."""
MIN_SIDE = 16
"""No side of a picture is smaller, unless the camera's is; by hand."""
HALVING = 7.0
"""So much more coarseness halves the bytes, about: a first guess."""
CLOSE = 0.97
"""Share of a target from which a size is close enough: finer steps move it by 2 to 3 %."""
FIRST_TRIAL = 60.0
"""Coarseness that is tried first where nothing is known."""
MAX_TRIALS = 7
"""Videos that a search codes at most; three or four are the rule."""
MAX_KEPT = 6
"""Choices whose packets are kept: those of long recordings at high rates take much memory."""
QUARTERS = 4
"""Steps of coarseness that are tried are a quarter: the encoder has no finer ones."""


class FrameSource(Protocol):
    """What is asked of a scene; `threedvc.encoder.reconstruction.scene.Scene` has it."""

    @property
    def info(self) -> SequenceInfo:
        """The sequence."""

    @property
    def config(self) -> EncoderConfig:
        """Choices."""

    @property
    def records(self) -> Sequence[FrameRecord]:
        """What is kept of every frame so far."""


class PictureSource(Protocol):
    """What is asked of a sequence: its frames by their numbers."""

    def __getitem__(self, index: int, /) -> Frame: ...


class PictureCoding(NamedTuple):
    """Scale of the pictures, and their quantization by AV1."""

    scale: float
    crf: float


def picture_coding(coarseness: float) -> PictureCoding:
    """Return how pictures are coded at a coarseness from `MIN_CRF` to `MAX_COARSENESS`."""
    scale, finer = next((scale, finer) for most, scale, finer in SHRINKING if coarseness <= most)
    return PictureCoding(scale, max(coarseness - finer, MIN_CRF))


class VideoChoice(NamedTuple):
    """How finely pictures are coded.

    Attributes
    ----------
    coarseness
        From `MIN_CRF` to `MAX_COARSENESS`.
    full_chroma
        Whether chroma has all rows and columns.
    exact
        Whether nothing is lost; the others mean nothing then.
    scale
        Of the pictures, whose quantization the coarseness is then; 0: as `picture_coding` has it.
    """

    coarseness: float
    full_chroma: bool = False
    exact: bool = False
    scale: float = 0.0

    @property
    def coding(self) -> PictureCoding:
        """Scale of the pictures, and their quantization."""
        return PictureCoding(self.scale, self.coarseness) if self.scale else picture_coding(self.coarseness)

    @property
    def coarser(self) -> VideoChoice:
        """The choice of half the bytes; next to the coarsest, of twice as many."""
        coarsest = MAX_SCALED_CRF if self.scale else MAX_COARSENESS
        coarser = self.coarseness + HALVING
        return self._replace(coarseness=coarser if coarser <= coarsest else max(coarser - 2 * HALVING, MIN_CRF))


EXACT = VideoChoice(MIN_CRF, exact=True)
"""No loss."""


@dataclass(frozen=True)
class _Run:
    """Frames of one sensor in a BATCH, and by how much their chroma is magnified."""

    sensor: int
    frames: list[int]
    magnified: int


class ColorVideoWriter:
    """Codes the pictures of all frames.

    Parameters
    ----------
    scene
        The finished scene, of which sensors and choices count.
    frames
        Its frames.
    batches
        The numbers of the frames of each BATCH; no run of pictures crosses its end.

    Attributes
    ----------
    coded
        The packets of the last few choices.
    sizes
        The bytes of all choices so far.
    """

    def __init__(self, scene: FrameSource, frames: PictureSource, batches: Iterable[range]) -> None:
        self._scene, self._frames = scene, frames
        self._runs = [self._run(*run) for run in self._numbers(batches)]
        self.coded: dict[VideoChoice, list[Packet]] = {}
        self.sizes: dict[VideoChoice, int] = {}

    @property
    def pixels(self) -> int:
        """Number of pixels of all pictures, as filmed."""
        cameras = [self._scene.info.rigs[run.sensor].color for run in self._runs]
        return sum(
            len(run.frames) * camera.width * camera.height for run, camera in zip(self._runs, cameras, strict=True)
        )

    def packets(self, choice: VideoChoice) -> list[Packet]:
        """Return the COLOR_VIDEO packets of a choice, in the order of their frames."""
        if choice not in self.coded:
            make = self._exact_packet if choice.exact else partial(self._packet, choice)
            self.coded[choice] = [make(run) for run in self._runs]
            self.sizes[choice] = video_bytes(self.coded[choice])
            for old in list(self.coded)[:-MAX_KEPT]:
                del self.coded[old]
        return self.coded[choice]

    def size(self, choice: VideoChoice) -> int:
        """Return the bytes of the packets of a choice."""
        return self.sizes[choice] if choice in self.sizes else video_bytes(self.packets(choice))

    def choice_within(
        self,
        budget_bytes: float,
        like: VideoChoice | None = None,
        max_trials: int = MAX_TRIALS,
        enough_share: float | None = None,
    ) -> VideoChoice:
        """Return the finest choice of at most so many bytes that a few trials find, or the coarsest of them.

        With `MAX_TRIALS` of them that is the coarsest there is. The first one is `like`, and all have its chroma and,
        if it has any, its scale. With `enough_share` there are more than `max_trials`, up to `MAX_TRIALS`, until a
        choice has that share of the bytes.
        """
        like = like or VideoChoice(FIRST_TRIAL)
        low, high = MIN_CRF, MAX_SCALED_CRF if like.scale else MAX_COARSENESS
        coarseness, sizes = min(like.coarseness, high), dict[float, int]()
        for trial in range(MAX_TRIALS):
            if trial >= max_trials and (
                enough_share is None or any(enough_share <= size / budget_bytes <= 1 for size in sizes.values())
            ):
                break
            size = sizes[coarseness] = self.size(like._replace(coarseness=coarseness))
            low, high = (coarseness, high) if size > budget_bytes else (low, coarseness)
            if CLOSE * budget_bytes < size <= budget_bytes or high - low <= 1 / QUARTERS:
                break
            coarseness = _next_coarseness(sizes, budget_bytes, low, high)
            if coarseness in sizes:
                coarseness = round(QUARTERS * (low + high) / 2) / QUARTERS
            if coarseness in sizes:
                break
        fitting = [each for each, size in sizes.items() if size <= budget_bytes]
        return like._replace(coarseness=min(fitting) if fitting else max(sizes))

    def _numbers(self, batches: Iterable[range]) -> Iterator[tuple[int, list[int]]]:
        """Yield the sensor and the numbers of the frames of each run."""
        records = self._scene.records
        for batch in batches:
            for sensor in range(len(self._scene.info.rigs)):
                own = [frame for frame in batch if records[frame].sensor == sensor]
                if own:
                    yield sensor, own

    def _run(self, sensor: int, frames: list[int]) -> _Run:
        if self._scene.info.each_sensor[sensor].gray:
            return _Run(sensor, frames, 0)
        return _Run(sensor, frames, min(spare_magnification(self._frames[frame].color) for frame in frames))

    def _packet(self, choice: VideoChoice, run: _Run) -> Packet:
        sensor, config = self._scene.info.each_sensor[run.sensor], self._scene.config
        camera = sensor.rig.color
        coding = choice.coding
        columns, rows = (_scaled(side, coding.scale) for side in (camera.width, camera.height))
        settings = Av1Settings(crf=coding.crf, preset=config.video.preset, threads=config.threads)
        header = ColorVideoHeader(
            frame=run.frames[0],
            count=len(run.frames),
            sensor=run.sensor,
            columns=columns,
            rows=rows,
            codec=VideoCodec.AV1_FULL_CHROMA if choice.full_chroma else VideoCodec.AV1,
            bits=BITS,
            magnified=run.magnified,
        )
        video = video_format(header, gray=sensor.gray)
        return header.packet(encode_color(self._planes(run.frames, video), video, settings), critical=False)

    def _exact_packet(self, run: _Run) -> Packet:
        """Return the packet of a lossless video: of the JPEG files that all pictures came in, or else of FFV1."""
        sensor = self._scene.info.each_sensor[run.sensor]
        camera, gray = sensor.rig.color, sensor.gray
        video = VideoFormat(width=camera.width, height=camera.height, bits=EXACT_BITS, gray=gray)
        frames = (self._frames[number] for number in run.frames)
        files = encode_jpeg_files(((frame.color_file, frame.color) for frame in frames), video)
        header = ColorVideoHeader(
            frame=run.frames[0],
            count=len(run.frames),
            sensor=run.sensor,
            columns=video.width,
            rows=video.height,
            codec=VideoCodec.FFV1 if files is None else VideoCodec.JPEG,
            bits=video.bits,
        )
        if files is not None:
            return header.packet(files, critical=False)
        pictures = (self._frames[number].color for number in run.frames)
        return header.packet(encode_ffv1(pictures, video, self._scene.config.threads), critical=False)

    def _planes(self, numbers: Sequence[int], video: VideoFormat) -> Iterator[Planes]:
        return (planes_of(self._frames[number].color, video) for number in numbers)


def video_bytes(packets: Sequence[Packet]) -> int:
    """Return about how many bytes packets of a video take in a file."""
    return sum(len(packet.payload) + COLOR_VIDEO_FRAMING_BYTES for packet in packets)


def _scaled(side: int, scale: float) -> int:
    return min(max(ceil(scale * side), MIN_SIDE), side)


def _next_coarseness(sizes: dict[float, int], budget_bytes: float, low: float, high: float) -> float:
    """Return where the bytes may be a little less than they may, between two bounds: by the two nearest trials."""
    aim = log2(max(budget_bytes, 1.0) * (1 + CLOSE) / 2)
    nearest = sorted(sizes, key=lambda each: abs(log2(sizes[each]) - aim))[:2]
    slope = -1 / HALVING
    if len(nearest) == 2 and sizes[nearest[0]] != sizes[nearest[1]]:
        slope = (log2(sizes[nearest[0]]) - log2(sizes[nearest[1]])) / (nearest[0] - nearest[1])
    guess = nearest[0] + (aim - log2(sizes[nearest[0]])) / min(slope, -1 / (4 * HALVING))
    guess = round(QUARTERS * guess) / QUARTERS
    between = float(np.clip(guess, low, high))
    return between if between not in (low, high) or between not in sizes else round(2 * (low + high)) / QUARTERS
