# SPDX-License-Identifier: MIT
"""Text and pictures as other programs write them: encodings, headings, quotes, fill bytes, alpha, EXIF."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.recorded_room import SMALL, color_picture, depth_picture, pose_row, poses, write_picture
from threedvc.errors import SequenceError
from threedvc.formats.sources import open_sequence
from threedvc.formats.sources.files.images import read_color, read_depth, read_header
from threedvc.formats.sources.files.text import read_rows, read_text

FRAMES = 4
TURNED = b"MM\x00\x2a\x00\x00\x00\x08\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00\x00\x00\x00\x00"
CAMERA = "60,61,31,24.5"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a sound recording in the plain layout with its poses."""
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(tmp_path / "color" / f"{k:06d}.png", color_picture(SMALL, pose))
        write_picture(tmp_path / "depth" / f"{k:06d}.png", depth_picture(SMALL, pose, 1000))
    camera = {"width": 64, "height": 48, "fx": 60.0, "fy": 61.0, "cx": 31.0, "cy": 24.5}
    (tmp_path / "intrinsics.json").write_text(json.dumps(camera))
    (tmp_path / "poses.txt").write_text(pose_lines())
    return tmp_path


def pose_lines() -> str:
    return "".join(f"{pose_row(f'{k:06d}', pose)}\n" for k, pose in enumerate(poses(FRAMES)))


def exif_png(picture: np.ndarray) -> bytes:
    """Return a PNG whose eXIf chunk turns it by orientation 6."""
    data: bytes = cv2.imencode(".png", picture)[1].tobytes()
    chunk = b"eXIf" + TURNED
    whole = len(TURNED).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
    return data[:33] + whole + data[33:]


@pytest.mark.parametrize(
    "encoded",
    [
        pytest.param(lambda text: text.encode("utf-8-sig"), id="UTF-8 BOM"),
        pytest.param(lambda text: text.encode("utf-16"), id="UTF-16"),
        pytest.param(lambda text: b"\xfe\xff" + text.encode("utf-16-be"), id="UTF-16 big endian"),
        pytest.param(lambda text: text.replace("\n", "\r\n").encode(), id="CR LF"),
        pytest.param(lambda text: text.replace("\n", "\r").encode(), id="CR"),
        pytest.param(lambda text: f"# Übung\n{text}".encode("latin-1"), id="Latin-1 in a comment"),
        pytest.param(lambda text: text.replace(" ", ", ").encode(), id="commas"),
        pytest.param(lambda text: f"\n  \n// from a tool\n; more\n{text}\n\n".encode(), id="comments"),
    ],
)
def test_encodings_of_text(recording: Path, encoded: Callable[[str], bytes]) -> None:
    (recording / "poses.txt").write_bytes(encoded(pose_lines()))
    sequence = open_sequence(recording)
    assert sequence.notices == ()
    for frame, pose in zip(sequence, poses(FRAMES), strict=True):
        assert frame.T_world_camera is not None
        assert np.allclose(frame.T_world_camera, pose, atol=1e-6)


@pytest.mark.parametrize("name", ["intrinsics.json", "poses.txt"])
@pytest.mark.parametrize("data", [b"\x89PNG\r\n\x1a\n\xff", b"1 2\0 3", b"\xff\xfe1"])
def test_what_is_no_text(recording: Path, name: str, data: bytes) -> None:
    (recording / name).write_bytes(data)
    with pytest.raises(SequenceError) as caught:
        open_sequence(recording)
    assert str(caught.value).startswith(f"{recording / name}: is not a text file")


def test_a_row_says_where_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    path.write_bytes("\ufeff# a\n1 2\n\n3 x".encode())
    first, second = read_rows(path)
    assert (first.place, second.place) == (f"{path}:2", f"{path}:4")
    assert read_text(path).startswith("# a")
    with pytest.raises(SequenceError, match=r"table\.txt:4: 'x' is not a number; correct the line"):
        second.floats()


def write_tum(
    folder: Path, lists: dict[str, list[str]], names: tuple[str, str] = ("rgb/{}.png", "depth/{}.png")
) -> None:
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(folder / names[0].format(k), color_picture(SMALL, pose))
        write_picture(folder / names[1].format(k), depth_picture(SMALL, pose, 5000))
    for name, lines in lists.items():
        (folder / name).write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("heading", "line"),
    [
        ("", "{0} my rgb/a {1}.png {0} my depth/a {1}.png"),
        ("", '{0} "my rgb/a {1}.png" {0} "my depth/a {1}.png"'),
        ("t_rgb rgb t_depth depth", "{0},my rgb\\a {1}.png,{0},my depth\\a {1}.png"),
        ("timestamp,depth,timestamp,rgb", "{0} my depth/a {1}.png {0} my rgb/a {1}.png"),
    ],
)
def test_association_lists_of_other_writers(tmp_path: Path, heading: str, line: str) -> None:
    lines = [heading, *(line.format(f"10.{k}", k) for k in range(FRAMES))]
    write_tum(tmp_path, {"associations.txt": lines}, ("my rgb/a {}.png", "my depth/a {}.png"))
    sequence = open_sequence(tmp_path, intrinsics=CAMERA)
    assert [frame.timestamp_ns for frame in sequence] == [10_000_000_000 + k * 100_000_000 for k in range(FRAMES)]
    assert np.array_equal(sequence[2].color, color_picture(SMALL, poses(FRAMES)[2]))


def test_lists_and_ground_truth_with_headings(tmp_path: Path) -> None:
    stamps = [f"10.{k}" for k in range(FRAMES)]
    truth = [pose_row(stamp, pose) for stamp, pose in zip(stamps, poses(FRAMES), strict=True)]
    lists = {
        "rgb.txt": ["timestamp,filename", *(f"{stamp},rgb/{k}.png" for k, stamp in enumerate(stamps))],
        "depth.txt": ["timestamp filename", *(f"{stamp} depth/{k}.png" for k, stamp in enumerate(stamps))],
        "groundtruth.txt": ["timestamp tx ty tz qx qy qz qw", *truth],
    }
    write_tum(tmp_path, lists)
    sequence = open_sequence(tmp_path, intrinsics=CAMERA)
    assert len(sequence) == FRAMES
    assert sequence.info.has_camera_poses


@pytest.mark.parametrize("fill", [b"\xff", b"\xff\xff\xff", b"\xff" * 200])
def test_fill_bytes_before_jpeg_markers(tmp_path: Path, fill: bytes) -> None:
    picture = color_picture(SMALL, poses(1)[0])
    data: bytes = cv2.imencode(".jpg", picture)[1].tobytes()
    tables = data.index(b"\xff\xdb")
    path = tmp_path / "filled.jpg"
    path.write_bytes(data[:tables] + fill + data[tables:])
    assert read_header(path).size == (64, 48)
    assert np.array_equal(
        read_color(path).pixels, cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    )


@pytest.mark.parametrize("alpha", [0, 500, 65535])
def test_depth_with_alpha(tmp_path: Path, alpha: int) -> None:
    depth = depth_picture(SMALL, poses(1)[0], 1000)
    path = tmp_path / "depth.png"
    path.write_bytes(gray_alpha_png(depth, alpha))
    assert read_header(path).channels == 1
    assert np.array_equal(read_depth(path), depth)


def gray_alpha_png(depth: np.ndarray, alpha: int) -> bytes:
    """Return a 16-bit PNG of color type 4; OpenCV writes none."""
    pixels = np.stack([depth, np.full_like(depth, alpha)], axis=-1).astype(">u2")
    raw = b"".join(b"\0" + line.tobytes() for line in pixels)
    size = depth.shape[1].to_bytes(4, "big") + depth.shape[0].to_bytes(4, "big")
    chunks = [(b"IHDR", size + bytes([16, 4, 0, 0, 0])), (b"IDAT", zlib.compress(raw)), (b"IEND", b"")]
    parts = [
        len(body).to_bytes(4, "big") + kind + body + zlib.crc32(kind + body).to_bytes(4, "big") for kind, body in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize("turned", [[0], [2], [1, 3]])
def test_pictures_that_exif_turns_differently(recording: Path, turned: list[int]) -> None:
    for k in turned:
        path = recording / "color" / f"{k:06d}.png"
        path.write_bytes(exif_png(color_picture(SMALL, poses(FRAMES)[k])[..., ::-1]))
        assert read_header(path).orientation == 6
    with pytest.raises(SequenceError, match="EXIF turns it by orientation"):
        open_sequence(recording)


def test_pictures_that_exif_turns_alike_are_taken_as_stored(recording: Path) -> None:
    for k, pose in enumerate(poses(FRAMES)):
        (recording / "color" / f"{k:06d}.png").write_bytes(exif_png(color_picture(SMALL, pose)[..., ::-1]))
    assert np.array_equal(open_sequence(recording)[1].color, color_picture(SMALL, poses(FRAMES)[1]))
