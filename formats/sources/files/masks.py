# SPDX-License-Identifier: MIT
"""Which mask belongs to which frame, and whether its labels are those that somebody drew."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.errors import SequenceError
from threedvc.formats.sources.association import Pairing, list_pictures
from threedvc.formats.sources.names import times_in
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import FrameFiles

__all__ = ["MAX_LABEL", "Masks", "blends", "check_masks", "find_masks", "merged_labels", "unread_masks"]

FOLDERS = ("masks", "mask_visib", "mask")
OBJECT_MASK = re.compile(r"(\d{6})_(\d{6})")
"""Names of BOP's data sets: frame, and number of the object in it."""
MAX_LABEL = 255
"""8-bit masks have no larger ones."""
NUMBER = re.compile(r"\d+")
JPEG_MAGIC = b"\xff\xd8"
NO_JPEG = "JPEG does not keep labels; save the masks as 8-bit PNG"
RENAME = "name masks by their frame's number alone (000012.png), or FFFFFF_OOOOOO.png for one object each as BOP does"
PROBES = 3
"""Masks that are looked at for blends, spread over the recording: resizing spoils all alike."""
MIN_BLENDED = 20
"""Pixels of blends that are worth a word: fewer are no object."""
MOSTLY = 0.8
"""Share of a label's pixels that are blends from which the label is one."""


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


def find_masks(folder: Path, pairing: Pairing) -> Masks:
    """Find the masks of frames, in the first folder for masks that a recording has.

    A mask is named as the color or the depth picture of its frame, or has the frame's number or time in its name.

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
            raise SequenceError(f"{path}: {NO_JPEG}")
    stems = {path.stem: number for pair, number in zip(pairing.pairs, pairing.numbers, strict=True) for path in pair}
    matches = [OBJECT_MASK.fullmatch(path.stem) for path in paths]
    if all(matches) and not all(path.stem in stems for path in paths):
        return _object_masks(place, paths, pairing.numbers)
    masks = _frame_masks(paths, stems, pairing)
    _require_first(place, masks, pairing)
    return Masks(of_frames=masks)


def _require_first(place: Path, masks: Mapping[int, object], pairing: Pairing) -> None:
    first, count = pairing.numbers[0], len(pairing.numbers)
    if first not in masks:
        named = f"frame {first}" if pairing.unit is None else pairing.pairs[0][1].name
        raise SequenceError(
            f"{place}: no mask for {named}, the first ({len(masks)} for {count} frames); add it or remove {place.name}"
        )


def _frame_masks(paths: Sequence[Path], stems: Mapping[str, int], pairing: Pairing) -> dict[int, Path]:
    """Return one mask for each frame."""
    others = [path for path in paths if path.stem not in stems]
    found = _by_times(others, pairing) if pairing.unit else _by_numbers(paths, stems, pairing.numbers)
    masks: dict[int, Path] = {}
    for path in paths:
        number = stems.get(path.stem, found.get(path))
        if number is None:
            continue
        other = masks.setdefault(number, path)
        if other is not path:
            raise SequenceError(f"{path}: is a mask of frame {number}, as {other.name} is; keep one of the two")
    return masks


def _by_times(paths: Sequence[Path], pairing: Pairing) -> dict[Path, int]:
    """Return the frame of each mask that has the time of one in its name."""
    frames: dict[int, int] = {}
    for number, (stamp, color_stamp) in zip(pairing.numbers, pairing.stamps, strict=True):
        frames |= {stamp: number} if color_stamp is None else {stamp: number, color_stamp: number}
    found: dict[Path, int] = {}
    for path in paths:
        named = {frames[time] for time in times_in(path.stem, pairing.unit or "") if time in frames}
        if len(named) > 1:
            raise SequenceError(f"{path}: {len(named)} times in the name of a mask are those of frames; {RENAME}")
        found.update((path, number) for number in named)
    return found


def _by_numbers(paths: Sequence[Path], stems: Mapping[str, int], numbers: Sequence[int]) -> dict[Path, int]:
    """Return the number of each mask's frame; a name without a number is of none."""
    named = {path: NUMBER.findall(path.stem) for path in paths}
    shown = {text for stem in stems for text in NUMBER.findall(stem)}
    keys = [key for key in named.values() if key]
    column = _telling_column(keys, shown, set(numbers))
    for path, key in named.items():
        if key and path.stem not in stems and (column is None or len(key) != len(keys[0])):
            raise SequenceError(f"{path}: {len(key)} numbers in the name of a mask could be its frame's; {RENAME}")
    return {path: int(key[column]) for path, key in named.items() if column is not None and column < len(key)}


def _telling_column(keys: Sequence[Sequence[str]], shown: Set[str], numbers: Set[int]) -> int | None:
    """Return which number of the names is the frame's, or None if that cannot be told.

    It is the one that is not the same in all names; else that which is written as in the pictures' names (`shown`).
    """
    columns = list(zip(*keys, strict=False))
    if len(columns) <= 1:
        return 0 if columns else None
    alike = [sum(text in shown for text in column) * 2 > len(column) for column in columns]
    changing = [k for k, column in enumerate(columns) if len(set(column)) > 1]
    if len(changing) == 1:
        told = changing[0]
        elsewhere = any(same for k, same in enumerate(alike) if k != told)
        sure = alike[told] or not elsewhere or numbers <= set(map(int, columns[told]))
        return told if sure else None
    if alike.count(True) == 1:
        return alike.index(True)
    known = [k for k, column in enumerate(columns) if int(column[0]) in numbers] if len(keys) == 1 else []
    return known[0] if len(known) == 1 else None


def _object_masks(place: Path, paths: Sequence[Path], numbers: Sequence[int]) -> Masks:
    """Return a picture of each object in each frame; object k gets the label k + 1."""
    masks: dict[int, dict[int, Path]] = {}
    for path in paths:
        frame, number = map(int, NUMBER.findall(path.stem))
        if number + 1 > MAX_LABEL:
            raise SequenceError(
                f"{path}: object {number} is beyond the {MAX_LABEL} that labels tell apart; leave it out"
            )
        masks.setdefault(frame, {})[number + 1] = path
    if len(masks) == 1 and len(numbers) > 1 and {label - 1 for label in next(iter(masks.values()))} >= set(numbers):
        raise SequenceError(
            f"{paths[-1]}: is of frame {min(masks)} and object {numbers[-1]}, or of frame {numbers[-1]}; {RENAME}"
        )
    if numbers[0] not in masks:
        raise SequenceError(
            f"{place}: no mask for frame {numbers[0]}, the first ({len(masks)} for {len(numbers)} frames, named by "
            f"frame and object); add it or remove {place.name}"
        )
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


def check_masks(frames: Sequence[FrameFiles], read: Callable[[Path], NDArray[np.uint8]]) -> list[Notice]:
    """Look whether masks are labels as somebody drew them.

    Parameters
    ----------
    frames
        Files of the frames, some of which may have masks.
    read
        Returns labels (h, w); raises SequenceError.

    Raises
    ------
    SequenceError
        If a mask is a JPEG picture whatever its name says, or the mask of an object holds several labels.
    """
    paths = [frame.mask for frame in frames if frame.mask]
    for path in (*paths, *(path for frame in frames for path in frame.object_masks.values())):
        if _is_jpeg(path):
            raise SequenceError(f"{path}: {NO_JPEG}")
    places = {round(place) for place in np.linspace(0, len(paths) - 1, PROBES)} if paths else set()
    doubts = [_blend_doubt(paths[place], read) for place in sorted(places)]
    told = _object_doubts(frames[0].object_masks, read)
    return [*[doubt for doubt in doubts if doubt is not None][:1], *told]


def unread_masks(folder: Path, frames: Sequence[FrameFiles]) -> list[Notice]:
    """Tell that a recording has masks which its layout does not read."""
    if any(frame.mask or frame.object_masks for frame in frames):
        return []
    places = (folder / name for name in FOLDERS if any((folder / name).glob("*.png")))
    return [
        Notice(f"{place}: masks are not read in this layout; --layout bare or plain reads them") for place in places
    ]


def _is_jpeg(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(2) == JPEG_MAGIC
    except OSError:
        return False


def _blend_doubt(path: Path, read: Callable[[Path], NDArray[np.uint8]]) -> Notice | None:
    try:
        labels = read(path)
    except SequenceError:
        return None  # A damaged picture is reported when its frame is read.
    blended = blends(labels)
    count = int(np.count_nonzero(blended))
    if not count:
        return None
    total = np.bincount(labels.ravel(), minlength=256)
    made = np.flatnonzero(np.bincount(labels[blended], minlength=256) > MOSTLY * np.maximum(total, 1))
    which = f"{len(made)} of its {np.count_nonzero(total)} labels ({_listed(made.tolist())})" if len(made) else "labels"
    return Notice(
        f"{path}: {which} lie on {count} pixels ({count / labels.size:.1%}) of the outlines, between a lower and a "
        "higher label, as interpolation or JPEG leaves them, and each label is taken for an object; make the masks "
        "again without smoothing (nearest neighbor, 8-bit PNG)",
        warning=True,
    )


def _object_doubts(masks: Mapping[int, Path], read: Callable[[Path], NDArray[np.uint8]]) -> list[Notice]:
    """Tell whether the masks of a frame's objects overlap; raises SequenceError where one holds several labels."""
    covered: NDArray[np.int64] | None = None
    for path in masks.values():
        try:
            labels = read(path)
        except SequenceError:
            return []
        values = np.unique(labels[labels > 0])
        if len(values) > 1:
            raise SequenceError(
                f"{path}: holds {len(values)} labels ({_listed(values.tolist())}), but a name of frame and object is "
                f"that of a mask of one object (0 and 255); {RENAME}"
            )
        here = (labels > 0).astype(np.int64)
        covered = here if covered is None or covered.shape != here.shape else covered + here
    shared = 0 if covered is None else int(np.count_nonzero(covered > 1))
    if not shared:
        return []
    first = next(iter(masks.values()))
    return [
        Notice(
            f"{first}: masks of objects overlap on {shared} pixels of this frame, as amodal ones do; the lower number "
            "is taken to be in front; give the masks of what is visible (mask_visib) for another",
            warning=True,
        )
    ]


def blends(labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which pixels (h, w) interpolation has given a label between those of two neighbors; none if few are.

    Such a pixel has a lower and a higher label within two pixels, and no patch of its own label that is as wide. Masks
    as somebody drew them have a few of these, too, where three regions meet or a thin thing lies before two others; but
    there the steps over labels that exist elsewhere are far more. Interpolation leaves none of these steps.
    """
    wide, near = np.ones((5, 5), np.uint8), np.ones((3, 3), np.uint8)
    lowest, highest = cv2.erode(labels, wide), cv2.dilate(labels, wide)
    blended: NDArray[np.bool_] = (lowest < labels) & (labels < highest)
    core = lowest == highest
    for label in np.unique(labels[blended & cv2.dilate(core.astype(np.uint8), wide).astype(bool)]):
        patch = (core & (labels == label)).astype(np.uint8)
        blended &= ~((cv2.dilate(patch, wide) > 0) & (labels == label))
    rank = (np.cumsum(np.bincount(labels.ravel(), minlength=256) > 0) - 1).astype(np.uint8)[labels]
    low, high = np.asarray(cv2.erode(rank, near), np.uint8), np.asarray(cv2.dilate(rank, near), np.uint8)
    steps = (high.astype(int) - low >= 2) & ~_has_between(rank, low, high)
    count = np.count_nonzero(blended)
    few = count < MIN_BLENDED or count < np.count_nonzero(steps)
    return np.zeros_like(blended) if few else blended


def _has_between(rank: NDArray[np.uint8], low: NDArray[np.uint8], high: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where the 3x3 pixels about one (h, w) have a value between the lowest and the highest of them."""
    found = np.zeros(rank.shape, dtype=bool)
    height, width = rank.shape
    padded = np.pad(rank, 1, mode="edge")
    for dy in range(3):
        for dx in range(3):
            here = padded[dy : dy + height, dx : dx + width]
            found |= (low < here) & (here < high)
    return found
