# SPDX-License-Identifier: MIT
"""Compiled loops: pure functions on arrays, one file per stage.

`kernel` holds every JIT option of the project. No kernel uses ``fastmath`` or Numba's own threads:
kernels release the GIL and `threedvc.parallel` runs them over disjoint ranges, so results do not
depend on the number of threads.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

__all__ = ["inlined", "kernel", "lean"]

F = TypeVar("F", bound=Callable[..., Any])


@cache
def cache_directory() -> str | None:
    """Return a writable folder for compiled code, keyed by a hash of all kernel sources.

    Numba notices a change in a kernel's own file only, not in a helper file that it calls; a new
    folder for each state of the sources can never serve stale code. None: nowhere to write.
    """
    digest = hashlib.sha256()
    root = Path(__file__).parent
    for path in sorted([*root.rglob("*.py"), root.parent / "units.py"]):  # kernels take constants from it
        digest.update(str(path.relative_to(root.parent)).encode())
        digest.update(path.read_bytes())
    base = os.environ.get("NUMBA_CACHE_DIR") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache"), "threedvc"
    )
    folder = os.path.join(base, f"kernels-{digest.hexdigest()[:16]}")
    try:
        os.makedirs(folder, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return None


def kernel(function: F) -> F:
    """Compile a loop lazily, with a disk cache where one can be written."""
    return _compiled(function, inline="never")


def lean(function: F) -> F:
    """Compile a loop that makes no array, without counting references.

    Its callers hold the arrays. Counting them where functions call each other for every bit takes longer than the bits.
    """
    return _compiled(function, inline="never", counting=False)


def inlined(function: F) -> F:
    """Compile a function into every kernel that calls it.

    For small functions of arrays in the midst of loops: a call counts the references of every array passed, by atomic
    operations on counters that all threads share.
    """
    return _compiled(function, inline="always")


def _compiled(function: F, inline: str, counting: bool = True) -> F:
    folder = cache_directory()
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = folder or before
    options = {"nogil": True, "error_model": "numpy", "fastmath": False, "inline": inline, "_nrt": counting}
    try:
        compiled = numba.njit(cache=folder is not None, **options)(function)
    finally:
        numba.config.CACHE_DIR = before
    return cast(F, compiled)
