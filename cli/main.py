# SPDX-License-Identifier: MIT
"""Entry point of `3dvc`, and the one place where errors become messages and exit codes."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from typing import Any, NoReturn

import click

from threedvc import __version__
from threedvc.cli.decode import decode
from threedvc.cli.encode import encode
from threedvc.cli.explore import explore
from threedvc.cli.signals import interrupt_behind, interrupt_word, signals_as_interrupts
from threedvc.cli.stats import stats
from threedvc.cli.synth import synth
from threedvc.errors import ThreedvcError

__all__ = ["main"]

TRACEBACK_VARIABLE = "THREEDVC_TRACEBACK"


class Commands(click.Group):
    """The group of commands; whatever a command raises leaves here as one line."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was asked for.

        Raises
        ------
        click.ClickException
            For every error of a command; exit code 1, or 2 for wrong usage.
        """
        try:
            with signals_as_interrupts():
                return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except KeyboardInterrupt as error:
            _end(ctx, error)
        except Exception as error:
            interrupt = interrupt_behind(error)
            if interrupt is not None:
                _end(ctx, interrupt)
            if os.environ.get(TRACEBACK_VARIABLE) or _is_broken_pipe(error):
                raise
            raise click.ClickException(_message(error)) from None


def _end(ctx: click.Context, interrupt: KeyboardInterrupt) -> NoReturn:
    """Say what has ended the command, and exit."""
    word, code = interrupt_word(interrupt)
    with suppress(OSError):  # a terminal that hung up is gone
        click.echo("; ".join([word, *_notes(interrupt)]), err=True)
    ctx.exit(code)


def _is_broken_pipe(error: Exception) -> bool:
    # Click ends quietly with exit code 1 when the reader of standard output has gone.
    return isinstance(error, OSError) and error.errno == errno.EPIPE


def _notes(error: BaseException) -> list[str]:
    # Where an output was broken off, a note says what is left of it.
    return list(getattr(error, "__notes__", []))


def _message(error: Exception) -> str:
    if isinstance(error, ThreedvcError):
        return "; ".join([str(error), *_notes(error)])
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename is not None else error.strerror
    if isinstance(error, MemoryError):
        return "out of memory; try larger cells (--voxel-size) or a smaller picture (--size)"
    text = " ".join(str(error).split())
    return f"internal error, please report it ({type(error).__name__}: {text}); {TRACEBACK_VARIABLE}=1 shows where"


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="3dvc")
def main() -> None:
    """Code RGB-D video of rigid scenes as object models and motion.

    A folder of color and depth pictures goes in, a .3dvc stream of a few kbit/s comes out, and
    decodes at any size, from any viewpoint.
    """


for command in (encode, decode, stats, explore, synth):
    main.add_command(command)
