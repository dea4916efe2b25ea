# SPDX-License-Identifier: MIT
"""Files that 3dvc writes: whole under their names or not at all, and never in the place of what it did not write.

A file grows beside its name, in ``NAME.part`` or, where an interrupted run left one, in ``NAME.2.part`` and so on, and
takes its name when it is complete. While it grows it is locked, so that a second run for the same name is refused.
Links are followed; pipes and devices are written directly.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import BinaryIO

from threedvc.errors import OutputError

with suppress(ImportError):
    import fcntl

__all__ = ["GrowingFile", "Kind", "check_target", "growing_file", "is_direct", "locked_folder", "write_output"]

TRIES = 20
"""To get a lock, in the course of a second: another run holds it only while it looks for a name."""
LOCKS = find_spec("fcntl") is not None
"""Not on Windows: there two runs for one name are not told apart."""
HEAD_BYTES = 1 << 20
"""Bytes of a file by which its kind is known: all of a plot's, whose maker may stand at the end."""

Kind = Callable[[bytes], bool]
"""Tells by the first bytes of a file whether 3dvc wrote it, as an output of this kind."""


@dataclass
class GrowingFile:
    """A file that is being written under a name of its own.

    Attributes
    ----------
    sink
        Takes the bytes.
    part
        The name that it has so far.
    published
        Whether it has taken its name.
    """

    sink: BinaryIO
    part: Path
    published: bool = False


def is_direct(target: str | os.PathLike[str]) -> bool:
    """Tell whether a target is a pipe or a device, which is written directly and never replaced."""
    try:
        mode = os.stat(target).st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def check_target(target: str | os.PathLike[str], kind: Kind, what: str, *, force: bool = False) -> None:
    """Check that a file may be written under a name.

    Parameters
    ----------
    target
        The name.
    kind
        Tells earlier outputs of the same kind, which may be replaced; so may empty files.
    what
        The kind in words, for the message.
    force
        Whether any file may be replaced.

    Raises
    ------
    OutputError
        If it is a folder, or a file that is no earlier output.
    """
    name = os.fspath(target)
    if os.path.isdir(target):
        raise OutputError(f"{name}: is a folder; give the name of a file")
    folder = os.path.dirname(os.path.realpath(target))
    if not os.path.isdir(folder):
        raise OutputError(f"{name}: cannot be written (No such file or directory); choose another place")
    if force or is_direct(target) or not os.path.exists(target):
        return
    try:
        with open(target, "rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise _unwritable(name, error) from None
    if head and not kind(head):
        raise OutputError(f"{name}: is a file, but no {what} that 3dvc wrote; choose another name, or give --force")


@contextmanager
def growing_file(target: str | os.PathLike[str]) -> Iterator[GrowingFile]:
    """Open a file that takes its name when the block ends without an error.

    After an error it stays under the name that it had, for whoever opened it to keep or remove.

    Raises
    ------
    OutputError
        If it cannot be written, or is being written by another run.
    """
    name, path = os.fspath(target), Path(os.path.realpath(target))
    growing = _claimed(path, name)
    try:
        yield growing
        try:
            growing.sink.flush()
            with _passing_over(errno.EINVAL, errno.ENOTSUP):  # file systems that cannot promise it
                os.fsync(growing.sink.fileno())
            os.replace(growing.part, path)
            growing.published = True
        except OSError as error:
            raise _unwritable(name, error) from None
    finally:
        # Its lock goes with it.
        with suppress(OSError):
            growing.sink.close()


def write_output(target: str | os.PathLike[str], data: bytes, kind: Kind, what: str, *, force: bool = False) -> None:
    """Write a whole file; see `check_target` for the parameters.

    Raises
    ------
    OutputError
        If it may not or cannot be written; nothing is left of it then.
    """
    check_target(target, kind, what, force=force)
    if is_direct(target):
        try:
            Path(target).write_bytes(data)
        except OSError as error:
            raise _unwritable(os.fspath(target), error) from None
        return
    growing: GrowingFile | None = None
    try:
        with growing_file(target) as growing:
            growing.sink.write(data)
    except BaseException as error:
        if growing is not None and not growing.published:
            growing.part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise _unwritable(os.fspath(target), error) from None
        raise


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Hold a folder for the time of a block, so that no other run writes into it.

    Raises
    ------
    OutputError
        If another run does.
    """
    handle = os.open(folder, os.O_RDONLY) if LOCKS else -1
    try:
        for _ in range(TRIES):
            if _locked(handle):
                break
            time.sleep(1 / TRIES)
        else:
            raise OutputError(f"{folder}: is being written by another 3dvc; wait for it, or choose another folder")
        yield
    finally:
        if handle >= 0:
            os.close(handle)


@contextmanager
def _passing_over(*numbers: int) -> Iterator[None]:
    """Pass over the system's errors of some numbers."""
    try:
        yield
    except OSError as error:
        if error.errno not in numbers:
            raise


def _claimed(path: Path, name: str) -> GrowingFile:
    """Make a file beside a name, under a name that nothing has."""
    try:
        with _held_briefly(path.parent):
            there = [other for other in path.parent.iterdir() if _is_part_of(other, path)]
            growing = next(filter(_is_growing, there), None)
            if growing is not None:
                raise OutputError(
                    f"{name}: is being written by another 3dvc, in {growing}; wait for it, or choose another name"
                )
            names = (f"{path.name}.part" if number == 1 else f"{path.name}.{number}.part" for number in count(1))
            part = next(path.with_name(free) for free in names if not os.path.lexists(path.with_name(free)))
            sink = part.open("xb")
            try:
                _locked(sink.fileno())
                return GrowingFile(sink, part)
            except BaseException:
                part.unlink(missing_ok=True)
                raise
    except OSError as error:
        raise _unwritable(name, error) from None


def _is_part_of(other: Path, path: Path) -> bool:
    return re.fullmatch(re.escape(path.name) + r"(\.\d+)?\.part", other.name) is not None


@contextmanager
def _held_briefly(folder: Path) -> Iterator[None]:
    """Let one run at a time look for a free name in a folder."""
    if not LOCKS:
        yield
        return
    handle = -1
    with suppress(OSError):  # a folder that may not be read
        handle = os.open(folder, os.O_RDONLY)
    try:
        # Another run may hold the folder for long: a second is enough for one that looks for a name.
        for _ in range(TRIES if handle >= 0 else 0):
            if _locked(handle):
                break
            time.sleep(1 / TRIES)
        yield
    finally:
        if handle >= 0:
            os.close(handle)


def _is_growing(part: Path) -> bool:
    """Tell whether another run writes a file."""
    if not LOCKS:
        return False
    try:
        handle = os.open(part, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        return not _locked(handle, fcntl.LOCK_SH)
    finally:
        os.close(handle)


def _locked(handle: int, kind: int | None = None) -> bool:
    """Lock an open file, by default against all others; return False if another run holds it."""
    if not LOCKS:
        return True
    try:
        fcntl.flock(handle, (fcntl.LOCK_EX if kind is None else kind) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


def _unwritable(name: str, error: OSError) -> OutputError:
    return OutputError(f"{name}: cannot be written ({error.strerror or error}); choose another place")
