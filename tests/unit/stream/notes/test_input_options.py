# SPDX-License-Identifier: MIT
"""What a stream keeps of its input: options that were given, and the color pictures' own times."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from helpers.recorded_room import SMALL, color_picture, depth_picture, poses, write_lines, write_picture
from threedvc.config import EncoderConfig
from threedvc.errors import CorruptStream
from threedvc.formats.decoding import decode
from threedvc.formats.encoding import encode
from threedvc.formats.evaluation.statistics import statistics
from threedvc.formats.sources import open_sequence
from threedvc.stream.notes.color_times import color_times_packet, unpack_color_times
from threedvc.stream.notes.input_options import input_options_packet, unpack_input_options
from threedvc.stream.packets import Packet, PacketType

FRAMES = 4
SCALE = 2000.0


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a recording whose intrinsics tell half its depth scale, and whose color is 5 ms late."""
    for k, pose in enumerate(poses(FRAMES)):
        write_picture(tmp_path / "left" / f"{k:06d}.png", color_picture(SMALL, pose))
        write_picture(tmp_path / "depth" / f"{k:06d}.png", depth_picture(SMALL, pose, SCALE))
    intrinsics = {"width": 64, "height": 48, "fx": 60.0, "fy": 61.0, "cx": 31.0, "cy": 24.5, "depth_scale": 1000}
    (tmp_path / "intrinsics.json").write_text(json.dumps(intrinsics))
    stamps = [(k * 33_333_333, k * 33_333_333 + 5_000_000) for k in range(FRAMES)]
    write_lines(tmp_path / "timestamps.txt", [f"{k} {depth} {color}" for k, (depth, color) in enumerate(stamps)])
    return tmp_path


def test_a_reference_is_read_as_the_input_was(recording: Path) -> None:
    sequence = open_sequence(recording, color="left", depth_scale=SCALE)
    stream = io.BytesIO()
    encode(sequence, stream, EncoderConfig(causal=True, voxel_size_m=0.05))
    stream.seek(0)
    told = statistics(stream, recording).quality
    stream.seek(0)
    asked = statistics(stream, recording, options=[{"color": "left", "depth_scale": SCALE}]).quality
    assert told is not None
    assert told == asked
    stream.seek(0)
    wrong = statistics(stream, recording, options=[{"depth_scale": 1000.0}]).quality
    assert wrong is not None
    assert wrong["depth_within_1pct"] < told["depth_within_1pct"]
    stream.seek(0)
    times = [(frame.timestamp_ns, frame.color_timestamp_ns) for frame in decode(stream)]
    assert times == [(frame.timestamp_ns, frame.color_timestamp_ns) for frame in sequence]


def test_color_times_round_trip() -> None:
    offsets = [0, 5, -7_000_000_000, 12]
    assert unpack_color_times(color_times_packet(9, offsets)) == dict(zip(range(9, 13), offsets, strict=True))


@pytest.mark.parametrize("payload", [b"", b"abc", color_times_packet(0, [1, 2]).payload[:-1]])
def test_damaged_color_times(payload: bytes) -> None:
    packet = Packet(type=PacketType.META, header={"k": "color times", "f": 0}, payload=payload, critical=False)
    with pytest.raises(CorruptStream):
        unpack_color_times(packet)


def test_options_round_trip_and_others_are_passed_over() -> None:
    options = {"layout": "bare", "depth_scale": 5000.0, "poses": "inverted"}
    assert unpack_input_options(input_options_packet(2, options)) == (2, options)
    strange = {"k": "input", "layout": 5, "depth_scale": -1, "color": "x" * 999, "fps": 30, "s": 0}
    packet = Packet(type=PacketType.META, header=strange, payload=b"", critical=False)
    assert unpack_input_options(packet) == (0, {})
