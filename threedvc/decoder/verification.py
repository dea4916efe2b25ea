# SPDX-License-Identifier: MIT
"""A decoder that follows an encoder, and compares what both arrive at."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from threedvc.decoder.decoder import Decoder
from threedvc.errors import CorruptStream
from threedvc.stream.packets import Packet, PacketType

__all__ = ["verified"]


def verified(packets: Iterable[Packet]) -> Iterator[Packet]:
    """Pass packets on while a decoder follows them.

    Raises
    ------
    CorruptStream
        If the decoder cannot follow, or arrives at another model than the encoder's.
    """
    decoder = Decoder()
    kept: list[Packet] = []

    def passing() -> Iterator[Packet]:
        for packet in packets:
            kept.append(packet)
            yield packet

    for _ in decoder.frames(passing()):
        while kept:
            yield kept.pop(0)
    while kept:
        packet = kept.pop(0)
        yield packet
        if packet.type == PacketType.END and not decoder.complete:
            raise CorruptStream("verification failed: the decoder did not reach the encoder's model")
