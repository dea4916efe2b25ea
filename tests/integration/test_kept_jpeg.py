# SPDX-License-Identifier: MIT
"""Color pictures that came as JPEG files: kept as these without loss, and what stands in their way."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import threedvc
from helpers.lossless import EXACT_COLORS
from helpers.packet_changes import members_of, with_changed, written
from threedvc.cli.main import main
from threedvc.coding.video.ffv1 import can_encode_ffv1
from threedvc.coding.video.parts import unpack_parts
from threedvc.config import RenderConfig
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.errors import CorruptStream
from threedvc.formats.container import StreamReader
from threedvc.formats.sinks import PlainSink
from threedvc.formats.sources import open_sequence
from threedvc.frames.multi_sensor import MergedSequence
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import identity
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import Packet, PacketType, VideoCodec
from threedvc.synthesis import SyntheticSequence, make_scene

pytestmark = pytest.mark.skipif(not can_encode_ffv1(), reason="this build of PyAV has no FFV1")

FRAMES = 6
CONFIG = replace(EXACT_COLORS, batch_frames=4)
LOSSLESS = ["--lossless", "--preset", "fast", "--voxel-size", "6cm"]


def record(folder: Path, jpegs: Iterable[int], *, gray: bool = False) -> Path:
    """Write a recording of which some color pictures are JPEG files, and return its folder."""
    sequence = SyntheticSequence(make_scene("room", frames=FRAMES, size=(64, 48)), "kinect")
    with PlainSink(folder, sequence.info, threads=1) as sink:
        for frame in sequence:
            sink.write_frame(frame)
    for path in sorted((folder / "color").iterdir()):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE if gray else cv2.IMREAD_COLOR)
        path.unlink()
        kind = ".jpg" if int(path.stem) in jpegs else ".png"
        cv2.imwrite(str(path.with_suffix(kind)), picture)
    return folder


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("jpeg") / "room", range(FRAMES))


@pytest.fixture(scope="module")
def packets(recording: Path) -> list[Packet]:
    return encoded(open_sequence(recording))


def encoded(sequence: FrameSequence) -> list[Packet]:
    return list(Encoder(sequence.info, CONFIG).packets(sequence))


def videos(packets: list[Packet]) -> list[Packet]:
    return [each for each in members_of(packets) if each.type == PacketType.COLOR_VIDEO]


def codecs(packets: list[Packet]) -> list[int]:
    return [ColorVideoHeader.from_map(each.header).codec for each in videos(packets)]


def test_the_files_come_back_byte_for_byte(recording: Path, packets: list[Packet]) -> None:
    assert codecs(packets) == [VideoCodec.JPEG, VideoCodec.JPEG]
    kept = [data for packet in videos(packets) for data in unpack_parts(packet.payload, packet.header["n"], FRAMES)]
    assert kept == [path.read_bytes() for path in sorted((recording / "color").iterdir())]


def test_the_pixels_come_back_exactly(recording: Path, packets: list[Packet], tmp_path: Path) -> None:
    path = written(packets, tmp_path / "room.3dvc")
    filmed = [frame.color for frame in open_sequence(recording)]
    for threads in (1, 3):
        shown = [frame.color for frame in threedvc.decode(path, render=RenderConfig(threads=threads))]
        np.testing.assert_array_equal(shown, filmed)
    np.testing.assert_array_equal([frame.color for frame in threedvc.decode(path, frames=(3, 5))], filmed[3:5])


def test_commands_keep_them(recording: Path, tmp_path: Path) -> None:
    stream = str(tmp_path / "a.3dvc")
    chosen = [*LOSSLESS, "--max-depth", "2.5m", "--frames", "1:6:2"]
    for options in (chosen, LOSSLESS):
        assert CliRunner().invoke(main, ["encode", str(recording), stream, *options]).exit_code == 0
        with open(stream, "rb") as file:
            assert set(codecs(list(StreamReader(file, "a")))) == {VideoCodec.JPEG}
    report = CliRunner().invoke(main, ["stats", stream, "--reference", str(recording)]).stdout
    assert "exact               color lossless, depth lossless\n" in report
    assert CliRunner().invoke(main, ["decode", stream, str(tmp_path / "out")]).exit_code == 0
    for path in (recording / "color").iterdir():
        back = cv2.imread(str(tmp_path / "out" / "color" / f"{path.stem}.png"))
        np.testing.assert_array_equal(back, cv2.imread(str(path)))


def test_runs_with_other_pictures_are_ffv1(tmp_path: Path) -> None:
    mixed = open_sequence(record(tmp_path / "mixed", range(5)))
    packets = encoded(mixed)
    assert codecs(packets) == [VideoCodec.JPEG, VideoCodec.FFV1]
    shown = [frame.color for frame in threedvc.decode(written(packets, tmp_path / "mixed.3dvc"))]
    np.testing.assert_array_equal(shown, [frame.color for frame in mixed])


def test_gray_files_are_kept(tmp_path: Path) -> None:
    gray = open_sequence(record(tmp_path / "gray", range(FRAMES), gray=True))
    assert gray.info.gray
    packets = encoded(gray)
    assert set(codecs(packets)) == {VideoCodec.JPEG}
    shown = [frame.color for frame in threedvc.decode(written(packets, tmp_path / "gray.3dvc"))]
    np.testing.assert_array_equal(shown, [frame.color for frame in gray])


def test_every_sensor_keeps_its_own(recording: Path, tmp_path: Path) -> None:
    sensors = [open_sequence(recording), open_sequence(record(tmp_path / "other", ()))]
    merged = MergedSequence(sensors, [identity()])
    packets = encoded(merged)
    assert set(codecs(packets)) == {VideoCodec.JPEG, VideoCodec.FFV1}
    path = written(packets, tmp_path / "two.3dvc")
    for number, sensor in enumerate(sensors):
        shown = [frame.color for frame in threedvc.decode(path, sensor=number)]
        np.testing.assert_array_equal(shown, [frame.color for frame in sensor])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"header": {"w": 63}}, "must have 64x48 of 8 bits"),
        ({"header": {"b": 10}}, "must have 64x48 of 8 bits"),
        ({"header": {"n": 1}}, "bytes follow a video of 1 pictures"),
        ({"header": {"c": 2}}, "a video of 4 pictures is incomplete"),
        ({"header": {"c": 1}}, "the stream is damaged"),
        ({"payload": b""}, "incomplete"),
        ({"payload": b"\x05abcdef" * 4}, "no JPEG"),
    ],
)
def test_damage_is_one_error(change: dict[str, dict[str, int] | bytes], message: str, packets: list[Packet]) -> None:
    def damaged(packet: Packet) -> Packet:
        header = change.get("header", {})
        assert isinstance(header, dict)
        return replace(packet, header=packet.header | header, payload=change.get("payload", packet.payload))

    changed = with_changed(packets, PacketType.COLOR_VIDEO, damaged)
    with pytest.raises(CorruptStream, match=message):
        list(Decoder().frames(changed))
    assert len(list(Decoder(captured_color=False).frames(changed))) == FRAMES
