# SPDX-License-Identifier: MIT
"""What tasks are done with: a recording as it is, and as it comes out of 3dvc and of AV1 pairs of the same size.

What was coded lies in folders of the plain layout, depth as 16-bit PNG, and is made anew when the codec changes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from planes import InverseDepth
from rd_points import (
    AV1_CRF,
    AV1_SCALES,
    JUDGED,
    Point,
    Recording,
    Store,
    av1_codec,
    av1_point,
    av1_version,
    equals,
    file_name,
    source_digest,
)
from threedvc.errors import SequenceError
from threedvc.formats.decoding import DecodedStream, open_stream
from threedvc.formats.sinks.plain import DECODE, SYNTH, PlainSink
from threedvc.formats.sources import FolderSequence, open_sequence
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.synthesis.scenes import make_scene
from threedvc.synthesis.sequence import SyntheticSequence

__all__ = ["NOISE", "RAW", "Version", "best_pair", "check_recording", "made_scene", "raw_bytes", "scene_of", "versions"]

RAW = "raw"
NOISE = "kinect"
"""Of synthetic depth: tasks are to be done with what a sensor tells, not with the truth."""
SCENE_SIZE = 320, 240
DEPTH_BYTES, COLOR_BYTES = 2, 3
"""Of a pixel, uncompressed."""
MADE = "made.json"
"""Beside the folder of what was coded: by which codec, and how large it was."""


@dataclass(frozen=True, kw_only=True)
class Version:
    """A recording as it comes out of a codec.

    Attributes
    ----------
    name
        As in tables.
    codec
        Which codec it is from, and of which version.
    size
        Bytes.
    frames
        The frames; poses are those of the recording.
    setting
        What the codec was told.
    """

    name: str
    codec: str
    size: int
    frames: FolderSequence = field(repr=False)
    setting: str = ""


def check_recording(recording: Recording) -> None:
    """Refuse what tasks cannot be done with.

    Raises
    ------
    SequenceError
        If a recording has no camera poses, or its color pictures are not those of its depth camera.
    """
    info = recording.info
    if not info.has_camera_poses:
        raise SequenceError(f"{recording.folder}: has no poses of the camera, against which tasks are scored")
    color, depth = info.rig.color, info.rig.depth
    if (color.width, color.height) != (depth.width, depth.height):
        raise SequenceError(f"{recording.folder}: color and depth are not of one size, as tasks need them")


def raw_bytes(info: SequenceInfo, frames: int) -> int:
    """Return the bytes of frames of RGB color and 16-bit depth, uncompressed."""
    color, depth = info.rig.color, info.rig.depth
    return frames * (color.width * color.height * COLOR_BYTES + depth.width * depth.height * DEPTH_BYTES)


def scene_of(name: str, frames: int, noise: str) -> SyntheticSequence:
    """Return a scene of `3dvc synth`; its `picture` has exact depth."""
    return SyntheticSequence(make_scene(name, frames=frames, size=SCENE_SIZE), noise)


def made_scene(name: str, frames: int, cache: Path) -> Path:
    """Return the folder of a scene with the noise of a sensor; it is made where it is not there."""
    folder = cache / f"synth_{name}"
    place = cache / f"synth_{name}-{frames}" / folder.name
    sequence = scene_of(name, frames, NOISE)
    _made(place, source_digest(), SYNTH, lambda: (0, "", sequence.info, iter(sequence)))
    return place


def versions(recording: Recording, ratios: Iterable[int], store: Store) -> Iterator[Version]:
    """Yield a recording as it is, then for each ratio to its raw size as 3dvc and an AV1 pair give it back."""
    size = raw_bytes(recording.info, len(recording.frames))
    yield Version(name=RAW, codec=RAW, size=size, frames=recording.frames)
    for ratio in ratios:
        ours = _threedvc(recording, ratio, size / ratio, store)
        yield ours
        yield _av1(recording, ratio, ours.size, store)


Coded = tuple[int, str, SequenceInfo, Iterable[Frame]]
"""Bytes, what the codec was told, and the decoded frames."""


def _threedvc(recording: Recording, ratio: int, budget: float, store: Store) -> Version:
    name = f"3dvc 1:{ratio}"
    place = store.place(recording, file_name(f"{name} {recording.run.options}")).with_suffix("")
    config = replace(recording.config, bitrate_bps=8 * budget / recording.seconds)

    def code() -> Coded:
        stream = place.with_name(f"{place.name}.3dvc")
        size = recording.encode(stream, config)
        decoded = open_stream(stream)
        return size, f"{config.bitrate_bps / 1000:.0f} kbit/s", decoded.info, _as_frames(recording, decoded)

    return _version(name, place, f"3dvc {source_digest()}", recording, code)


def _av1(recording: Recording, ratio: int, budget: int, store: Store) -> Version:
    name = f"AV1 1:{ratio}"
    place = store.place(recording, file_name(f"{name} {recording.run.options}")).with_suffix("")

    def code() -> Coded:
        point = partial(av1_point, recording, store)
        color, depth = best_pair(point, budget)
        setting = f"color crf {color[1]}, 1/{color[0]} size; depth crf {depth[1]}, 1/{depth[0]} size"
        size = point("color", *color).size + point("depth", *depth).size
        return size, setting, recording.info, _pair_frames(recording, color, depth)

    return _version(name, place, f"{av1_version()}, {budget} bytes", recording, code)


def _as_frames(recording: Recording, decoded: DecodedStream) -> Iterator[Frame]:
    with closing(decoded):
        for given, seen in zip(recording.frames, decoded, strict=True):
            yield replace(given, color=seen.color, depth=seen.depth, mask=None, T_camera_object={})


def _pair_frames(recording: Recording, color: tuple[int, int], depth: tuple[int, int]) -> Iterator[Frame]:
    gray = recording.info.gray
    of_color, of_depth = av1_codec(recording, "color", *color), av1_codec(recording, "depth", *depth)
    mapping = InverseDepth.covering(*recording.depth_range)
    colors = of_color.decode_color(of_color.encode_color(recording.colors(), gray), gray)
    depths = of_depth.decode_depth(of_depth.encode_depth(recording.depths(), mapping), mapping)
    for frame, picture, seen in zip(recording.frames, colors, depths, strict=True):
        yield replace(frame, color=picture, depth=seen, mask=None, T_camera_object={})


Setting = tuple[int, int]
"""Part of the size, and constant rate factor."""


def best_pair(point: Callable[[str, int, int], Point], budget: int) -> tuple[Setting, Setting]:
    """Return settings of AV1 for color and for depth whose sum is within a number of bytes.

    Depth may have half of them, color what depth leaves.

    Parameters
    ----------
    point
        Measures AV1 by the kind of pictures, the part of their size and the constant rate factor.
    budget
        Bytes.
    """
    depth = best_setting(partial(point, "depth"), JUDGED["depth"], budget / 2)
    color = best_setting(partial(point, "color"), JUDGED["color"], budget - point("depth", *depth).size)
    return color, depth


def best_setting(point: Callable[[int, int], Point], measure: str, budget: float) -> Setting:
    """Return the setting of the best quality within a number of bytes, or the smallest if none is within.

    All sizes of pictures are tried, as far as finer coding is within the budget and not beaten by that of larger
    pictures; for the best of them the constant rate factor is then narrowed down to one.
    """
    within: dict[Setting, Point] = {}
    for scale in AV1_SCALES:
        larger = list(within.values())
        for crf in AV1_CRF:
            found = point(scale, crf)
            if found.size > budget or any(equals(other, found, measure) for other in larger):
                break
            within[scale, crf] = found
    if not within:
        return AV1_SCALES[-1], AV1_CRF[0]
    scale, crf = max(within, key=lambda each: within[each].quality[measure])
    finer = max((each for each in AV1_CRF if each < crf), default=crf)
    while crf - finer > 1:
        middle = (crf + finer) // 2
        crf, finer = (middle, finer) if point(scale, middle).size <= budget else (crf, middle)
    return scale, crf


def _version(name: str, place: Path, codec: str, recording: Recording, code: Callable[[], Coded]) -> Version:
    size, setting = _made(place, codec, DECODE, code)
    frames = open_sequence(place)
    if len(frames) != len(recording.frames):
        raise SequenceError(f"{place}: has {len(frames)} frames, the recording {len(recording.frames)}")
    return Version(name=name, codec=codec, size=size, frames=frames, setting=setting)


def _made(place: Path, codec: str, writer: str, code: Callable[[], Coded]) -> tuple[int, str]:
    """Fill a folder with what was coded, unless this codec did before; return its bytes and setting."""
    made = place.with_name(f"{place.name}-{MADE}")
    if made.is_file():
        kept = json.loads(made.read_text(encoding="utf-8"))
        if kept["codec"] == codec:
            return kept["size"], kept["setting"]
        made.unlink()
    place.parent.mkdir(parents=True, exist_ok=True)
    size, setting, info, frames = code()
    with PlainSink(place, info, what={"color", "depth"}, writer=writer) as sink:
        for frame in frames:
            sink.write_frame(frame)
    made.write_text(json.dumps({"codec": codec, "size": size, "setting": setting}, indent=1), encoding="utf-8")
    return size, setting
