# SPDX-License-Identifier: MIT
"""Which header each type of packet has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from threedvc.stream.captured_headers import ColorVideoHeader, DepthVideoHeader, ResidualHeader, VideoHeader
from threedvc.stream.headers import (
    BackdropHeader,
    BackgroundHeader,
    BatchHeader,
    ClockHeader,
    DepthHeader,
    EndHeader,
    FilterHeader,
    GainHeader,
    Header,
    LightHeader,
    ModelHeader,
    ObjectHeader,
    OrderHeader,
    PoseHeader,
    ReliefHeader,
    SensorHeader,
    ShiftHeader,
    SnapshotHeader,
    StreamHeader,
    TextureHeader,
)
from threedvc.stream.packets import TOP_LEVEL_TYPES, Packet

__all__ = ["BATCH_TYPES", "HEADER_TYPES", "read_header"]

HEADER_TYPES: Final[Mapping[int, type[Header]]] = {
    header_type.packet_type: header_type
    for header_type in (
        StreamHeader,
        SensorHeader,
        OrderHeader,
        ObjectHeader,
        ModelHeader,
        ReliefHeader,
        TextureHeader,
        PoseHeader,
        ShiftHeader,
        GainHeader,
        ClockHeader,
        BackdropHeader,
        BackgroundHeader,
        DepthHeader,
        FilterHeader,
        LightHeader,
        VideoHeader,
        ColorVideoHeader,
        DepthVideoHeader,
        ResidualHeader,
        SnapshotHeader,
        BatchHeader,
        EndHeader,
    )
}
"""By type of packet; the others have no keys of their own: META and ATTACHMENT are free, INDEX empty."""

BATCH_TYPES: Final = frozenset(HEADER_TYPES) - TOP_LEVEL_TYPES
"""Types of what is told of frames, which stands in a BATCH only."""


def read_header(packet: Packet) -> Header | None:
    """Read the header of a packet; None if its type has none with keys of its own.

    Raises
    ------
    CorruptStream
        If a required key is missing or a value is not of its type.
    """
    header_type = HEADER_TYPES.get(packet.type)
    return None if header_type is None else header_type.from_map(packet.header)
