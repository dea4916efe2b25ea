# SPDX-License-Identifier: MIT
"""Keeps threads of this process in the scheduling class that they have.

An encoder that runs as root may put itself and its caller into the real-time class, as SVT-AV1 does. What the caller
does next, and every process that it starts, would then leave nothing to others.
"""

from __future__ import annotations

import os
from contextlib import suppress

__all__ = ["TASKS", "SchedulingGuard"]

TASKS = "/proc/self/task"
"""Where Linux lists the threads of a process."""


class SchedulingGuard:
    """Remembers the scheduling class of this thread, and restores it; does nothing where there is no such thing."""

    def __init__(self) -> None:
        self._known = hasattr(os, "sched_getscheduler")
        if self._known:
            self._policy, self._priority = os.sched_getscheduler(0), os.sched_getparam(0)

    def restore(self) -> None:
        """Put this thread, and threads that have the class it was put into, back into the remembered one."""
        if not self._known or os.sched_getscheduler(0) == self._policy:
            return
        raised = os.sched_getscheduler(0)
        with suppress(OSError):
            os.sched_setscheduler(0, self._policy, self._priority)
        for task in map(int, os.listdir(TASKS) if os.path.isdir(TASKS) else ()):
            with suppress(OSError):  # a thread may have ended
                if os.sched_getscheduler(task) == raised:
                    os.sched_setscheduler(task, self._policy, self._priority)
