# SPDX-License-Identifier: MIT
"""Progress on standard error: one line that is rewritten on a terminal, silence elsewhere."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self, TextIO

__all__ = ["Progress"]

SECONDS_BETWEEN_LINES = 0.1
"""Ten times a second looks alive and takes no time."""


class Progress:
    """Shows frames done, frames per second and the rate so far; a context manager that clears its line.

    Parameters
    ----------
    label
        First word of the line.
    total
        Number of frames, or None where it is not known.
    fps
        Nominal frame rate, needed to show kbit/s.
    stream
        Where to write; standard error if None.
    """

    def __init__(self, label: str, total: int | None, fps: float | None = None, stream: TextIO | None = None) -> None:
        self._label = label
        self._total = total
        self._fps = fps
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._started = time.monotonic()
        self._pass = 1
        self._shown = -SECONDS_BETWEEN_LINES
        self._width = 0
        self.frames = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._write("")

    @property
    def seconds(self) -> float:
        """Time since the start of this pass over the frames."""
        return time.monotonic() - self._started

    @property
    def frames_per_second(self) -> float:
        """Frames done per second in this pass."""
        return self.frames / max(self.seconds, 1e-9)

    def advance(self, frames: int, stream_bytes: int = 0) -> None:
        """Tell how many frames are done and how many bytes of stream there are for them.

        A number that falls begins another pass over the frames.
        """
        if frames < self.frames:
            self._pass += 1
            self._started, self._shown = time.monotonic(), -SECONDS_BETWEEN_LINES
        self.frames = frames
        if self._terminal and self.seconds - self._shown >= SECONDS_BETWEEN_LINES:
            self._shown = self.seconds
            self._write(self._line(stream_bytes))

    def summary(self, text: str) -> None:
        """Write the final line, on a terminal or not."""
        self._write("")
        print(text, file=self._stream, flush=True)

    def _line(self, stream_bytes: int) -> str:
        of_total = f"/{self._total}" if self._total is not None else ""
        label = self._label if self._pass == 1 else f"{self._label}, pass {self._pass}"
        line = f"{label}: frame {self.frames}{of_total}, {self.frames_per_second:.1f} frames/s"
        if self._fps is not None and stream_bytes and self.frames:
            line += f", {stream_bytes * 8 * self._fps / self.frames / 1000:.1f} kbit/s"
        return line

    def _write(self, line: str) -> None:
        if self._terminal and (line or self._width):
            self._stream.write("\r" + line.ljust(self._width) + ("" if line else "\r"))
            self._stream.flush()
            self._width = len(line)
