# SPDX-License-Identifier: MIT
"""Write docs/cli.md, the list of all commands and options, from the commands themselves."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import click

from threedvc.cli.main import main as commands

__all__ = ["main", "reference"]

INTRODUCTION = """\
# Commands

Written by `make docs` from the commands' own help. Lengths are `8mm`, `1cm`, `0.02m` or a number of meters. Results go
to standard output, progress and messages to standard error. The exit code is 0 after success, 1 after an error, which
is one line that names the file, the value and the remedy, and 2 after wrong usage.
"""


def reference() -> str:
    """Return the text of docs/cli.md."""
    sections = [section(name, command) for name, command in sorted(commands.commands.items())]
    return "\n".join([INTRODUCTION, *sections])


def section(name: str, command: click.Command) -> str:
    """Return the section of one command."""
    arguments = [parameter.metavar or "" for parameter in command.params if isinstance(parameter, click.Argument)]
    rows = [option_row(parameter) for parameter in command.params if isinstance(parameter, click.Option)]
    usage = " ".join(["3dvc", name, *arguments, "[OPTIONS]"])
    text = "\n\n".join(map(paragraph, inspect.cleandoc(command.help or "").split("\n\n")))
    return "\n".join([f"## {name}\n", f"    {usage}\n", f"{text}\n", "| option | meaning |", "|---|---|", *rows, ""])


def paragraph(text: str) -> str:
    """Return a paragraph of help; one that click must not wrap (marked by a backspace) becomes a block of code."""
    mark, _, lines = text.partition("\n")
    return "\n".join(f"    {line}" for line in lines.splitlines()) if mark == "\b" else text


def option_row(option: click.Option) -> str:
    """Return the line of one option."""
    value = "" if option.is_flag else f" {value_name(option)}"
    default = f" Default: {option.default}." if option.show_default and not option.is_flag else ""
    meaning = re.sub(r"\s*\[default: (.*)\]", r" Default: \1.", option.help or "")
    cells = (f"`{', '.join(option.opts)}{value}`", meaning + default)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def value_name(option: click.Option) -> str:
    """Return what stands for an option's value: its choices, or its name."""
    if option.metavar:
        return option.metavar
    if isinstance(option.type, click.Choice):
        return "|".join(map(str, option.type.choices))
    return option.type.name.upper()


def main() -> None:
    """Write the file."""
    Path(__file__).with_name("cli.md").write_text(reference(), encoding="utf-8")


if __name__ == "__main__":
    main()
