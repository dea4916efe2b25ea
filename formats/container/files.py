# SPDX-License-Identifier: MIT
"""Streams in files and pipes: a finished file appears under its name, nothing else does."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final, TypeAlias

from threedvc.errors import ConfigError, FormatError, OutputError
from threedvc.formats.container.layout import MAGIC
from threedvc.formats.container.reader import StreamReader
from threedvc.formats.container.writer import StreamWriter
from threedvc.formats.outputs import GrowingFile, check_target, growing_file, is_direct

__all__ = ["check_output", "open_input", "open_output"]

STANDARD_STREAM: Final = "-"

StreamPath: TypeAlias = str | os.PathLike[str]


@contextmanager
def open_input(source: StreamPath | BinaryIO, *, recover: bool = False) -> Iterator[StreamReader]:
    """Open a .3dvc file, standard input if `source` is ``-``, or a binary stream that is open already.

    Raises
    ------
    FormatError
        If the file cannot be opened or is not a .3dvc stream.
    ConfigError
        If standard input is a terminal.
    """
    if not isinstance(source, str | os.PathLike):
        yield StreamReader(source, _name_of(source), recover=recover)
    elif os.fspath(source) == STANDARD_STREAM:
        if sys.stdin.isatty():
            raise ConfigError("standard input is a terminal; pipe a stream in or give a file name")
        yield StreamReader(sys.stdin.buffer, "standard input", recover=recover)
    else:
        with _opened_to_read(source) as stream:
            yield StreamReader(stream, os.fspath(source), recover=recover)


@contextmanager
def open_output(target: StreamPath | BinaryIO, *, force: bool = False) -> Iterator[StreamWriter]:
    """Open a .3dvc file for writing, standard output if `target` is ``-``, or an open binary stream.

    The stream grows beside the file, see `threedvc.formats.outputs`, and takes its name when the block ends without an
    error and END has been written; only then an older stream of that name is replaced. After an error the part is kept
    if it holds frames, and the error gets a note that says so; else it is removed. Pipes and devices are written
    directly.

    Parameters
    ----------
    target
        Where to write.
    force
        Whether a file that is no stream may be replaced.

    Raises
    ------
    OutputError
        If the file may not or cannot be written, another run writes it, or the block ends without END.
    ConfigError
        If standard output is a terminal.
    BrokenPipeError
        If the reader at the other end of a pipe has gone.
    """
    if not isinstance(target, str | os.PathLike):
        opened = _written_to(target, _name_of(target))
    elif os.fspath(target) == STANDARD_STREAM:
        if sys.stdout.isatty():
            raise ConfigError("standard output is a terminal; redirect it or give a file name")
        opened = _written_to(sys.stdout.buffer, "standard output")
    else:
        check_output(target, force=force)
        name = os.fspath(target)
        opened = _direct(Path(target), name) if is_direct(target) else _part_file(target, name)
    with opened as writer:
        yield writer


def check_output(target: StreamPath, *, force: bool = False) -> None:
    """Check that a stream may be written under a name, where it is one; raises OutputError."""
    if os.fspath(target) != STANDARD_STREAM:
        check_target(target, lambda head: head.startswith(MAGIC), "stream", force=force)


def _name_of(stream: BinaryIO) -> str:
    name = getattr(stream, "name", None)
    return name if isinstance(name, str) else "stream"


@contextmanager
def _written_to(sink: BinaryIO, name: str) -> Iterator[StreamWriter]:
    writer = StreamWriter(sink, name)
    yield writer
    writer.close()


@contextmanager
def _direct(target: Path, name: str) -> Iterator[StreamWriter]:
    with _opened(target, name) as sink, _written_to(sink, name) as writer:
        yield writer


@contextmanager
def _part_file(target: StreamPath, name: str) -> Iterator[StreamWriter]:
    writer: StreamWriter | None = None
    growing: GrowingFile | None = None
    try:
        with growing_file(target) as growing:
            writer = StreamWriter(growing.sink, name)
            yield writer
            writer.close()
            if not writer.ended:
                raise OutputError(f"{name}: the stream was not brought to its END")
    except BaseException as error:
        if growing is not None and not growing.published:
            _keep_or_remove(growing.part, writer.frames if writer is not None else 0, error)
        raise


def _keep_or_remove(part: Path, frames: int, error: BaseException) -> None:
    if frames:
        error.add_note(f"kept {part}: {frames} frames can be decoded")
    else:
        part.unlink(missing_ok=True)


def _opened_to_read(path: StreamPath) -> BinaryIO:
    try:
        return open(path, "rb")
    except OSError as error:
        raise FormatError(f"{os.fspath(path)}: cannot be opened: {error.strerror or error}") from None


def _opened(path: Path, name: str) -> BinaryIO:
    try:
        return open(path, "wb")
    except OSError as error:
        raise _unwritable(name, error) from None


def _unwritable(name: str, error: OSError) -> OutputError:
    return OutputError(f"{name}: cannot be written ({error.strerror or error}); choose another place")
