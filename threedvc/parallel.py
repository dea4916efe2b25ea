# SPDX-License-Identifier: MIT
"""Run a kernel over disjoint ranges on several threads.

Kernels release the GIL, and every range writes only its own part of the output, so the result is
the same for any number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

__all__ = ["default_threads", "for_ranges"]

RANGES_PER_THREAD = 8


def default_threads() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="threedvc")


def for_ranges(work: Callable[[int, int], object], count: int, threads: int) -> None:
    """Call ``work(start, stop)`` until the ranges cover ``0..count``.

    Parameters
    ----------
    work
        A function whose calls write to disjoint places.
    count
        Number of items.
    threads
        Number of threads; 1 runs the whole range in the caller's thread.
    """
    if count <= 0:
        return
    if threads <= 1:
        work(0, count)
        return
    step = max(1, -(-count // (threads * RANGES_PER_THREAD)))
    futures = [_pool(threads).submit(work, start, min(start + step, count)) for start in range(0, count, step)]
    for future in futures:
        future.result()
