# SPDX-License-Identifier: MIT
"""Damaged pictures as captured, in whole streams: an error of one line, or every frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from golden.make_golden import FOLDER
from helpers.packet_changes import with_changed
from threedvc.coding.video.av1 import can_decode_av1
from threedvc.coding.video.ffv1 import can_decode_ffv1
from threedvc.decoder.decoder import Decoder
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.formats.container import StreamReader
from threedvc.stream.packets import Packet, PacketType

STREAMS = {
    "room_color_video": (PacketType.COLOR_VIDEO, can_decode_av1()),
    "room_depth_error": (PacketType.RESIDUAL, True),
    "paper_lossless": (PacketType.COLOR_VIDEO, can_decode_ffv1()),
}
"""Golden streams with pictures as captured: the packets of these, and whether they can be read here."""
LARGE = st.sampled_from([48, 64, 4096, 1 << 20, 1 << 31, 1 << 62])
NUMBERS = st.booleans() | st.integers(-2, 12) | LARGE | st.floats(-1, 200)
PLACES = st.integers(0, 40) | st.integers(0, 1 << 16)
every_stream = pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.skipif(not can, reason="this build of PyAV cannot read its color video"))
        for name, (_, can) in STREAMS.items()
    ],
)


@cache
def packets_of(name: str) -> list[Packet]:
    with open(FOLDER / "0.1.0" / f"{name}.3dvc", "rb") as file:
        return list(StreamReader(file, name))


def decode_lawfully(name: str, change: Callable[[Packet], Packet]) -> None:
    """Decode a stream whose pictures are changed; either an error of one line is raised, or every frame comes."""
    decoder, frames, message = Decoder(), 0, ""
    try:
        for _ in decoder.frames(with_changed(packets_of(name), STREAMS[name][0], change)):
            frames += 1
    except (CorruptStream, LimitExceeded) as error:
        message = str(error)
    assert "\n" not in message
    assert message or (decoder.complete and frames == decoder.frame_count)


@every_stream
@given(changes=st.lists(st.tuples(PLACES, st.integers(1, 255)), min_size=1, max_size=4))
def test_changed_bytes(name: str, changes: list[tuple[int, int]]) -> None:
    def damaged(packet: Packet) -> Packet:
        payload = bytearray(packet.payload)
        for place, change in changes:
            payload[place % len(payload)] ^= change
        return replace(packet, payload=bytes(payload))

    decode_lawfully(name, damaged)


@every_stream
@given(start=PLACES, taken=st.integers(0, 40), put=st.binary(max_size=20))
def test_lost_and_added_bytes(name: str, start: int, taken: int, put: bytes) -> None:
    def damaged(packet: Packet) -> Packet:
        place = start % len(packet.payload)
        return replace(packet, payload=packet.payload[:place] + put + packet.payload[place + taken :])

    decode_lawfully(name, damaged)


@every_stream
@given(size=PLACES)
def test_cut_payloads(name: str, size: int) -> None:
    decode_lawfully(name, lambda packet: replace(packet, payload=packet.payload[: size % len(packet.payload)]))


@every_stream
@given(payload=st.binary(max_size=200))
def test_random_payloads(name: str, payload: bytes) -> None:
    decode_lawfully(name, lambda packet: replace(packet, payload=payload))


@every_stream
@given(fields=st.dictionaries(st.sampled_from("fnswhcbmkeu"), NUMBERS, min_size=1, max_size=3))
def test_headers_that_lie(name: str, fields: dict[str, int | float]) -> None:
    decode_lawfully(name, lambda packet: replace(packet, header=packet.header | fields))
