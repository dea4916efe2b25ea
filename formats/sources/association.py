# SPDX-License-Identifier: MIT
"""Which color picture belongs to which depth picture: by time, or by the numbers in the file names."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

from threedvc.errors import SequenceError
from threedvc.formats.sources.names import NamedPictures, doubt_of_steps, in_unit_of, named_pictures
from threedvc.formats.sources.notices import Notice
from threedvc.units import NANOSECONDS

__all__ = [
    "PICTURE_SUFFIXES",
    "Pairing",
    "PicturePair",
    "associate",
    "left_out",
    "list_pictures",
    "name_numbers",
    "pair_named",
    "pair_pictures",
]

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
OTHER_PICTURES = {
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".npy": "NumPy arrays",
    ".npz": "NumPy arrays",
    ".exr": "OpenEXR",
    ".webp": "WebP",
    ".bmp": "Windows bitmaps",
    ".pgm": "portable gray maps",
    ".ppm": "portable pixel maps",
    ".pfm": "portable float maps",
    ".hdr": "Radiance",
    ".raw": "raw samples",
    ".bin": "raw samples",
    ".depth": "compressed depth of Record3D",
    ".heic": "HEIC",
    ".avif": "AVIF",
    ".gif": "GIF",
    ".mp4": "video",
    ".mkv": "video",
    ".avi": "video",
    ".ply": "point clouds",
    ".pcd": "point clouds",
}
CONVERT = "convert color to 8-bit PNG or JPEG, depth to 16-bit PNG, such as whole millimeters, 0 where there is none"
MAX_DIFFERENCE_MS = 20
"""Between partners: the usual choice for the TUM benchmark, and less than half an interval at 24 frames a second."""
MAX_CANDIDATES = 32
"""Partners that are looked at to each side of a stamp: a video has one or two within the time; times that are no
video's would take all memory."""
MAX_DIFFERENCE_NS = MAX_DIFFERENCE_MS * (NANOSECONDS // 1000)
"""The same in the unit of stamps."""

Numbers = tuple[int, ...]
PicturePair = tuple[Path, Path]


@dataclass(frozen=True, eq=False)
class Pairing:
    """Color and depth pictures that belong together, in order.

    Attributes
    ----------
    pairs
        Color and depth picture of each frame.
    numbers
        The number in the name of each frame's depth picture.
    stamps
        Where names are times: that of the depth picture in nanoseconds, and that of the color picture if it is
        another. Empty where names are numbers.
    notices
        What was decided.
    unit
        What names that are times are in, ``seconds`` for example.
    """

    pairs: Sequence[PicturePair]
    numbers: Sequence[int]
    stamps: Sequence[tuple[int, int | None]] = ()
    notices: tuple[Notice, ...] = ()
    unit: str | None = None


def associate(
    first: Sequence[int], second: Sequence[int], max_difference_ns: int = MAX_DIFFERENCE_NS
) -> list[tuple[int, int]]:
    """Pair two increasing lists of stamps, the nearest pairs first, each stamp at most once.

    Parameters
    ----------
    first, second
        Stamps in nanoseconds, increasing.
    max_difference_ns
        Stamps farther apart than this stay unpaired.

    Returns
    -------
    list of (int, int)
        Positions in `first` and in `second`, increasing.
    """
    candidates = []
    for i, stamp in enumerate(first):
        nearest = bisect_left(second, stamp)
        start = max(bisect_left(second, stamp - max_difference_ns), nearest - MAX_CANDIDATES)
        stop = min(bisect_right(second, stamp + max_difference_ns), nearest + MAX_CANDIDATES)
        candidates += [(abs(second[j] - stamp), i, j) for j in range(start, stop)]
    partners: dict[int, int] = {}
    taken = set()
    for _, i, j in sorted(candidates):
        if i not in partners and j not in taken:
            partners[i] = j
            taken.add(j)
    return sorted(partners.items())


def name_numbers(path: Path) -> Numbers:
    """Return all numbers in a file name: ``frame-000012.color.png`` gives ``(12,)``."""
    return tuple(int(digits) for digits in re.findall(r"\d+", path.stem))


def list_pictures(folder: Path) -> list[Path]:
    """List the PNG and JPEG files of a folder, ordered by the numbers in their names, then by name.

    Raises
    ------
    SequenceError
        If it cannot be listed or holds none; the message says what it holds instead.
    """
    try:
        files = [path for path in folder.iterdir() if not path.name.startswith(".")]
    except OSError as error:
        raise SequenceError(f"{folder}: cannot be listed ({error.strerror}); check the folder") from None
    pictures = [path for path in files if path.suffix.lower() in PICTURE_SUFFIXES]
    if not pictures:
        raise SequenceError(f"{folder}: holds no .png or .jpg picture{_instead(files)}")
    return sorted(pictures, key=lambda path: (name_numbers(path), path.name))


def _instead(files: Sequence[Path]) -> str:
    """Say what a folder without pictures holds, and what to do."""
    suffix, count = Counter(path.suffix.lower() for path in files).most_common(1)[0] if files else ("", 0)
    if suffix not in OTHER_PICTURES:
        return "; give the folder that does"
    return f" but {count} {suffix} files ({OTHER_PICTURES[suffix]}); {CONVERT}"


def pair_pictures(color_folder: Path, depth_folder: Path) -> Pairing:
    """Pair the pictures of two folders by what their names say: by time where they are times, else by number.

    Raises
    ------
    SequenceError
        If a folder is missing or empty, two pictures have the same number, the names of one folder are times and those
        of the other are not, numbers do not agree, or no times do.
    """
    colors, depths = (named_pictures(folder, list_pictures(folder)) for folder in (color_folder, depth_folder))
    return pair_named(colors, depths)


def pair_named(colors: NamedPictures, depths: NamedPictures) -> Pairing:
    """Pair pictures by what their names say; raises SequenceError as `pair_pictures` does."""
    colors, depths = in_unit_of(colors, depths), in_unit_of(depths, colors)
    if colors.unit_ns is not None and depths.unit_ns is not None:
        return _by_time(colors, depths)
    if not colors.numbered or not depths.numbered:
        return _in_order(colors, depths)
    _require_partners(colors, depths)
    pairs = [(path, depths.pictures[key]) for key, path in colors.pictures.items()]
    doubt = doubt_of_steps(depths)
    return Pairing(pairs, [key[-1] if key else 0 for key in colors.pictures], notices=(doubt,) if doubt else ())


def _in_order(colors: NamedPictures, depths: NamedPictures) -> Pairing:
    """Pair pictures without numbers in order of their names."""
    color_paths, depth_paths = list(colors.pictures.values()), list(depths.pictures.values())
    counts = f"{len(color_paths)} color and {len(depth_paths)} depth pictures"
    named = f"{color_paths[0].name} and {depth_paths[0].name}"
    if len(color_paths) != len(depth_paths) or colors.numbered or depths.numbered:
        raise SequenceError(
            f"{colors.folder}: names tell nothing that pairs these pictures with those in {depths.folder} ({counts}, "
            f"first {named}); give the two pictures of a frame the same number"
        )
    told = f"{colors.folder}: names have no numbers; paired with {depths.folder} in order of names ({named} first)"
    pairs = list(zip(color_paths, depth_paths, strict=True))
    return Pairing(pairs, list(range(len(pairs))), notices=(Notice(told),))


def _by_time(colors: NamedPictures, depths: NamedPictures) -> Pairing:
    """Pair pictures whose names are times."""
    color_paths, depth_paths = list(colors.pictures.values()), list(depths.pictures.values())
    color_times, depth_times = colors.times_ns, depths.times_ns
    matches = associate(color_times, depth_times)
    if not matches:
        raise SequenceError(
            f"{colors.folder}: names are times, and none is within {MAX_DIFFERENCE_MS} ms of one in {depths.folder} "
            f"({len(color_paths)} color and {len(depth_paths)} depth pictures, first {color_paths[0].name} and "
            f"{depth_paths[0].name}); check that both clocks and units agree"
        )
    notices = [Notice(f"{depths.folder}: the names are taken for times in {depths.unit}; {_interval(depth_times)}")]
    notices += left_out(len(color_paths), len(depth_paths), len(matches), str(depths.folder.parent))
    keys = list(depths.pictures)
    return Pairing(
        [(color_paths[i], depth_paths[j]) for i, j in matches],
        [keys[j][0] for _, j in matches],
        [(depth_times[j], None if color_times[i] == depth_times[j] else color_times[i]) for i, j in matches],
        tuple(notices),
        depths.unit,
    )


def _interval(times_ns: Sequence[int]) -> str:
    steps = [later - earlier for earlier, later in pairwise(times_ns)]
    return f"{median(steps) / 1e6:.4g} ms between frames" if steps else "one frame"


def left_out(colors: int, depths: int, pairs: int, place: str) -> list[Notice]:
    """Tell how many pictures have no partner in time, if any."""
    alone = max(colors, depths) - pairs
    if not alone:
        return []
    return [
        Notice(
            f"{place}: {colors} color, {depths} depth pictures, {pairs} pairs within {MAX_DIFFERENCE_MS} ms; "
            f"{alone} left out"
        )
    ]


def _require_partners(colors: NamedPictures, depths: NamedPictures) -> None:
    """Check that every picture has a partner of its number."""
    no_depth = [path for key, path in colors.pictures.items() if key not in depths.pictures]
    no_color = [path for key, path in depths.pictures.items() if key not in colors.pictures]
    if not no_depth and not no_color:
        return
    counts = f"{len(colors.pictures)} color and {len(depths.pictures)} depth pictures"
    if no_depth and no_color:
        agree = len(colors.pictures) - len(no_depth)
        raise SequenceError(
            f"{no_depth[0]}: has no depth picture in {depths.folder}, and {no_color[0].name} there no color picture "
            f"({counts}, {agree} of their names agree); give the two pictures of a frame the same number"
        )
    if no_depth:
        raise SequenceError(
            f"{no_depth[0]}: has no depth picture in {depths.folder} ({counts}); add the missing picture or remove "
            "this one"
        )
    raise SequenceError(
        f"{no_color[0]}: has no color picture in {colors.folder} ({counts}); add the missing picture or remove this one"
    )
