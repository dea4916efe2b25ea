# SPDX-License-Identifier: MIT
"""Which mask belongs to which frame, and whether its labels are those that somebody drew."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.errors import SequenceError
from threedvc.formats.sources.association import list_pictures, name_numbers
from threedvc.formats.sources.notices import Notice

__all__ = ["Masks", "blended_labels", "check_masks", "find_masks", "merged_labels"]

FOLDERS = ("masks", "mask_visib", "mask")
OBJECT_MASK = re.compile(r"(\d{6})_(\d{6})")
"""Names of BOP's data sets: frame, and number of the object in it."""
MAX_LABEL = 255
JPEG_MAGIC = b"\xff\xd8"
RENAME = "name masks by their frame's number alone (000012.png), or FFFFFF_OOOOOO.png for one object each as BOP does"
PROBES = 3
MIN_BLENDED_LABELS = 2
"""One thin object may lie between two others everywhere; interpolation makes several values at every outline."""


@dataclass(frozen=True, eq=False)
class Masks:
    """The masks of a recording.

    Attributes
    ----------
    of_frames
        A picture of labels by the number of its frame.
    of_objects
        Where every object has pictures of its own: by number of frame, the picture of each label.
    notices
        What was decided.
    """

    of_frames: Mapping[int, Path] = field(default_factory=dict)
    of_objects: Mapping[int, Mapping[int, Path]] = field(default_factory=dict)
    notices: tuple[Notice, ...] = ()


def find_masks(folder: Path, numbers: Sequence[int]) -> Masks:
    """Find the masks of frames with these numbers, in the first folder for masks that a recording has.

    Raises
    ------
    SequenceError
        If a name could be of two frames, two masks are of one frame, the first frame has none, or masks are JPEG.
    """
    place = next((folder / name for name in FOLDERS if (folder / name).is_dir()), None)
    if place is None:
        return Masks()
    paths = list_pictures(place)
    for path in paths:
        if path.suffix.lower() != ".png":
            raise SequenceError(f"{path}: JPEG does not keep labels; save masks as 8-bit PNG")
    matches = [OBJECT_MASK.fullmatch(path.stem) for path in paths]
    if all(matches):
        return _object_masks(place, paths, numbers)
    masks = _frame_masks(paths, numbers)
    _require_first(place, masks, numbers)
    return Masks(of_frames=masks)


def _require_first(place: Path, masks: Mapping[int, object], numbers: Sequence[int]) -> None:
    if numbers[0] not in masks:
        raise SequenceError(
            f"{place}: no mask for frame {numbers[0]}, the first ({len(masks)} for {len(numbers)} frames); "
            "add it or remove masks"
        )


def _frame_masks(paths: Sequence[Path], numbers: Sequence[int]) -> dict[int, Path]:
    """Return one mask for each frame, by that number in their names which is not the same in all."""
    masks: dict[int, Path] = {}
    for path, number in zip(paths, _frame_numbers(paths, numbers), strict=True):
        if number is None:
            continue
        other = masks.setdefault(number, path)
        if other is not path:
            raise SequenceError(f"{path}: is a mask of frame {number}, as {other.name} is; keep one of the two")
    return masks


def _frame_numbers(paths: Sequence[Path], numbers: Sequence[int]) -> list[int | None]:
    """Return the number of each mask's frame, None for a name without a number."""
    named = [(path, name_numbers(path)) for path in paths]
    keys = [key for _, key in named if key]
    telling = [column for column in range(max(map(len, keys), default=0)) if _varies(keys, column)]
    if len(keys) == 1:
        telling = [column for column, number in enumerate(keys[0]) if len(keys[0]) == 1 or number in numbers]
    for path, key in named:
        if key and (len(telling) != 1 or len(key) <= telling[0]):
            raise SequenceError(f"{path}: {len(key)} numbers in the name of a mask could be its frame's; {RENAME}")
    return [key[telling[0]] if key else None for _, key in named]


def _varies(keys: Sequence[tuple[int, ...]], column: int) -> bool:
    return len({key[column] if column < len(key) else None for key in keys}) > 1


def _object_masks(place: Path, paths: Sequence[Path], numbers: Sequence[int]) -> Masks:
    """Return a picture of each object in each frame; object k gets the label k + 1."""
    masks: dict[int, dict[int, Path]] = {}
    for path in paths:
        frame, number = name_numbers(path)
        if number + 1 > MAX_LABEL:
            raise SequenceError(
                f"{path}: object {number} is beyond the {MAX_LABEL} that labels tell apart; leave it out"
            )
        masks.setdefault(frame, {})[number + 1] = path
    _require_first(place, masks, numbers)
    labels = sorted({label for frame in numbers for label in masks.get(frame, ())})
    told = Notice(
        f"{place}: a mask for each of {len(labels)} objects, as BOP has them: they get the labels {_listed(labels)}"
    )
    return Masks(of_objects=masks, notices=(told,))


def _listed(labels: Sequence[int]) -> str:
    shown = ", ".join(map(str, labels[:8]))
    return f"{shown}, ..." if len(labels) > 8 else shown


def merged_labels(masks: Mapping[int, Path], read: Callable[[Path], NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Return the labels (h, w) of masks that have an object each; where two overlap, the lower label counts."""
    labels: NDArray[np.uint8] | None = None
    for label, path in sorted(masks.items(), reverse=True):
        picture = read(path)
        labels = np.zeros_like(picture) if labels is None else labels
        if labels.shape != picture.shape:
            raise SequenceError(f"{path}: is of another size than the other masks of its frame; bring them to one size")
        labels[picture > 0] = label
    assert labels is not None
    return labels


def check_masks(paths: Sequence[Path], read: Callable[[Path], NDArray[np.uint8]]) -> list[Notice]:
    """Look at a few masks for labels that interpolation or JPEG made.

    Raises
    ------
    SequenceError
        If a mask is a JPEG picture whatever its name says.
    """
    places = np.unique(np.linspace(0, len(paths) - 1, PROBES).astype(int))
    for path in (paths[place] for place in places if paths):
        with path.open("rb") as file:
            if file.read(2) == JPEG_MAGIC:
                raise SequenceError(f"{path}: is JPEG, which does not keep labels; save masks as 8-bit PNG")
        labels = read(path)
        blended = blended_labels(labels)
        if len(blended) >= MIN_BLENDED_LABELS:
            count = int(np.isin(labels, blended).sum())
            return [
                Notice(
                    f"{path}: labels {_listed(blended)} are on {count} pixels ({count / labels.size:.1%}) that lie "
                    "between others, as resizing with interpolation leaves them; each is taken for an object: resize "
                    "masks to the nearest label",
                    warning=True,
                )
            ]
    return []


def blended_labels(labels: NDArray[np.uint8]) -> list[int]:
    """Return the labels that a picture (h, w) has only on pixels between a lower and a higher label."""
    around = np.ones((3, 3), np.uint8)
    lower, higher = cv2.erode(labels, around), cv2.dilate(labels, around)
    between = (lower < labels) & (labels < higher)
    return [int(label) for label in np.unique(labels) if between[labels == label].all()]
