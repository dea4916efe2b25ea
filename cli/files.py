# SPDX-License-Identifier: MIT
"""Files that commands write themselves."""

from __future__ import annotations

from pathlib import Path

from threedvc.errors import OutputError

__all__ = ["write_file"]


def write_file(path: Path, data: bytes) -> None:
    """Write a whole file; its name never shows half of it.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
