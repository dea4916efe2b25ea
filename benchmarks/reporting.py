# SPDX-License-Identifier: MIT
"""Tables that read well both in a terminal and as Markdown, and what to say about the checkout."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

__all__ = ["REPOSITORY", "commit", "markdown_table"]

REPOSITORY = Path(__file__).resolve().parent.parent


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1) -> str:
    """Return a Markdown table with aligned columns.

    Parameters
    ----------
    header, rows
        Cells; every row is as long as the header.
    text_columns
        So many columns from the left hold text and are flush left; the others are flush right.
    """
    widths = [max(3, *(len(row[k]) for row in [header, *rows])) for k in range(len(header))]
    rule = ["-" * width if k < text_columns else "-" * (width - 1) + ":" for k, width in enumerate(widths)]
    return "\n".join(_line(row, widths, text_columns) for row in [header, rule, *rows])


def _line(row: Sequence[str], widths: Sequence[int], text_columns: int) -> str:
    cells = [
        cell.ljust(width) if k < text_columns else cell.rjust(width)
        for k, (cell, width) in enumerate(zip(row, widths, strict=True))
    ]
    return f"| {' | '.join(cells)} |"


def commit() -> str:
    """Return the commit of the checkout, and whether it was changed since; "unknown" without git."""
    try:
        head = _git("rev-parse", "--short", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head} with changes" if changed else head


def _git(*arguments: str) -> str:
    result = subprocess.run(["git", *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    return result.stdout.strip()
