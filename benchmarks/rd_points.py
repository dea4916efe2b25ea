# SPDX-License-Identifier: MIT
"""Points of rate-distortion curves: encode at some setting, decode, score; keep what was measured as JSON.

Pictures of either codec go through one `Score`, which measures them by `threedvc.metrics.picture_quality`.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import threedvc
from av1 import VideoCodec, library
from planes import InverseDepth, Plane
from reporting import REPOSITORY
from sequences import Run
from threedvc.cli.main import main as command
from threedvc.cli.requests import EncodeRequest
from threedvc.config import EncoderConfig
from threedvc.formats.sources import FolderSequence, open_sequence
from threedvc.frames.frame import SequenceInfo
from threedvc.metrics.depth_errors import DepthErrors, depth_units
from threedvc.metrics.picture_quality import ColorQuality, mean_color_quality
from threedvc.units import MILLIMETERS

__all__ = [
    "AV1_CRF",
    "AV1_SCALES",
    "COLOR",
    "DEPTH",
    "JUDGED",
    "RUNS",
    "Point",
    "Recording",
    "Score",
    "Store",
    "av1_codec",
    "av1_point",
    "av1_points",
    "av1_version",
    "config_of",
    "equals",
    "file_name",
    "ladder",
    "scored",
    "source_digest",
    "threedvc_points",
]

COLOR, DEPTH = "psnr_rgb", "depth_within_1pct"
"""The measures by which curves are compared."""
JUDGED = {"color": COLOR, "depth": DEPTH}
"""Which of them is for which kind of pictures."""

RATES = (8.0, 32.0, 128.0, 500.0)
"""Rates in kbit/s of a sequence that `RUNS` does not name: from where models alone are to a good video."""
HIGH_RATES = (32.0, 64.0, 96.0, 256.0, 1000.0)
"""Of noisy real cameras at 640x480, whose noise alone takes more."""
RUNS = (
    Run(sequence="paper_cow", options="--segment depth:0.1m..1.2m --motion known", rates=(3.0, 7.0, 24.0, 80.0)),
    Run(sequence="cow_turn", options="--segment masks --motion known", rates=(6.0, 13.0, 40.0, 128.0)),
    Run(sequence="two_toys", options="--segment masks --motion known", rates=(16.0, 34.0, 80.0, 256.0)),
    Run(sequence="room_orbit", options="--segment none --motion known", rates=(16.0, 28.0, 80.0, 256.0)),
    Run(sequence="kitchen300", options="--motion known", rates=(16.0, 28.0, 44.0, 78.0, 140.0, 500.0)),
    Run(sequence="fr1_rpy", options="--motion known", rates=HIGH_RATES),
    Run(sequence="realsense_desk", options="--max-depth 4m", rates=HIGH_RATES),
    Run(sequence="iphone_door", options="--motion known", rates=(32.0, 87.0, 180.0, 500.0)),
    Run(sequence="cereal_box", options="--segment masks --motion track", rates=RATES),
    Run(sequence="hands_table", rates=(14.4, 26.25, 64.0, 256.0)),
)
"""How sequences are encoded here, and at which rates in kbit/s: each point takes minutes."""
AV1_CRF = (70, 64, 58, 50, 40, 30, 20, 12, 6, 1)
"""Constant rate factors from the coarsest to the finest."""
AV1_SCALES = (1, 2, 4, 8)
"""Parts of the size at which AV1 may work: small pictures win at low rates, and the hull over all is its best."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """One measured point of a curve.

    Attributes
    ----------
    setting
        The codec's setting in words.
    size
        Bytes.
    quality
        Measures under their names in the JSON report of ``3dvc stats``.
    """

    setting: str
    size: int
    quality: dict[str, float]


@dataclass(kw_only=True)
class Score:
    """Measures of decoded pictures, as they accumulate.

    Attributes
    ----------
    depth_scale
        Units per meter of the depth pictures, in which depth is compared.
    """

    depth_scale: float
    _color: list[ColorQuality] = field(default_factory=list)
    _depth: list[DepthErrors] = field(default_factory=list)

    def add_color(self, given: NDArray[np.uint8], seen: NDArray[np.uint8]) -> None:
        """Compare two RGB pictures (h, w, 3)."""
        self._color.append(ColorQuality.measure(given, seen))

    def add_depth(self, given: Plane, seen: Plane) -> None:
        """Compare two depth pictures (h, w) in meters, 0 = no depth."""
        units = [depth_units(depth, self.depth_scale) for depth in (given, seen)]
        errors = DepthErrors.measure(units[0], units[1], MILLIMETERS / self.depth_scale)
        self._depth = [self._depth[0] + errors] if self._depth else [errors]

    def quality(self) -> dict[str, float]:
        """Return the measures of what was added."""
        color = asdict(mean_color_quality(self._color)) if self._color else {}
        return color | (self._depth[0].quality() if self._depth else {})


@dataclass(frozen=True)
class Recording:
    """A sequence, as far as it is measured, and how 3dvc encodes it.

    Attributes
    ----------
    folder
        Its folder.
    run
        Options of ``3dvc encode``, from the table of recorded sequences.
    limit
        Number of frames at most, or None.
    """

    folder: Path
    run: Run
    limit: int | None = None

    @classmethod
    def of(cls, folder: Path, limit: int | None = None) -> Recording:
        """Take the run that names the folder, or the encoder's own choices at `RATES`."""
        name = folder.resolve().name
        return cls(folder, next((run for run in RUNS if run.sequence == name), Run(sequence=name, rates=RATES)), limit)

    @cached_property
    def frames(self) -> FolderSequence:
        """The frames as recorded, against which everything is scored."""
        return self._opened(None)

    @property
    def info(self) -> SequenceInfo:
        """What holds for every frame."""
        return self.frames.info

    @property
    def seconds(self) -> float:
        """Length of what is measured."""
        return len(self.frames) / self.info.fps

    @cached_property
    def config(self) -> EncoderConfig:
        """The encoder's choices."""
        return config_of(self.run.options)

    @cached_property
    def depth_range(self) -> tuple[float, float]:
        """Smallest and largest depth of all frames in meters."""
        measured = [depth[depth > 0] for depth in self.depths()]
        ends = [(float(depth.min()), float(depth.max())) for depth in measured if len(depth)]
        return min((near for near, _ in ends), default=1.0), max((far for _, far in ends), default=1.0)

    def colors(self) -> Iterator[NDArray[np.uint8]]:
        """Yield the RGB pictures."""
        return (frame.color for frame in self.frames)

    def depths(self) -> Iterator[Plane]:
        """Yield the depth pictures in meters."""
        return (frame.depth for frame in self.frames)

    def encoder_frames(self) -> FolderSequence:
        """Return the frames as the encoder takes them in."""
        return self._opened(self.config.max_depth_m)

    def encode(self, stream: Path, config: EncoderConfig) -> int:
        """Encode with 3dvc and return the bytes of the file."""
        return threedvc.encode(self._opened(config.max_depth_m), stream, config).file_bytes

    def _opened(self, max_depth_m: float | None) -> FolderSequence:
        frames = open_sequence(self.folder, max_depth_m=max_depth_m)
        if self.limit is None or self.limit >= len(frames):
            return frames
        return open_sequence(self.folder, max_depth_m=max_depth_m, frames=(0, self.limit, None))


def config_of(options: str) -> EncoderConfig:
    """Return the encoder's choices that options of ``3dvc encode`` make."""
    given = command.commands["encode"].make_context("encode", ["in", "out.3dvc", *shlex.split(options)]).params
    chosen = {each.name: given[each.name] for each in fields(EncodeRequest)}
    return EncodeRequest(**chosen).configuration(1)


def ladder(config: EncoderConfig, rates: Sequence[float]) -> list[EncoderConfig]:
    """Return choices with given rates in kbit/s."""
    return [replace(config, bitrate_bps=1000 * rate) for rate in rates]


@dataclass(frozen=True)
class Store:
    """Points that were measured before, one JSON file each.

    Attributes
    ----------
    folder
        Where they lie.
    reuse
        Take points of other versions of a codec, too.
    """

    folder: Path
    reuse: bool = False

    def place(self, recording: Recording, name: str) -> Path:
        """Return the file of a point of a recording, by the name of codec and setting; its folder is made."""
        place = self.folder / f"{recording.run.sequence}-{len(recording.frames)}" / f"{name}.json"
        place.parent.mkdir(parents=True, exist_ok=True)
        return place

    def point(self, place: Path, version: str, measure: Callable[[], Point]) -> Point:
        """Return the point in a file; measure it where it is missing or of another version of the codec."""
        if place.is_file():
            kept = json.loads(place.read_text(encoding="utf-8"))
            if self.reuse or kept["version"] == version:
                return Point(**kept["point"])
        point = measure()
        written = place.with_suffix(".part")
        written.write_text(json.dumps({"version": version, "point": asdict(point)}, indent=1), encoding="utf-8")
        written.replace(place)
        return point


def source_digest() -> str:
    """Return a digest of the codec's sources: the version of a point of 3dvc."""
    digest = hashlib.sha256()
    for path in sorted(path for folder in ("threedvc", "formats") for path in (REPOSITORY / folder).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def threedvc_points(recording: Recording, store: Store) -> Iterator[Point]:
    """Yield the points of 3dvc, coarse to fine."""
    version = source_digest()
    for rate, config in zip(recording.run.rates, ladder(recording.config, recording.run.rates), strict=True):
        setting = f"{rate:g} kbit/s"
        place = store.place(recording, file_name(f"3dvc {recording.run.options} {setting}"))
        measure = partial(_ours, recording, config, setting, place.with_suffix(".3dvc"))
        yield store.point(place, version, measure)


def file_name(words: str) -> str:
    """Return words as the name of a file."""
    return "".join(sign if sign.isalnum() or sign in ".-" else "_" for sign in words)


def _ours(recording: Recording, config: EncoderConfig, setting: str, stream: Path) -> Point:
    size = recording.encode(stream, config)
    return Point(setting=setting, size=size, quality=scored(recording, stream))


def scored(recording: Recording, stream: Path) -> dict[str, float]:
    """Return the quality of a stream, held against the frames as recorded."""
    score = Score(depth_scale=recording.info.depth_scale)
    for given, seen in zip(recording.frames, threedvc.decode(stream), strict=True):
        score.add_color(given.color, seen.color)
        score.add_depth(given.depth, seen.depth)
    return score.quality()


def av1_points(recording: Recording, store: Store, kind: str, enough: Callable[[Point], bool]) -> Iterator[Point]:
    """Yield the points of AV1 for one kind of pictures, ``color`` or ``depth``: of each size, from coarse to fine.

    A size goes no further than to the first point that is good `enough`, or that a smaller one of a larger size equals:
    small pictures win nothing by finer coding from there on.
    """
    larger: list[Point] = []
    for scale in AV1_SCALES:
        found: list[Point] = []
        for crf in AV1_CRF:
            point = av1_point(recording, store, kind, scale, crf)
            yield point
            found.append(point)
            if enough(point) or any(equals(other, point, JUDGED[kind]) for other in larger):
                break
        larger += found


def av1_point(recording: Recording, store: Store, kind: str, scale: int, crf: int) -> Point:
    """Return one point of AV1 for one kind of pictures, ``color`` or ``depth``."""
    codec = av1_codec(recording, kind, scale, crf)
    measure = {"color": _av1_color, "depth": _av1_depth}[kind]
    place = store.place(recording, f"av1-{kind}-preset{codec.preset}-scale{scale}-crf{crf}")
    return store.point(place, av1_version(), partial(measure, recording, codec))


def av1_codec(recording: Recording, kind: str, scale: int, crf: int) -> VideoCodec:
    """Return AV1 at one setting for the pictures of a recording."""
    camera = getattr(recording.info.rig, kind)
    return VideoCodec(width=camera.width, height=camera.height, fps=recording.info.fps, crf=crf, scale=scale)


def av1_version() -> str:
    """Return which libraries a point of AV1 is from."""
    return f"PyAV {library().__version__}, libavcodec {library().library_versions['libavcodec']}"


def equals(other: Point, point: Point, measure: str) -> bool:
    """Tell whether a point is as good as another by one measure, with no more bytes."""
    return other.size <= point.size and other.quality[measure] >= point.quality[measure]


def _av1_setting(codec: VideoCodec) -> str:
    return f"crf {codec.crf}" + (f", 1/{codec.scale} size" if codec.scale > 1 else "")


def _av1_color(recording: Recording, codec: VideoCodec) -> Point:
    gray = recording.info.gray
    coded = codec.encode_color(recording.colors(), gray)
    score = Score(depth_scale=recording.info.depth_scale)
    for given, seen in zip(recording.colors(), codec.decode_color(coded, gray), strict=True):
        score.add_color(given, seen)
    return Point(setting=_av1_setting(codec), size=coded.size, quality=score.quality())


def _av1_depth(recording: Recording, codec: VideoCodec) -> Point:
    mapping = InverseDepth.covering(*recording.depth_range)
    coded = codec.encode_depth(recording.depths(), mapping)
    score = Score(depth_scale=recording.info.depth_scale)
    for given, seen in zip(recording.depths(), codec.decode_depth(coded, mapping), strict=True):
        score.add_depth(given, seen)
    return Point(setting=_av1_setting(codec), size=coded.size, quality=score.quality())
