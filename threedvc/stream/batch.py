# SPDX-License-Identifier: MIT
"""Batches: packets of some frames packed together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.limits import (
    MAX_BATCH_PACKETS,
    MAX_HEADER_BYTES,
    MAX_PAYLOAD_BYTES,
)
from threedvc.stream.header_reader import read_header
from threedvc.stream.headers import BatchHeader, Header
from threedvc.stream.packets import TOP_LEVEL_TYPES, Packet, PacketFlag, is_understood, type_name
from threedvc.stream.wire import ByteReader, pack_map, pack_varint, unpack_map

__all__ = ["Member", "pack_batch", "read_batch", "split_batch", "unpack_batch"]


class Member(NamedTuple):
    """A packet in a BATCH and its header; None for a type without keys of its own, such as META."""

    packet: Packet
    header: Header | None


def pack_batch(header: BatchHeader, packets: Sequence[Packet]) -> Packet:
    """Join packets into one BATCH, whose framing takes 4 to 8 bytes for each instead of 28.

    Raises
    ------
    ValueError
        If a packet is of a type that stands at top level only.
    LimitExceeded
        If there are too many packets or bytes for one BATCH.
    """
    if len(packets) > MAX_BATCH_PACKETS:
        raise LimitExceeded(f"{len(packets)} packets are more than the {MAX_BATCH_PACKETS} that fit into one BATCH")
    payload = b"".join(_pack_member(packet) for packet in packets)
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise LimitExceeded(
            f"a BATCH of {len(payload)} bytes is larger than {MAX_PAYLOAD_BYTES}; put fewer frames into one"
        )
    return header.packet(payload)


def split_batch(packet: Packet) -> Iterator[tuple[Packet, int]]:
    """Yield every packet in a BATCH, of unknown types too, with the number of bytes it takes there.

    Raises
    ------
    CorruptStream
        If the payload is not a sequence of packets.
    LimitExceeded
        If there are more than `MAX_BATCH_PACKETS`, or a header is too long.
    """
    reader = ByteReader(packet.payload)
    for _ in range(MAX_BATCH_PACKETS):
        if not reader.remaining:
            return
        start = reader.position
        member = _unpack_member(reader)
        yield member, reader.position - start
    if reader.remaining:
        raise LimitExceeded(f"a BATCH holds more than {MAX_BATCH_PACKETS} packets")


def unpack_batch(packet: Packet) -> list[Packet]:
    """Return the packets in a BATCH; those unknown to this reader are passed over.

    Raises
    ------
    CorruptStream
        If the payload is not a sequence of packets.
    LimitExceeded
        If there are more than `MAX_BATCH_PACKETS`, or a header is too long.
    UnsupportedVersion
        If a packet is critical and of an unknown type.
    """
    return [member for member, _ in split_batch(packet) if is_understood(member.type, member.critical)]


def read_batch(packet: Packet) -> list[Member]:
    """Return the packets in a BATCH with their headers read; those unknown to this reader are passed over.

    Raises
    ------
    CorruptStream
        If the payload is not a sequence of packets, or one has an impossible header.
    LimitExceeded, UnsupportedVersion
        As by `unpack_batch`.
    """
    return [Member(member, read_header(member)) for member in unpack_batch(packet)]


def _pack_member(packet: Packet) -> bytes:
    if packet.type in TOP_LEVEL_TYPES:
        raise ValueError(f"{type_name(packet.type)} cannot stand in a BATCH")
    header = pack_map(packet.header)
    parts = [bytes([packet.type, packet.flags]), pack_varint(len(header)), header]
    return b"".join([*parts, pack_varint(len(packet.payload)), packet.payload])


def _unpack_member(reader: ByteReader) -> Packet:
    number, flags = reader.take(2)
    if number in TOP_LEVEL_TYPES:
        raise CorruptStream(f"{type_name(number)} stands in a BATCH")
    if flags > PacketFlag.CRITICAL | PacketFlag.RANDOM_ACCESS:
        raise CorruptStream(f"{type_name(number)} in a BATCH has impossible flags 0x{flags:02x}")
    size = reader.varint()
    if size > MAX_HEADER_BYTES:
        raise LimitExceeded(f"a header of {size} bytes is longer than the {MAX_HEADER_BYTES} that a reader accepts")
    header = unpack_map(reader.take(size))
    return Packet(
        type=number,
        header=header,
        payload=reader.take(reader.varint()),
        critical=bool(flags & PacketFlag.CRITICAL),
        random_access=bool(flags & PacketFlag.RANDOM_ACCESS),
    )
