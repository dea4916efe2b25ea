# SPDX-License-Identifier: MIT
"""Bad folders and pictures: one line that names the file, the value and the remedy."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.damaged_recording import FRAMES, edit_intrinsics, message, write_sound_recording
from helpers.recorded_room import SMALL, color_picture, poses, write_picture
from threedvc.errors import SequenceError
from threedvc.formats.sources import layout_names, open_sequence


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a sound recording in the plain layout, for a test to damage."""
    return write_sound_recording(tmp_path / "recording")


def test_sound_recording_opens(recording: Path) -> None:
    assert len(open_sequence(recording)) == FRAMES


def test_missing_folder(tmp_path: Path) -> None:
    absent = tmp_path / "absent"
    assert message(absent) == f"{absent}: no such folder; give the folder of an RGB-D recording"


def test_file_instead_of_folder(recording: Path) -> None:
    path = recording / "intrinsics.json"
    assert message(path) == f"{path}: is a file; give the folder of an RGB-D recording"


def test_unknown_layout_name(recording: Path) -> None:
    assert message(recording, layout="bundle") == (
        f"--layout bundle: no such layout; choose one of {', '.join(layout_names())}"
    )
    assert layout_names()[:3] == ("auto", "7scenes", "bare")


def test_unrecognized_folder(tmp_path: Path) -> None:
    assert message(tmp_path) == (
        f"{tmp_path}: is in no layout that 3dvc knows; name it with --layout, or give --color DIR and --depth DIR"
    )


def test_folder_above_the_recording(recording: Path) -> None:
    above = recording.parent
    assert message(above) == f"{above}: is not a recording, but {recording} looks like one; give that folder"


def test_folders_given_for_a_layout_that_finds_its_own(recording: Path) -> None:
    assert message(recording, layout="tum", color="color") == (
        "--layout tum: finds its pictures itself; leave out --color and --depth"
    )


def test_missing_color_folder(recording: Path) -> None:
    shutil.rmtree(recording / "color")
    assert message(recording) == f"{recording / 'color'}: no such folder of pictures; give it with --color DIR"


def test_given_folder_missing(recording: Path) -> None:
    assert message(recording, layout="bare", color="nowhere") == (
        f"{recording / 'nowhere'}: no such folder of pictures; give it with --color DIR"
    )


def test_empty_color_folder(recording: Path) -> None:
    shutil.rmtree(recording / "color")
    (recording / "color").mkdir()
    assert message(recording) == f"{recording / 'color'}: holds no .png or .jpg picture; give the folder that does"


def test_color_without_depth(recording: Path) -> None:
    (recording / "depth" / "000002.png").unlink()
    assert message(recording) == (
        f"{recording / 'color' / '000002.png'}: has no depth picture in {recording / 'depth'} "
        "(4 color and 3 depth pictures); add the missing picture or remove this one"
    )


def test_depth_without_color(recording: Path) -> None:
    (recording / "color" / "000001.png").unlink()
    assert message(recording) == (
        f"{recording / 'depth' / '000001.png'}: has no color picture in {recording / 'color'} "
        "(3 color and 4 depth pictures); add the missing picture or remove this one"
    )


def test_two_pictures_of_one_frame(recording: Path) -> None:
    shutil.copy(recording / "color" / "000001.png", recording / "color" / "000001.jpg")
    assert message(recording) == (
        f"{recording / 'color' / '000001.png'}: no number in its name tells it from 000001.jpg; keep one of the two"
    )


def test_counts_that_do_not_pair(recording: Path) -> None:
    color, depth = recording / "color", recording / "depth"
    for k in range(FRAMES - 1):
        (depth / f"{k:06d}.png").rename(depth / f"{k + 90:06d}.png")
    (depth / "000003.png").unlink()
    assert message(recording) == (
        f"{color / '000000.png'}: has no depth picture in {depth}, and 000090.png there no color picture "
        "(4 color and 3 depth pictures, 0 of their names agree); give the two pictures of a frame the same number"
    )


def test_name_without_frame_number(recording: Path) -> None:
    for kind in ("color", "depth"):
        (recording / kind / "000003.png").rename(recording / kind / "shot3.png")
    assert message(recording) == (
        f"{recording / 'color' / 'shot3.png'}: is not named by its frame number (NNNNNN); "
        "rename it or choose --layout bare"
    )


def test_8_bit_depth(recording: Path) -> None:
    path = recording / "depth" / "000001.png"
    write_picture(path, np.full((48, 64), 90, np.uint8))
    assert message(recording) == (
        f"{path}: depth is 8-bit of 1 channel, expected 16-bit of 1 channel; convert it to 16-bit PNG"
    )


def test_three_channel_depth(recording: Path) -> None:
    path = recording / "depth" / "000000.png"
    write_picture(path, np.full((48, 64, 3), 900, np.uint16))
    assert message(recording) == (
        f"{path}: depth is 16-bit of 3 channels, expected 16-bit of 1 channel; convert it to 16-bit PNG"
    )


def test_16_bit_color(recording: Path) -> None:
    path = recording / "color" / "000003.png"
    write_picture(path, np.full((48, 64, 3), 900, np.uint16))
    assert message(recording) == (
        f"{path}: color is 16-bit of 3 channels, expected 8-bit gray or RGB; convert the pictures to 8 bits"
    )


def test_wrong_mask(recording: Path) -> None:
    for k in range(FRAMES):
        write_picture(recording / "masks" / f"{k:06d}.png", np.zeros((48, 64, 3), np.uint8))
    assert message(recording) == (
        f"{recording / 'masks' / '000000.png'}: mask is 8-bit of 3 channels, "
        "expected 8-bit labels of 1 channel; convert the masks"
    )


def test_mask_missing(recording: Path) -> None:
    write_picture(recording / "masks" / "000001.png", np.zeros((48, 64), np.uint8))
    assert message(recording) == (
        f"{recording / 'masks'}: no mask for frame 0, the first (1 for 4 frames); add it or remove masks"
    )


@pytest.mark.parametrize("kind", ["color", "depth"])
def test_size_changes(recording: Path, kind: str) -> None:
    path = recording / kind / "000002.png"
    write_picture(path, np.full((24, 32), 90, np.uint16 if kind == "depth" else np.uint8))
    assert message(recording) == f"{path}: is 32x24, but 000000.png is 64x48; bring all pictures to one size"


def test_size_differs_from_intrinsics(recording: Path) -> None:
    edit_intrinsics(recording, width=60, height=45)
    assert message(recording) == (
        f"{recording / 'color' / '000000.png'}: is 64x48, but the intrinsics are for 60x45; "
        "give --intrinsics FILE or fx,fy,cx,cy of this size"
    )


def test_picture_vanishes(recording: Path) -> None:
    path = recording / "color" / "000001.png"
    path.unlink()
    path.symlink_to(recording / "gone.png")
    assert message(recording) == f"{path}: no such picture; add it or remove the frame from the recording"


def test_not_a_picture(recording: Path) -> None:
    path = recording / "color" / "000001.png"
    path.write_bytes(b"<!doctype html>")
    assert message(recording) == (
        f"{path}: unreadable picture (neither PNG nor JPEG); restore the file or leave its frame out"
    )


@pytest.mark.parametrize("kind", ["color", "depth"])
def test_truncated_png_is_reported_with_its_frame(
    recording: Path, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = recording / kind / "000002.png"
    path.write_bytes(path.read_bytes()[:-40])
    sequence = open_sequence(recording)
    frames = iter(sequence)
    assert [next(frames).index, next(frames).index] == [0, 1]
    with pytest.raises(SequenceError) as caught:
        next(frames)
    assert str(caught.value) == (
        f"{path}: unreadable picture (truncated PNG of {path.stat().st_size} bytes); "
        "restore the file or leave its frame out"
    )
    assert capfd.readouterr() == ("", "")


def test_flipped_byte_in_png(recording: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = recording / "depth" / "000003.png"
    data = bytearray(path.read_bytes())
    data[60] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(SequenceError, match=r"depth/000003\.png: unreadable picture \(checksum error at byte 33\); "):
        open_sequence(recording)[3]
    assert capfd.readouterr() == ("", "")


def to_jpeg(recording: Path, change: Callable[[bytes], bytes]) -> Path:
    path = recording / "color" / "000001.jpg"
    data = cv2.imencode(".jpg", color_picture(SMALL, poses(1)[0]))[1].tobytes()
    (recording / "color" / "000001.png").unlink()
    path.write_bytes(change(data))
    return path


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda data: data[:-30], "truncated JPEG of "),
        (lambda data: data[:-2], "truncated JPEG of "),
        (lambda data: data[:-40] + b"\xff\xd3" + data[-40:], "damaged JPEG at byte |truncated JPEG of "),
    ],
)
def test_damaged_jpeg(
    recording: Path, change: Callable[[bytes], bytes], why: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = to_jpeg(recording, change)
    sequence = open_sequence(recording)
    with pytest.raises(SequenceError, match=rf"{path}: unreadable picture \({why}"):
        sequence[1]
    assert capfd.readouterr() == ("", "")


def test_sound_jpeg(recording: Path) -> None:
    to_jpeg(recording, bytes)
    assert open_sequence(recording)[1].color.shape == (48, 64, 3)
