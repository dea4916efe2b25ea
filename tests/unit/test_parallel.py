# SPDX-License-Identifier: MIT
"""Ranges on threads: what they cover, errors, interrupts, and children after fork."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from threedvc.parallel import for_ranges

TIME_LIMIT_S = 60.0
"""A child that hangs is ended after this; one that works takes far less."""

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 7, 16, 1000])
def test_ranges_cover_every_item_once(count: int, threads: int) -> None:
    seen = np.zeros(count, np.int64)

    def add(start: int, stop: int) -> None:
        seen[start:stop] += 1

    for_ranges(add, count, threads)
    assert (seen == 1).all()


def test_slow_ranges_of_one_thread_are_short() -> None:
    ranges = []

    def work(start: int, stop: int) -> None:
        ranges.append((start, stop))
        time.sleep(0.02 * (stop - start))

    for_ranges(work, 32, 1)
    assert [start for start, _ in ranges] == [0, *(stop for _, stop in ranges[:-1])]
    assert max(stop - start for start, stop in ranges) <= 5


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_leaves_out_what_has_not_begun(threads: int) -> None:
    done = []

    def work(start: int, stop: int) -> None:
        if start == 0:
            raise RuntimeError("the first range")
        time.sleep(0.01)
        done.append((start, stop))

    with pytest.raises(RuntimeError, match="the first range"):
        for_ranges(work, 10_000, threads)
    assert len(done) < 8 * threads
    for_ranges(lambda start, stop: None, 100, threads)


def doubled(values: np.ndarray) -> np.ndarray:
    out = np.zeros_like(values)

    def work(start: int, stop: int) -> None:
        out[start:stop] = 2 * values[start:stop]

    for_ranges(work, len(values), 2)
    return out


def child(results: multiprocessing.Queue[int]) -> None:
    results.put(int(doubled(np.arange(100)).sum()))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_has_threads_of_its_own() -> None:
    doubled(np.arange(100))
    fork = multiprocessing.get_context("fork")
    results: multiprocessing.Queue[int] = fork.Queue()
    children = [fork.Process(target=child, args=(results,)) for _ in range(2)]
    for process in children:
        process.start()
    try:
        assert [results.get(timeout=TIME_LIMIT_S) for _ in children] == [9900, 9900]
    finally:
        for process in children:
            process.kill()
            process.join()
    assert doubled(np.arange(100)).sum() == 9900


ENDLESS = """
import time
from numba import njit
import numpy as np
from threedvc.parallel import for_ranges

@njit(nogil=True)
def spin(flag):
    while flag[0] == 0:
        flag[1] += 1

flag = np.zeros(2, np.int64)
flag[0] = 1
spin(flag)
flag[0] = 0
print("ready", flush=True)
for_ranges(lambda start, stop: spin(flag), 1000, 2)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGINT") or os.name != "posix", reason="needs signals")
def test_an_interrupt_ends_a_program_whose_kernel_never_ends() -> None:
    command = [sys.executable, "-c", ENDLESS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout is not None
            assert program.stdout.readline() == "ready\n"
            time.sleep(0.3)
            program.send_signal(signal.SIGINT)
            _, errors = program.communicate(timeout=TIME_LIMIT_S)
        finally:
            program.kill()
    assert program.returncode in (-signal.SIGINT, 1, 130)
    assert "KeyboardInterrupt" in errors


def test_threads_are_kept_between_calls() -> None:
    doubled(np.arange(10))
    before = threading.active_count()
    doubled(np.arange(10))
    assert threading.active_count() == before
