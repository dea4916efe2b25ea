# SPDX-License-Identifier: MIT
"""Run a kernel over disjoint ranges on several threads.

Kernels release the GIL, and every range writes only its own part of the output, so the result is
the same for any number of threads.

The threads are daemons: an interrupted program ends without waiting for the ranges that still run. A
child process after fork has none of its parent's threads, so it starts its own.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future
from functools import cache
from queue import SimpleQueue
from threading import Thread
from time import perf_counter

__all__ = ["default_threads", "for_ranges"]

RANGES_PER_THREAD = 8
RANGE_S = 0.1
"""About how long one range of a single thread may take: signals are heard between ranges."""

Work = Callable[[int, int], object]
Queue = SimpleQueue[tuple["Future[None]", Work, int, int]]


def default_threads() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _queue(threads: int) -> Queue:
    """Return what feeds a given number of threads of this process."""
    queue: Queue = SimpleQueue()
    for number in range(threads):
        Thread(target=_serve, args=(queue,), name=f"threedvc-{number}", daemon=True).start()
    return queue


# A child process has none of its parent's threads: it would wait for ever for a queue that it took over by fork.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_queue.cache_clear)


def _serve(queue: Queue) -> None:
    while True:
        _run(*queue.get())


def _run(future: Future[None], work: Work, start: int, stop: int) -> None:
    if not future.set_running_or_notify_cancel():
        return
    try:
        work(start, stop)
    except BaseException as error:
        future.set_exception(error)
    else:
        future.set_result(None)


def for_ranges(work: Work, count: int, threads: int) -> None:
    """Call ``work(start, stop)`` until the ranges cover ``0..count``.

    An exception, an interrupt among them, leaves out the ranges that have not begun.

    Parameters
    ----------
    work
        A function whose calls write to disjoint places.
    count
        Number of items.
    threads
        Number of threads; 1 runs the ranges in the caller's thread.
    """
    if count <= 0:
        return
    if threads <= 1:
        _in_this_thread(work, count)
        return
    step = max(1, -(-count // (threads * RANGES_PER_THREAD)))
    queue = _queue(threads)
    futures: list[Future[None]] = []
    try:
        for start in range(0, count, step):
            futures.append(Future())
            queue.put((futures[-1], work, start, min(start + step, count)))
        for future in futures:
            future.result()
    finally:
        for future in futures:
            future.cancel()


def _in_this_thread(work: Work, count: int) -> None:
    """Run a first small range, then ranges of about `RANGE_S` by what that took."""
    start, step = 0, -(-count // RANGES_PER_THREAD)
    while start < count:
        began = perf_counter()
        stop = min(start + step, count)
        work(start, stop)
        taken = max(perf_counter() - began, 1e-6)
        step = max(1, min(count, int((stop - start) * RANGE_S / taken)))
        start = stop
