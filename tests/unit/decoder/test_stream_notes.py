# SPDX-License-Identifier: MIT
"""Notes in META packets: each kind has a module, and packets find it by the name of their kind."""

from __future__ import annotations

import pytest

from threedvc.decoder.stream_notes import NOTES, StreamNotes
from threedvc.stream.notes.color_times import ColorTimes, color_times_packet
from threedvc.stream.notes.frame_report import FrameReports
from threedvc.stream.notes.input_options import InputNotes, input_options_packet
from threedvc.stream.packets import Packet, PacketType


def test_every_kind_is_found_once() -> None:
    assert {ColorTimes, FrameReports, InputNotes} <= set(NOTES)
    assert len({note.kind for note in NOTES}) == len(NOTES)


def test_packets_reach_the_notes_of_their_kind() -> None:
    notes = StreamNotes()
    notes.add(color_times_packet(3, [7]))
    notes.add(input_options_packet(1, {"depth_scale": 5000.0}))
    assert notes.of(ColorTimes).take_offset_ns(3) == 7
    assert notes.of(ColorTimes).take_offset_ns(3) == 0
    assert notes.of(InputNotes).by_sensor == {1: {"depth_scale": 5000.0}}
    assert notes.of(FrameReports).all().status == ()


@pytest.mark.parametrize("header", [{}, {"k": "camera"}, {"k": 1}, {"k": None}])
def test_other_kinds_are_passed_over(header: dict[str, object]) -> None:
    StreamNotes().add(Packet(type=PacketType.META, header=header, payload=b"anything", critical=False))
