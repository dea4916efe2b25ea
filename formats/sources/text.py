# SPDX-License-Identifier: MIT
"""Small text and JSON files of a recording, read with errors that name the file and the line."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

from threedvc.errors import SequenceError

__all__ = ["Row", "read_json", "read_json_value", "read_rows", "read_text"]


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
    """Read a UTF-8 text file; raises SequenceError."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read ({error.strerror}); check the file and its permissions") from None
    except UnicodeDecodeError:
        raise SequenceError(f"{path}: is not a text file; check that the file is what its name says") from None


def read_rows(path: Path) -> list[Row]:
    """Read a table of fields separated by white space or commas; empty lines and ``#`` comments are skipped."""
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        fields = line.replace(",", " ").split()
        if fields and not fields[0].startswith("#"):
            rows.append(Row(path, number, tuple(fields)))
    return rows


def read_json(path: Path) -> dict[str, object]:
    """Read a JSON file that holds one object; raises SequenceError."""
    content = read_json_value(path)
    if not isinstance(content, dict):
        raise SequenceError(f"{path}: holds a JSON {type(content).__name__}, expected an object with named values")
    return content


def read_json_value(path: Path) -> object:
    """Read a JSON file; raises SequenceError."""
    try:
        content: object = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise SequenceError(f"{path}:{error.lineno}: is not valid JSON ({error.msg}); correct the file") from None
    return content
