# SPDX-License-Identifier: MIT
"""Fixtures and settings shared by all tests."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from threedvc.coding.video import still
from threedvc.encoder.packetizer.captured import depth_run

REPOSITORY = Path(__file__).resolve().parent.parent

# No deadline: the first call of a kernel compiles it. CI sees the same examples every time; make fuzz asks for more.
EXAMPLES = int(os.environ.get("THREEDVC_EXAMPLES", "30"))
settings.register_profile("3dvc", deadline=None, max_examples=EXAMPLES, derandomize="CI" in os.environ, print_blob=True)
settings.load_profile("3dvc")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave recorded sequences to make test-long: they are where somebody put them, and take minutes."""
    for item in items:
        if "data_dir" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.long)


@pytest.fixture(scope="session")
def repository() -> Path:
    """Return the top folder of the checkout."""
    return REPOSITORY


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Return the folder of recorded sequences; skip where there is none."""
    folder = Path(os.environ.get("THREEDVC_DATA") or REPOSITORY.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"no recorded sequences at {folder}; set THREEDVC_DATA to their folder")
    return folder


@pytest.fixture
def sequence_dir(data_dir: Path) -> Callable[[str], Path]:
    """Return a function from the name of a recorded sequence to its folder; it skips where absent."""

    def find(name: str) -> Path:
        folder = data_dir / name
        if not folder.is_dir():
            pytest.skip(f"sequence {name} is not in {data_dir}")
        return folder

    return find


@pytest.fixture(scope="module")
def quick_av1() -> Iterator[None]:
    """Have pictures and videos coded with less effort, for tests of streams: a third of the time, hardly more bytes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(still, "QUICK_PRESET", 8)
        patch.setattr(still, "THOROUGH_PRESET", 8)
        patch.setattr(depth_run, "THOROUGH_PRESET", depth_run.QUICK_PRESET)
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a random generator that gives the same numbers in every run."""
    return np.random.default_rng(1995)
