# SPDX-License-Identifier: MIT
"""Which colour picture belongs to which depth picture: by time, or by the numbers in the file names."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from pathlib import Path

from threedvc.errors import SequenceError

__all__ = ["PICTURE_SUFFIXES", "PicturePair", "associate", "list_pictures", "name_numbers", "pair_pictures"]

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
MAX_DIFFERENCE_NS = 20_000_000

Numbers = tuple[int, ...]
PicturePair = tuple[Path, Path]


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
        start = bisect_left(second, stamp - max_difference_ns)
        stop = bisect_right(second, stamp + max_difference_ns)
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
    """List the PNG and JPEG files of a folder, ordered by the numbers in their names, then by name."""
    try:
        pictures = [p for p in folder.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES and not p.name.startswith(".")]
    except OSError as error:
        raise SequenceError(f"{folder}: cannot be listed ({error.strerror}); check the folder") from None
    if not pictures:
        raise SequenceError(f"{folder}: holds no .png or .jpg picture; give the folder that does")
    return sorted(pictures, key=lambda path: (name_numbers(path), path.name))


def pair_pictures(color_folder: Path, depth_folder: Path) -> list[PicturePair]:
    """Pair the pictures of two folders by the numbers in their names, or in sorted order where no number agrees.

    Raises
    ------
    SequenceError
        If a folder is missing or empty, a picture has no partner, or two pictures have the same number.
    """
    colors = _by_numbers(color_folder)
    depths = _by_numbers(depth_folder)
    if colors.keys().isdisjoint(depths):
        return _pair_in_order(color_folder, list(colors.values()), depth_folder, list(depths.values()))
    _require_partners(colors, depths, f"depth picture in {depth_folder}")
    _require_partners(depths, colors, f"colour picture in {color_folder}")
    return [(path, depths[numbers]) for numbers, path in colors.items()]


def _by_numbers(folder: Path) -> dict[Numbers, Path]:
    pictures: dict[Numbers, Path] = {}
    for path in list_pictures(folder):
        other = pictures.setdefault(name_numbers(path), path)
        if other is not path:
            raise SequenceError(f"{path}: no number in its name tells it from {other.name}; keep one of the two")
    return pictures


def _require_partners(pictures: dict[Numbers, Path], partners: dict[Numbers, Path], what: str) -> None:
    for numbers, path in pictures.items():
        if numbers not in partners:
            raise SequenceError(f"{path}: has no {what}; add the missing picture or remove this one")


def _pair_in_order(color_folder: Path, colors: list[Path], depth_folder: Path, depths: list[Path]) -> list[PicturePair]:
    if len(colors) != len(depths):
        raise SequenceError(
            f"{color_folder}: {len(colors)} pictures do not pair with the {len(depths)} in {depth_folder}; "
            "give the two pictures of a frame the same number"
        )
    return list(zip(colors, depths, strict=True))
