# SPDX-License-Identifier: MIT
"""Masks: which frame each belongs to, masks of single objects, and labels that nobody drew."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.recorded_room import SMALL, color_picture, depth_picture, poses, write_picture
from threedvc.errors import SequenceError
from threedvc.formats.sources import FolderSequence, open_sequence
from threedvc.formats.sources.files.images import read_mask
from threedvc.formats.sources.files.masks import blends

FRAMES = 4
CAMERA = {"width": 64, "height": 48, "fx": 60.0, "fy": 61.0, "cx": 31.0, "cy": 24.5}
GIVEN = "60,61,31,24.5"
Labels = NDArray[np.uint8]


def record(folder: Path, names: Callable[[int], str]) -> Path:
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(folder / "color" / f"{names(k)}.png", color_picture(SMALL, pose))
        write_picture(folder / "depth" / f"{names(k)}.png", depth_picture(SMALL, pose, 1000))
    return folder


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a sound recording in the plain layout without masks."""
    (tmp_path / "intrinsics.json").write_text(json.dumps(CAMERA))
    return record(tmp_path, "{:06d}".format)


def drawn(frame: int) -> Labels:
    """Return labels that tell their frame: object 1 moves, object 2 stands."""
    labels = np.zeros((48, 64), np.uint8)
    labels[10:20, 5 + frame : 15 + frame] = 1
    labels[30:40, 40:60] = 2
    return labels


def add_masks(
    recording: Path, names: Callable[[int], str], frames: range = range(FRAMES), place: str = "masks"
) -> None:
    for k in frames:
        write_picture(recording / place / names(k), drawn(k))


def add_object_masks(recording: Path, name: str = "{:06d}_{:06d}.png", place: str = "masks") -> None:
    for k in range(FRAMES):
        for label in (1, 2):
            one = np.where(drawn(k) == label, 255, 0).astype(np.uint8)
            write_picture(recording / place / name.format(k, label - 1), one)


def check(sequence: FolderSequence) -> None:
    for k, frame in enumerate(sequence):
        assert frame.mask is not None
        assert np.array_equal(frame.mask, drawn(k))


def message(recording: Path, **options: str) -> str:
    with pytest.raises(SequenceError) as caught:
        open_sequence(recording, **options)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    "name", ["{:06d}.png", "{}.png", "mask_v2_{:06d}.png", "take1_{:04d}.png", "{:06d}_v2.png", "{:03d}.label.png"]
)
def test_masks_are_found_by_the_number_that_changes(recording: Path, name: str) -> None:
    add_masks(recording, name.format)
    sequence = open_sequence(recording)
    assert not sequence.notices
    check(sequence)


def test_versions_that_change_are_told_by_how_frames_are_written(recording: Path) -> None:
    add_masks(recording, lambda k: f"{k:06d}_v{k % 2 + 1}.png")
    check(open_sequence(recording))


@pytest.mark.parametrize("name", ["000000.png", "mask_v2_000000.png", "7_000000.png", "first0.png"])
def test_one_mask_of_the_first_frame(recording: Path, name: str) -> None:
    add_masks(recording, lambda _: name, range(1))
    masks = [frame.mask for frame in open_sequence(recording)]
    assert masks[0] is not None
    assert np.array_equal(masks[0], drawn(0))
    assert masks[1:] == [None] * 3


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["000000_1.png", "000000_2.png"], "000000_1.png: 2 numbers in the name of a mask could be its frame's; name"),
        (["0_1.png", "1_2.png", "2_1.png"], "0_1.png: 2 numbers in the name of a mask could be its frame's; name"),
        (["1_0.png"], "1_0.png: 2 numbers in the name of a mask could be its frame's; name masks by their frame's"),
        (["000000.png", "000001.png", "0.png"], "000000.png: is a mask of frame 0, as 0.png is; keep one of the two"),
        (["000000.png", "000000_v2.png", "000001.png"], "000000_v2.png: 2 numbers in the name of a mask could be"),
        (
            ["000001.png", "000002.png"],
            "masks: no mask for frame 0, the first (2 for 4 frames); add it or remove masks",
        ),
        (["mask.png"], "masks: no mask for frame 0, the first (0 for 4 frames); add it or remove masks"),
    ],
)
def test_masks_that_cannot_be_told(recording: Path, names: list[str], said: str) -> None:
    for name in names:
        write_picture(recording / "masks" / name, drawn(0))
    assert said in message(recording)


@pytest.mark.parametrize("place", ["masks", "mask_visib", "mask"])
def test_masks_of_single_objects(recording: Path, place: str) -> None:
    add_object_masks(recording, place=place)
    sequence = open_sequence(recording)
    check(sequence)
    assert sequence.info.has_masks
    assert [str(notice) for notice in sequence.notices] == [
        f"Note: {recording / place}: a mask for each of 2 objects, as BOP has them: they get the labels 1, 2"
    ]


def test_masks_of_single_objects_that_overlap(recording: Path) -> None:
    add_object_masks(recording)
    whole = np.full((48, 64), 255, np.uint8)
    write_picture(recording / "masks" / "000000_000001.png", whole)
    sequence = open_sequence(recording)
    assert np.array_equal(sequence[0].mask, np.where(drawn(0) == 1, 1, 2))
    doubt = sequence.notices[-1]
    assert doubt.warning
    assert "overlap on 100 pixels of this frame" in doubt.text


def test_names_of_frame_and_object_that_are_not(recording: Path) -> None:
    add_masks(recording, lambda k: f"{k:06d}_{k % 2:06d}.png")
    assert "000000_000000.png: holds 2 labels (1, 2), but a name of frame and object is" in message(recording)


def test_scene_and_frame_are_not_taken_for_frame_and_object(recording: Path) -> None:
    add_masks(recording, lambda k: f"000000_{k:06d}.png")
    assert "000000_000003.png: is of frame 0 and object 3, or of frame 3; name masks by" in message(recording)


def test_more_objects_than_labels(recording: Path) -> None:
    write_picture(recording / "masks" / "000000_000255.png", drawn(0))
    assert "000000_000255.png: object 255 is beyond the 255 that labels tell apart" in message(recording)


def test_object_masks_of_another_size(recording: Path) -> None:
    add_object_masks(recording)
    write_picture(recording / "masks" / "000002_000001.png", np.zeros((24, 32), np.uint8))
    assert "000002_000001.png: is 32x24, but 000000_000000.png is 64x48" in message(recording)


@pytest.mark.parametrize("name", ["000000.jpg", "000000.JPEG", "000000.png"])
def test_jpeg_keeps_no_labels(recording: Path, name: str) -> None:
    write_picture(recording / "masks" / "000001.png", drawn(1))
    (recording / "masks" / name).write_bytes(cv2.imencode(".jpg", drawn(0) * 100)[1].tobytes())
    assert message(recording) == (
        f"{recording / 'masks' / name}: JPEG does not keep labels; save the masks as 8-bit PNG"
    )


def test_bare_folders_have_masks(tmp_path: Path) -> None:
    record(tmp_path, "shot_{:03d}".format)
    add_masks(tmp_path, "m{}.png".format)
    check(open_sequence(tmp_path, intrinsics=GIVEN))


@pytest.mark.parametrize("mask_name", ["{}.png", "mask2_{}.png"])
@pytest.mark.parametrize(
    "name",
    [
        lambda k: str(round(5 + k / 30, 3)),
        lambda k: str(1700000000000000000 + 33333333 * k),
        lambda k: str(round(1000 * k / 30)),
    ],
)
def test_masks_of_frames_that_are_named_by_time(tmp_path: Path, name: Callable[[int], str], mask_name: str) -> None:
    record(tmp_path, name)
    add_masks(tmp_path, lambda k: mask_name.format(name(k)))
    check(open_sequence(tmp_path, intrinsics=GIVEN))
    (tmp_path / "masks" / mask_name.format(name(0))).unlink()
    assert f"no mask for {name(0)}.png, the first (3 for 4 frames)" in message(tmp_path, intrinsics=GIVEN)


def big(step: int) -> Labels:
    """Return two round objects on nothing, with labels that are `step` apart, and a thin one across both."""
    labels = np.zeros((120, 160), np.uint8)
    cv2.circle(labels, (60, 60), 30, 1 * step, -1)  # type: ignore[call-overload]
    cv2.circle(labels, (110, 60), 25, 2 * step, -1)  # type: ignore[call-overload]
    return labels


def shrunk(labels: Labels) -> Labels:
    return np.asarray(cv2.resize(labels, None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA), np.uint8)


def grown(labels: Labels) -> Labels:
    return np.asarray(cv2.resize(labels, None, fx=2.5, fy=2.5, interpolation=cv2.INTER_LINEAR), np.uint8)


def softened(labels: Labels) -> Labels:
    return np.asarray(cv2.GaussianBlur(labels, (3, 3), 0), np.uint8)


def from_jpeg(labels: Labels) -> Labels:
    return np.asarray(cv2.imdecode(cv2.imencode(".jpg", labels)[1], cv2.IMREAD_GRAYSCALE), np.uint8)


@pytest.mark.parametrize("step", [1, 100])
@pytest.mark.parametrize("change", [shrunk, grown, softened, from_jpeg])
def test_blends_are_found(step: int, change: Callable[[Labels], Labels]) -> None:
    assert np.count_nonzero(blends(change(big(step)))) >= 20


@pytest.mark.parametrize("step", [1, 50])
def test_thin_objects_and_meeting_regions_are_no_blends(step: int) -> None:
    labels = big(step)
    labels[:, 80:82] = 3 * step
    labels[58:60] = step
    cv2.line(labels, (0, 110), (159, 90), 2 * step, 1)  # type: ignore[call-overload]
    assert not blends(labels).any()
    assert not blends(np.asarray(labels[::2, ::2])).any()


def test_blends_are_told(recording: Path) -> None:
    for k in range(FRAMES):
        write_picture(recording / "masks" / f"{k:06d}.png", softened(drawn(k) * 100))
    (doubt,) = open_sequence(recording).notices
    assert doubt.warning
    assert doubt.text.startswith(f"{recording / 'masks' / '000000.png'}: ")
    assert "labels (25, 50, 75, " in doubt.text or "of its" in doubt.text
    assert "each label is taken for an object; make the masks again without smoothing" in doubt.text


@pytest.mark.parametrize("name", ["cereal_box", "cow_turn", "paper_cow", "two_toys", "room_orbit"])
def test_masks_of_recorded_sequences_are_no_blends(sequence_dir: Callable[[str], Path], name: str) -> None:
    masks = sorted((sequence_dir(name) / "masks").glob("*.png"))[::25]
    assert masks
    assert not any(blends(read_mask(path)).any() for path in masks)
