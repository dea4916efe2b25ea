# SPDX-License-Identifier: MIT
"""Small text and JSON files of a recording, read with errors that name the file and the line."""

from __future__ import annotations

import codecs
import json
import math
from dataclasses import dataclass
from pathlib import Path

from threedvc.errors import SequenceError

__all__ = ["Row", "read_json", "read_json_value", "read_lines", "read_rows", "read_text", "require_file"]

COMMENTS = ("#", "//", ";")
MAX_DIGITS = 20
"""Of an integer: 64 bits take 20, and text of any length must not be turned into numbers."""


@dataclass(frozen=True)
class Row:
    """One line of a table: where it stands and its fields."""

    path: Path
    line: int
    fields: tuple[str, ...]

    @property
    def place(self) -> str:
        """File and line, for messages."""
        return f"{self.path}:{self.line}"

    def integer(self, column: int) -> int:
        """Return a field as an integer; raises SequenceError."""
        try:
            if len(self.fields[column]) > MAX_DIGITS:
                raise ValueError
            return int(self.fields[column])
        except ValueError:
            raise SequenceError(
                f"{self.place}: {self.fields[column]!r} is not an integer; correct column {column + 1}"
            ) from None

    def floats(self, start: int = 0) -> list[float]:
        """Return the fields from `start` on as finite floats; raises SequenceError."""
        return [self._finite(field) for field in self.fields[start:]]

    def _finite(self, field: str) -> float:
        try:
            value = float(field)
        except ValueError:
            raise SequenceError(f"{self.place}: {field!r} is not a number; correct the line") from None
        if not math.isfinite(value):
            raise SequenceError(f"{self.place}: {field!r} is not a finite number; correct the line or remove the file")
        return value


def read_text(path: Path) -> str:
    """Read a text file: UTF-8, or UTF-16 if it says so; comments may be in any encoding.

    Raises
    ------
    SequenceError
        If it is no regular file, cannot be read, or is no text.
    """
    require_file(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read ({error.strerror}); check the file and its permissions") from None
    try:
        text = _decoded(data)
    except UnicodeDecodeError:
        raise SequenceError(f"{path}: is not a text file; check that the file is what its name says") from None
    if "\0" in text:
        raise SequenceError(
            f"{path}: is not a text file (it holds zero bytes); check that the file is what its name says"
        )
    return text


def require_file(path: Path) -> None:
    """Check that a path is no FIFO, device, socket or folder: reading one could wait for ever.

    Raises
    ------
    SequenceError
        If it is there, but no regular file.
    """
    if path.exists() and not path.is_file():
        raise SequenceError(f"{path}: is no regular file; put the file itself there")


def _decoded(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Old programs write comments and names in the code of their country; numbers read the same.
        lines = data.removeprefix(codecs.BOM_UTF8).splitlines(keepends=True)
        if all(line.isascii() or line.lstrip().startswith(b"#") for line in lines):
            return data.decode("latin-1")
        raise


def read_rows(path: Path) -> list[Row]:
    """Read a table of fields separated by white space or commas; empty lines and comments are skipped."""
    return [Row(path, number, tuple(line.replace(",", " ").split())) for number, line in read_lines(path)]


def read_lines(path: Path) -> list[tuple[int, str]]:
    """Read the lines of a table with their numbers, from 1, without empty ones and comments (``#``, ``//``, ``;``)."""
    lines = enumerate((line.strip() for line in read_text(path).splitlines()), start=1)
    return [(number, line) for number, line in lines if line.strip(" ,") and not line.startswith(COMMENTS)]


def read_json(path: Path) -> dict[str, object]:
    """Read a JSON file that holds one object; raises SequenceError."""
    content = read_json_value(path)
    if not isinstance(content, dict):
        raise SequenceError(f"{path}: holds a JSON {type(content).__name__}, expected an object with named values")
    return content


def read_json_value(path: Path) -> object:
    """Read a JSON file; raises SequenceError."""
    try:
        content: object = json.loads(read_text(path), parse_int=_whole)
    except json.JSONDecodeError as error:
        raise SequenceError(f"{path}:{error.lineno}: is not valid JSON ({error.msg}); correct the file") from None
    except RecursionError:
        raise SequenceError(f"{path}: is JSON nested too deep; correct the file") from None
    return content


def _whole(digits: str) -> int | float:
    """Return an integer, as a float if it has more digits than any number here can mean."""
    return int(digits) if len(digits) <= MAX_DIGITS else float(digits)
