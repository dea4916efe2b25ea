# SPDX-License-Identifier: MIT
"""Signals that end a command: SIGTERM and SIGHUP clean up as an interrupt does, and a live encode ends its stream."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TypeAlias

__all__ = [
    "StopRequest",
    "Terminated",
    "interrupt_behind",
    "interrupt_word",
    "signals_as_interrupts",
    "stop_on_signals",
]

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
WORDS = {"SIGINT": "Interrupted", "SIGTERM": "Terminated", "SIGHUP": "Hung up"}

Handler: TypeAlias = Callable[[int, FrameType | None], object]


class Terminated(KeyboardInterrupt):
    """A signal has asked the program to end.

    Attributes
    ----------
    number
        The signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


class StopRequest:
    """Whether a signal has asked for an end, and which; call it to know."""

    def __init__(self) -> None:
        self.number: int | None = None

    def __call__(self) -> bool:
        """Tell whether an end was asked for."""
        return self.number is not None


def interrupt_behind(error: BaseException) -> KeyboardInterrupt | None:
    """Return the interrupt that led to an error, if one did: one that comes within a lock may leave it in disorder."""
    seen: BaseException | None = error
    while seen is not None and not isinstance(seen, KeyboardInterrupt):
        seen = seen.__context__
    return seen


def interrupt_word(error: KeyboardInterrupt) -> tuple[str, int]:
    """Return what to say of an interrupt, and the exit code: 128 and the number of the signal."""
    number = error.number if isinstance(error, Terminated) else int(signal.SIGINT)
    return WORDS[signal.Signals(number).name], 128 + number


@contextmanager
def signals_as_interrupts() -> Iterator[None]:
    """Let signals that end programs raise `Terminated` in a block; those that are ignored stay so, as nohup asks."""

    def end(number: int, _frame: FrameType | None) -> None:
        for other in ENDING:  # a second one must not break off the cleaning up; an interrupt from the keyboard may
            signal.signal(other, signal.SIG_IGN)
        raise Terminated(number)

    with _handled([number for number in ENDING if signal.getsignal(number) == signal.SIG_DFL], end):
        yield


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Let the first signal in a block only ask for an end; a second one raises as without it."""
    request = StopRequest()
    before: dict[int, object] = {}

    def ask(number: int, _frame: FrameType | None) -> None:
        request.number = number
        for other, handler in before.items():
            signal.signal(other, handler)  # type: ignore[arg-type]

    chosen = [number for number in (signal.SIGINT, *ENDING) if signal.getsignal(number) != signal.SIG_IGN]
    before.update({number: signal.getsignal(number) for number in chosen})
    with _handled(chosen, ask):
        yield request


@contextmanager
def _handled(numbers: list[signal.Signals], handler: Handler) -> Iterator[None]:
    """Handle signals in a block. Only the main thread of a program hears them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
