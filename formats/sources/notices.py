# SPDX-License-Identifier: MIT
"""What a reader decides about a recording and its user should know: one line each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

__all__ = ["Notice", "NoticedSequence", "notices_of"]


@dataclass(frozen=True)
class Notice:
    """A decision about a recording, or a doubt.

    Attributes
    ----------
    text
        One line: the file, the values, what was decided, and how to decide otherwise.
    warning
        Whether the recording is probably not what it seems; else it is only read in a way that could be another one.
    """

    text: str
    warning: bool = False

    def __str__(self) -> str:
        return f"{'Warning' if self.warning else 'Note'}: {self.text}"


@runtime_checkable
class NoticedSequence(Protocol):
    """A source of frames with something to tell."""

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What was decided while it was opened."""
        ...


def notices_of(sequence: Any) -> tuple[Notice, ...]:
    """Return what a source of frames has to tell, nothing for one that cannot."""
    return sequence.notices if isinstance(sequence, NoticedSequence) else ()
