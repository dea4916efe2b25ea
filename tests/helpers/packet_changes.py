# SPDX-License-Identifier: MIT
"""Packets of whole streams: written to a file, looked into, and changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from threedvc.formats.container import open_output
from threedvc.stream.batch import pack_batch, unpack_batch
from threedvc.stream.headers import BatchHeader
from threedvc.stream.packets import Packet, PacketType

__all__ = ["members_of", "with_changed", "written"]


def written(packets: Sequence[Packet], path: Path) -> Path:
    """Write packets to a file, and return its path."""
    with open_output(path, force=True) as writer:
        for packet in packets:
            writer.write(packet)
    return path


def members_of(packets: Sequence[Packet]) -> list[Packet]:
    """Return the packets in all batches."""
    return [member for packet in packets if packet.type == PacketType.BATCH for member in unpack_batch(packet)]


def with_changed(packets: Sequence[Packet], kind: PacketType, change: Callable[[Packet], Packet]) -> list[Packet]:
    """Return the packets with those of a type, in their batches, changed."""

    def changed(packet: Packet) -> Packet:
        if packet.type != PacketType.BATCH:
            return packet
        members = [change(each) if each.type == kind else each for each in unpack_batch(packet)]
        return pack_batch(BatchHeader.from_map(packet.header), members)

    return [changed(packet) for packet in packets]
