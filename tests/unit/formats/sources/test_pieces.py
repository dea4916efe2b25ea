# SPDX-License-Identifier: MIT
"""Pieces that the readers share: stamps, pairing, pose interpolation, picture decoding, read-ahead."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.recorded_room import SMALL, color_picture, depth_picture, poses, write_picture
from threedvc.errors import SequenceError
from threedvc.formats.sources.association import associate, list_pictures, name_numbers
from threedvc.formats.sources.files.images import PictureHeader, read_color, read_depth, read_header, read_mask
from threedvc.formats.sources.files.poses import interpolate_pose
from threedvc.formats.sources.files.timestamps import (
    fps_of_stamps,
    parse_nanoseconds,
    parse_stamp,
    rate_of,
    regular_stamp,
    to_nanoseconds,
)
from threedvc.formats.sources.recording import FrameFiles, Recording
from threedvc.formats.sources.sequence import FolderSequence
from threedvc.geometry.camera import CameraRig


@pytest.mark.parametrize(
    ("text", "stamp"),
    [
        ("1305031102.175304", 1305031102175304000),
        ("1305031102.175304001", 1305031102175304001),
        ("1700000000.123456789", 1700000000123456789),
        ("1341845948.6", 1341845948600000000),
        ("0", 0),
        ("-0.000000001", -1),
        ("1.3e3", 1300 * 10**9),
        ("0.0000000005", 0),
        ("0.0000000015", 2),
    ],
)
def test_decimal_seconds_are_exact(text: str, stamp: int) -> None:
    assert to_nanoseconds(parse_stamp(text), "seconds", 30.0) == stamp


@given(st.integers(-(2**62), 2**62))
def test_seconds_round_trip(stamp: int) -> None:
    sign, magnitude = ("-" if stamp < 0 else ""), abs(stamp)
    text = f"{sign}{magnitude // 10**9}.{magnitude % 10**9:09d}"
    assert to_nanoseconds(parse_stamp(text), "seconds", 30.0) == stamp
    assert parse_nanoseconds(str(stamp)) == stamp


@pytest.mark.parametrize("text", ["", "nan", "inf", "1.2.3", "12s", "1e30"])
def test_bad_seconds(text: str) -> None:
    with pytest.raises(ValueError, match="is not a time"):
        parse_stamp(text)


def test_regular_clock() -> None:
    assert [regular_stamp(k, 30.0) for k in (0, 1, 2, 3)] == [0, 33333333, 66666667, 100000000]
    assert regular_stamp(10**7, 30.0) == 333333333333333


def test_frame_rate_of_stamps() -> None:
    assert fps_of_stamps([0, 33_369_000, 66_738_000, 166_000_000], 30.0) == 29.968
    assert fps_of_stamps([5], 30.0) == 30.0
    assert fps_of_stamps([5, 5, 5], 30.0) == 30.0


def brute_force_association(first: list[int], second: list[int], limit: int) -> list[tuple[int, int]]:
    candidates = [(abs(a - b), i, j) for i, a in enumerate(first) for j, b in enumerate(second) if abs(a - b) <= limit]
    pairs: list[tuple[int, int]] = []
    for _, i, j in sorted(candidates):
        if all(i != other_i and j != other_j for other_i, other_j in pairs):
            pairs.append((i, j))
    return sorted(pairs)


stamps = st.lists(st.integers(0, 200), max_size=12).map(sorted)


@given(stamps, stamps, st.integers(0, 30))
def test_association_takes_the_nearest_unique_pairs(first: list[int], second: list[int], limit: int) -> None:
    assert associate(first, second, limit) == brute_force_association(first, second, limit)


def test_pictures_are_listed_by_number(tmp_path: Path) -> None:
    for name in ("frame10.png", "frame2.PNG", "frame1.jpeg", ".frame0.png", "readme.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in list_pictures(tmp_path)] == ["frame1.jpeg", "frame2.PNG", "frame10.png"]
    assert name_numbers(tmp_path / "frame-000012.color.png") == (12,)


def test_interpolation_between_equal_and_at_given_poses() -> None:
    early, late = poses(2)
    assert interpolate_pose([10, 20], [early, late], 10) is early
    assert interpolate_pose([10, 20], [early, late], 20) is late
    assert interpolate_pose([10, 20], [early, late], 9) is None
    assert interpolate_pose([10, 20], [early, late], 21) is None
    assert interpolate_pose([], [], 5) is None
    assert interpolate_pose([0, 100_000_001], [early, late], 5) is None
    still = interpolate_pose([10, 20], [early, early], 13)
    assert still is not None
    assert np.allclose(still, early, atol=1e-12)


@pytest.mark.parametrize(
    ("frames", "told", "fps"),
    [
        pytest.param([0, 1, 2, 3, 3, 5, 6, 7], 30.0, 30.0, id="one has the stamp of another"),
        pytest.param([0, 1, 2, 3, 3, 5, 6, 7], None, 30.0, id="one has the stamp of another, no rate told"),
        pytest.param([0, 1, 2, 3, 3, 4, 5, 6, 7], 30.0, 30.0, id="one is there twice"),
        pytest.param([0, 1, 2, 3, 3, 4, 5, 6, 7], None, 30.0, id="one is there twice, no rate told"),
        pytest.param([0, 1, 2, 6, 7, 8, 12, 13], 30.0, 30 * 7 / 13, id="some were lost"),
        pytest.param([0, 3, 6, 9, 12], 30.0, 10.0, id="another camera"),
    ],
)
def test_rate_by_stamps(frames: list[int], told: float | None, fps: float) -> None:
    rate = rate_of([regular_stamp(frame, 30.0) for frame in frames], told, "list.txt")
    assert rate.fps == pytest.approx(fps, abs=0.001)
    assert [notice.warning for notice in rate.notices] == ([True] if fps == 10.0 else [])


@pytest.mark.parametrize(
    ("shape", "dtype", "suffix", "expected"),
    [
        ((7, 9), np.uint8, ".png", PictureHeader(9, 7, 1, 8)),
        ((7, 9, 3), np.uint8, ".png", PictureHeader(9, 7, 3, 8)),
        ((7, 9, 4), np.uint8, ".png", PictureHeader(9, 7, 3, 8)),
        ((7, 9), np.uint16, ".png", PictureHeader(9, 7, 1, 16)),
        ((7, 9), np.uint8, ".jpg", PictureHeader(9, 7, 1, 8)),
        ((7, 9, 3), np.uint8, ".jpg", PictureHeader(9, 7, 3, 8)),
    ],
)
def test_header(tmp_path: Path, shape: tuple[int, ...], dtype: type, suffix: str, expected: PictureHeader) -> None:
    path = tmp_path / f"picture{suffix}"
    write_picture(path, np.zeros(shape, dtype))
    assert read_header(path) == expected


@pytest.mark.parametrize("magic", [b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b""])
def test_header_cut_short(tmp_path: Path, magic: bytes) -> None:
    path = tmp_path / "picture.png"
    path.write_bytes(magic + b"\xff")
    with pytest.raises(SequenceError, match="unreadable picture"):
        read_header(path)


def test_color_is_rgb_without_alpha_and_never_turned(tmp_path: Path) -> None:
    rgb = np.zeros((2, 3, 3), np.uint8)
    rgb[..., 0], rgb[..., 2] = 200, 10
    path = tmp_path / "übung.png"
    rgba = np.dstack([rgb[..., ::-1], np.full((2, 3), 7, np.uint8)])
    path.write_bytes(cv2.imencode(".png", rgba)[1].tobytes())
    assert np.array_equal(read_color(path).pixels, rgb)


def test_jpeg_rotation_flag_is_ignored(tmp_path: Path) -> None:
    data = cv2.imencode(".jpg", np.zeros((8, 16, 3), np.uint8))[1].tobytes()
    tiff = b"MM\x00\x2a\x00\x00\x00\x08\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00\x00\x00\x00\x00"
    body = b"Exif\x00\x00" + tiff
    path = tmp_path / "turned.jpg"
    path.write_bytes(data[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + data[2:])
    assert read_header(path).size == (16, 8)
    assert read_color(path).pixels.shape == (8, 16, 3)


def test_restart_markers_are_no_damage(tmp_path: Path) -> None:
    picture = color_picture(SMALL, poses(1)[0])
    path = tmp_path / "restarts.jpg"
    path.write_bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_RST_INTERVAL, 2])[1].tobytes())
    assert b"\xff\xd0" in path.read_bytes()
    assert read_color(path).pixels.shape == picture.shape


def test_progressive_jpeg_with_bytes_behind_it(tmp_path: Path) -> None:
    picture = color_picture(SMALL, poses(1)[0])
    path = tmp_path / "progressive.jpg"
    path.write_bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes() + b"\xff\xd8 more")
    assert read_color(path).pixels.shape == picture.shape


def test_reading_the_wrong_kind(tmp_path: Path) -> None:
    gray, depth = tmp_path / "gray.png", tmp_path / "depth.png"
    write_picture(gray, np.zeros((4, 4), np.uint8))
    write_picture(depth, np.zeros((4, 4), np.uint16))
    with pytest.raises(SequenceError, match="uint8 with 2 axes, expected 16-bit depth"):
        read_depth(gray)
    with pytest.raises(SequenceError, match="uint16 with 2 axes, expected 8-bit labels"):
        read_mask(depth)


def test_undecodable_content(tmp_path: Path) -> None:
    path = tmp_path / "tables.jpg"
    data = bytearray(cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    table = data.index(b"\xff\xc4")
    data[table + 5 : table + 9] = b"\xff" * 4
    path.write_bytes(data)
    with pytest.raises(SequenceError, match=r"unreadable picture \(its content cannot be decoded\)"):
        read_color(path)
    data[2] = 0
    path.write_bytes(data)
    with pytest.raises(SequenceError, match=r"unreadable picture \(damaged JPEG at byte 2\)"):
        read_color(path)


def test_reading_what_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(SequenceError, match="is no regular file; put the file itself there"):
        read_header(tmp_path)
    with pytest.raises(SequenceError, match=r"unreadable picture \(No such file or directory\)"):
        read_color(tmp_path / "absent.png")
    with pytest.raises(
        SequenceError, match=r"absent: cannot be listed \(No such file or directory\); check the folder"
    ):
        list_pictures(tmp_path / "absent")


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_damage_is_an_error_or_harmless(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    path = tmp_path / f"picture{suffix}"
    write_picture(path, color_picture(SMALL, poses(1)[0]))
    sound = np.frombuffer(path.read_bytes(), np.uint8)
    for _ in range(150):
        damaged = sound.copy()
        damaged[rng.integers(0, len(sound), size=2)] = rng.integers(0, 256, size=2)
        path.write_bytes(damaged[: rng.integers(1, len(sound) + 1)].tobytes())
        with suppress(SequenceError):
            if read_header(path).size == (SMALL.width, SMALL.height):
                assert read_color(path).pixels.shape == (SMALL.height, SMALL.width, 3)


def recording(folder: Path, count: int) -> Recording:
    for k in range(count):
        write_picture(folder / f"c{k}.png", np.full((48, 64, 3), k, np.uint8))
        write_picture(folder / f"d{k}.png", depth_picture(SMALL, poses(1)[0], 1000))
    frames = tuple(
        FrameFiles(color=folder / f"c{k}.png", depth=folder / f"d{k}.png", timestamp_ns=k) for k in range(count)
    )
    rig = CameraRig.registered_to(SMALL)
    return Recording(folder=folder, frames=frames, rig=rig, depth_scale=1000.0, fps=30.0)


@pytest.mark.parametrize("read_ahead", [0, 1, 3, 50])
def test_iteration_gives_every_frame_in_order_and_again(tmp_path: Path, read_ahead: int) -> None:
    sequence = FolderSequence(recording(tmp_path, 6), read_ahead=read_ahead)
    for _ in range(2):
        assert [(frame.index, int(frame.color[0, 0, 0])) for frame in sequence] == [(k, k) for k in range(6)]
    assert len(sequence) == 6


def test_access_by_index(tmp_path: Path) -> None:
    sequence = FolderSequence(recording(tmp_path, 3))
    assert sequence[-1].index == 2
    for index in (3, -4):
        with pytest.raises(IndexError, match=f"frame {index} is not one of 3"):
            sequence[index]


def test_picture_exchanged_after_opening(tmp_path: Path) -> None:
    sequence = FolderSequence(recording(tmp_path, 2))
    write_picture(tmp_path / "c1.png", np.zeros((10, 12, 3), np.uint8))
    with pytest.raises(SequenceError) as caught:
        sequence[1]
    assert str(caught.value) == (
        f"{tmp_path / 'c1.png'}: is 12x10, but was 64x48 when the recording was opened; open it again"
    )


def test_leaving_an_iteration_ends_its_thread(tmp_path: Path) -> None:
    before = threading.active_count()
    frames = iter(FolderSequence(recording(tmp_path, 6)))
    next(frames)
    frames.close()  # type: ignore[attr-defined]
    assert threading.active_count() == before
