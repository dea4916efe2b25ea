# SPDX-License-Identifier: MIT
"""What META packets tell beside the frames, of every kind that has a module in `threedvc.stream.notes`."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from typing import ClassVar, Protocol, TypeVar

from threedvc.stream import notes
from threedvc.stream.packets import Packet

__all__ = ["Note", "StreamNotes"]


class Note(Protocol):
    """Gathers the META packets of one kind; made anew for each stream."""

    kind: ClassVar[str]
    """The text under ``k`` in the header of its packets."""

    def add(self, packet: Packet) -> None:
        """Note what a packet of this kind tells.

        Raises
        ------
        CorruptStream
            If the packet is malformed.
        """


N = TypeVar("N", bound=Note)
NOTES: tuple[type[Note], ...] = tuple(
    import_module(f"{notes.__name__}.{module.name}").NOTE for module in pkgutil.iter_modules(notes.__path__)
)


class StreamNotes:
    """The notes of a stream, gathered wherever they stand."""

    def __init__(self) -> None:
        self._notes: dict[str, Note] = {note.kind: note() for note in NOTES}

    def add(self, packet: Packet) -> None:
        """Note what a META packet tells, if it is of a kind that this reader knows."""
        kind = packet.header.get("k")
        if isinstance(kind, str) and kind in self._notes:
            self._notes[kind].add(packet)

    def of(self, note: type[N]) -> N:
        """Return what was gathered of one kind."""
        found = self._notes[note.kind]
        assert isinstance(found, note)
        return found
