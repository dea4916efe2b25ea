# SPDX-License-Identifier: MIT
"""What is told of a command that a signal has ended."""

from __future__ import annotations

import signal

import click
from click.testing import CliRunner

from threedvc.cli.main import Commands
from threedvc.cli.signals import Terminated, interrupt_behind


def fail_within_a_lock() -> None:
    """Fail as a lock does whose holder was interrupted."""
    try:
        raise Terminated(signal.SIGTERM)
    finally:
        raise RuntimeError("cannot release un-acquired lock")


def test_an_interrupt_within_a_lock_is_told_as_an_interrupt() -> None:
    group = Commands(name="3dvc", commands={"work": click.Command("work", callback=fail_within_a_lock)})
    result = CliRunner().invoke(group, ["work"])
    assert result.exit_code == 128 + signal.SIGTERM
    assert result.stderr == "Terminated\n"


def test_an_error_without_an_interrupt_has_none_behind_it() -> None:
    assert interrupt_behind(RuntimeError("of its own")) is None
